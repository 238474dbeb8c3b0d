"""The one place where OpenGL objects are made, counted and released.

    with Device() as device:
        texture = device.texture((512, 512), 4)
        program = device.compute("resolve", LAYERS=2)

Whatever a device or a scope of it made is released when it ends, newest first. Shaders are the files of
`phoslab.shaders`; `#include "name.glsl"` takes the file of `include/` of that name, once.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render import memory

# The run-time names: the development names that glcontext would open ship only in -dev packages.
LIBGL, LIBEGL = "libGL.so.1", "libEGL.so.1"
GL_VERSION = 430

# Components that a float texture can have and still be rendered to and written as an image.
RENDERABLE = {1: 1, 2: 2, 3: 4, 4: 4}

GROUP = (8, 8)  # the local size of compute shaders that do not say otherwise
ITEMS = 64  # that of shaders that go over items
MOST_GROUPS = 65535  # along a side of what is dispatched: what every device takes
# Of a loop in a shader at a time: Mesa's llvmpipe ends all loops together after 65535 turns, silently.
LOOP_TURNS = 1 << 15

_INCLUDE = re.compile(r'^#include "([\w.]+)"\n', re.MULTILINE)

Defines = Mapping[str, int | str]
T = TypeVar("T")
Sampled = TypeVar("Sampled", moderngl.Texture, moderngl.TextureArray)


class Device:
    """An off-screen OpenGL 4.3 context and everything made in it.

    Args:
        libgl, libegl: the libraries to open.

    Raises:
        PhoslabError: there is no OpenGL 4.3 without a window on this machine; the error says what to install.
    """

    def __init__(self, libgl: str = LIBGL, libegl: str = LIBEGL) -> None:
        self._scopes: list[_Scope] = []
        # Where there is no OpenGL, our own sentence says so; EGL's warnings beside it help nobody.
        os.environ.setdefault("EGL_LOG_LEVEL", "fatal")
        settings: dict[str, Any] = {"backend": "egl", "libgl": libgl, "libegl": libegl}
        try:
            self.ctx = moderngl.create_context(standalone=True, require=GL_VERSION, **settings)
        except Exception as error:  # glcontext and moderngl raise plain Exception
            raise PhoslabError(
                f"could not be opened without a window ({error})",
                field=f"OpenGL {GL_VERSION // 100}.{GL_VERSION % 100 // 10}",
                remedy="Install it with `apt-get install libgl1 libegl1 libgl1-mesa-dri`, "
                "or a driver for the graphics card.",
            ) from error
        self._scopes.append(_Scope())
        self._home = self.framebuffer([self.texture((1, 1), 1)])

    def __enter__(self) -> Device:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self.check()
        finally:
            self.close()

    @property
    def renderer(self) -> str:
        """The name of the driver that draws."""
        return str(self.ctx.info["GL_RENDERER"])

    @property
    def live(self) -> int:
        """How many objects are made and not released."""
        return sum(len(scope.made) for scope in self._scopes)

    @property
    def closed(self) -> bool:
        """Whether the context itself is released."""
        return not self._scopes

    def check(self) -> None:
        """Raise if OpenGL has reported an error since the last check: a bug of ours, or too little memory.

        Raises:
            PhoslabError: the driver has run out of memory.
        """
        state = self.ctx.error
        if state == "GL_OUT_OF_MEMORY":
            raise PhoslabError("has too little memory for this", field="OpenGL", remedy=memory.REMEDY)
        if state != "GL_NO_ERROR":
            raise RuntimeError(f"OpenGL reports {state}")

    def close(self) -> None:
        """Release everything, the context last."""
        while self._scopes:
            self._scopes.pop().release()
        self.ctx.release()

    @contextmanager
    def scope(self) -> Iterator[None]:
        """Release at its end whatever is made inside: for textures that serve one computation."""
        self._scopes.append(_Scope())
        try:
            yield
        finally:
            # moderngl goes back to the framebuffer in use after making another: it must outlive the scope.
            self._home.use()
            self._scopes.pop().release()

    def release(self, *things: Any) -> None:
        """Release things of the innermost scope before it ends: they are made anew."""
        made = self._scopes[-1].made
        for thing in things:
            del made[next(k for k in reversed(range(len(made))) if made[k] is thing)]
            thing.release()

    def _keep(self, thing: T) -> T:
        self._scopes[-1].made.append(thing)
        return thing

    def _store(self, make: Callable[[], T]) -> T:
        """Keep what takes memory, if the driver could make it.

        Raises:
            PhoslabError: it could not.
        """
        try:
            thing = self._keep(make())
        except moderngl.Error as error:
            raise PhoslabError(
                f"could not make a picture ({str(error).strip()})", field="OpenGL", remedy=memory.REMEDY
            ) from error
        self.check()
        return thing

    def texture(
        self,
        size: tuple[int, int],
        components: int,
        data: NDArray[Any] | None = None,
        *,
        dtype: str = "f4",
        linear: bool = False,
        repeat: bool = False,
    ) -> moderngl.Texture:
        """Make a texture; without `data` it is all 0.

        Args:
            size: (width, height) in texels.
            components: 1..4; 3 become 4, since three-component textures cannot be rendered to.
            data: (height, width, components).
            dtype: "f4", "f2", "u4", or "nu2": 0..1 in 65535 parts, `data` as integers.
            linear: bilinear filtering instead of the nearest texel.
            repeat: whether coordinates beyond 0..1 wrap.
        """
        n = RENDERABLE[components]
        self.check_size(size)
        memory.check_room(size[0] * size[1] * n * np.dtype(_stored(dtype)).itemsize, "a texture")
        texels = _padded(data, (size[1], size[0]), n, dtype)
        texture = self._store(lambda: self.ctx.texture(size, n, texels, dtype=dtype))
        return _sampled(texture, linear, repeat)

    def texture_array(
        self,
        size: tuple[int, int],
        layers: int,
        data: NDArray[Any] | None = None,
        *,
        components: int = 4,
        dtype: str = "f4",
        linear: bool = False,
        repeat: bool = False,
    ) -> moderngl.TextureArray:
        """Make an array texture; without `data` it is all 0.

        Args:
            size: (width, height) in texels.
            layers: how many.
            components: 1..4; 3 become 4.
            data: (layers, height, width, components).
            dtype: "f4" or "f2".
            linear, repeat: as for `texture`.
        """
        n = RENDERABLE[components]
        self.check_size(size)
        memory.check_room(size[0] * size[1] * layers * n * np.dtype(dtype).itemsize, "a texture")
        texels = _padded(data, (layers, size[1], size[0]), n, dtype)
        texture = self._store(lambda: self.ctx.texture_array((*size, layers), n, texels, dtype=dtype))
        return _sampled(texture, linear, repeat)

    def depth_texture(self, size: tuple[int, int]) -> moderngl.Texture:
        """Make a depth texture whose samples are bilinear averages of the comparison `reference <= depth`."""
        self.check_size(size)
        texture = self._store(lambda: self.ctx.depth_texture(size))
        texture.compare_func = "<="
        texture.repeat_x = texture.repeat_y = False
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        return texture

    def depth_renderbuffer(self, size: tuple[int, int]) -> moderngl.Renderbuffer:
        """Make a depth buffer that is only tested, never read."""
        self.check_size(size)
        return self._store(lambda: self.ctx.depth_renderbuffer(size))

    def buffer(self, data: NDArray[Any]) -> moderngl.Buffer:
        """Make a buffer of `data`; one of no bytes is given 16, since OpenGL refuses to bind nothing."""
        return self._keep(self.ctx.buffer(data.tobytes() or bytes(16)))

    def reserve(self, n_bytes: int, *, outlive: bool = False) -> moderngl.Buffer:
        """Make a buffer of any content, for a shader to fill.

        Args:
            n_bytes: its size; at least 16 are made.
            outlive: whether it is released with the scope around the one that is open.
        """
        buffer = self.ctx.buffer(reserve=max(16, n_bytes))
        self._scopes[-2 if outlive else -1].made.append(buffer)
        return buffer

    def framebuffer(
        self,
        colours: Sequence[moderngl.Texture],
        depth: moderngl.Texture | moderngl.Renderbuffer | None = None,
    ) -> moderngl.Framebuffer:
        """Make a framebuffer that draws into `colours` and `depth`."""
        return self._store(lambda: self.ctx.framebuffer(tuple(colours), depth))

    def empty_framebuffer(self, size: tuple[int, int]) -> moderngl.Framebuffer:
        """Make a framebuffer that keeps nothing: for shaders that write to buffers."""
        self.check_size(size)
        return self._store(lambda: self.ctx.empty_framebuffer(size))

    def program(
        self, name: str, *, vertex: str | None = None, defines: Defines | None = None
    ) -> moderngl.Program:
        """Return the program of `shaders/NAME.vert.glsl` (or that of `vertex`) and `shaders/NAME.frag.glsl`.

        Built once; whoever asks for the same again gets it, and sets its uniforms before every use.
        """
        defines = defines or {}
        return self._build(
            (vertex or name, name, *defines.items()),
            lambda: self.ctx.program(
                vertex_shader=source(f"{vertex or name}.vert.glsl", defines),
                fragment_shader=source(f"{name}.frag.glsl", defines),
            ),
        )

    def compute(self, name: str, defines: Defines | None = None) -> moderngl.ComputeShader:
        """Return the compute shader `shaders/NAME.comp.glsl`, built once."""
        defines = defines or {}
        return self._build(
            (name, *defines.items()), lambda: self.ctx.compute_shader(source(f"{name}.comp.glsl", defines))
        )

    def _build(self, key: tuple[Any, ...], build: Callable[[], T]) -> T:
        """Return what was built, or build it.

        Raises:
            PhoslabError: the driver cannot: it has fewer buffers for a shader, say, than we need.
        """
        for scope in reversed(self._scopes):
            if key in scope.programs:
                found: T = scope.programs[key]
                return found
        try:
            made = build()
        except moderngl.Error as error:
            why = next(
                (line for line in map(str.strip, str(error).splitlines()) if "rror" in line),
                "no reason given",
            )
            raise PhoslabError(
                f"({self.renderer}) cannot build the shader {key[0]!r} ({why})",
                field="the OpenGL driver",
                remedy="Take another driver (LIBGL_ALWAYS_SOFTWARE=1 draws on processors), or another --gi.",
            ) from error
        built = self._scopes[-1].programs[key] = self._keep(made)
        return built

    def vertex_array(
        self,
        program: moderngl.Program,
        attributes: Mapping[str, tuple[moderngl.Buffer, str]] | None = None,
        indices: moderngl.Buffer | None = None,
    ) -> moderngl.VertexArray:
        """Bind the attributes that `program` uses, each by its name; without any: for `render(vertices=3)`."""
        content = [
            (buffer, layout, name) for name, (buffer, layout) in (attributes or {}).items() if name in program
        ]
        return self._keep(self.ctx.vertex_array(program, content, indices))

    def dispatch(
        self, shader: moderngl.ComputeShader, size: tuple[int, int], group: tuple[int, int] = GROUP
    ) -> None:
        """Run `shader` over (width, height) texels and make what it wrote visible to whatever follows.

        Args:
            group: the shader's local size.
        """
        shader.run(-(-size[0] // group[0]), -(-size[1] // group[1]))
        self.ctx.memory_barrier()

    def dispatch_items(self, shader: moderngl.ComputeShader, n: int) -> None:
        """Run `shader`, which includes `items.glsl`, over `n` items, or more than that: it passes over the others.

        A device takes 65535 groups along a side at least, and silently runs none where there are more.
        """
        groups = max(1, -(-n // ITEMS))
        rows = -(-groups // MOST_GROUPS)
        shader.run(-(-groups // rows), rows)
        self.ctx.memory_barrier()

    def check_size(
        self,
        size: tuple[int, int],
        what: str = "a texture",
        *,
        file: Path | None = None,
        remedy: str = memory.REMEDY,
    ) -> None:
        """Refuse a texture of (width, height) texels that the driver cannot hold.

        Raises:
            PhoslabError: a side is too long; the error names `what`, in `file`.
        """
        largest = int(self.ctx.info["GL_MAX_TEXTURE_SIZE"])
        if not all(1 <= n <= largest for n in size):
            raise PhoslabError(
                f"of {size[0]} x {size[1]} texels is more than this OpenGL driver can hold ({largest})",
                file=file,
                field=what,
                remedy=remedy,
            )


def set_uniforms(program: moderngl.Program | moderngl.ComputeShader, **values: Any) -> None:
    """Set uniforms by name; one that the compiler dropped because it is unused is passed over.

    Matrices are (n, n) as one writes them (column vectors); OpenGL wants the transpose. Bytes are written as they are.
    """
    for name, value in values.items():
        member: Any = program.get(name, None)
        if member is None:
            continue
        if isinstance(value, bytes):
            member.write(value)
        elif isinstance(value, np.ndarray):
            member.write(np.ascontiguousarray(value.T, dtype="f4").tobytes())
        else:
            member.value = value


def bind_buffers(*buffers: moderngl.Buffer, first: int = 0) -> None:
    """Bind storage buffers to the places `first`, `first` + 1, ..."""
    for k, buffer in enumerate(buffers):
        buffer.bind_to_storage_buffer(first + k)


def read_texture(texture: moderngl.Texture) -> NDArray[np.float32]:
    """Read a texture back as (height, width, components); row 0 is v = 0."""
    flat = np.frombuffer(texture.read(), dtype=_stored(texture.dtype)).astype(np.float32)
    if texture.dtype == "nu2":
        flat /= 65535
    return flat.reshape(texture.height, texture.width, texture.components)


def read_array(texture: moderngl.TextureArray, channels: int) -> NDArray[np.float32]:
    """Read a float32 array texture back as (height, width, channels): its layers, four channels each, in a row."""
    flat = np.frombuffer(texture.read(), dtype="f4").reshape(
        texture.layers, texture.height, texture.width, -1
    )
    return np.ascontiguousarray(
        flat.transpose(1, 2, 0, 3).reshape(texture.height, texture.width, -1)[..., :channels]
    )


@dataclass
class _Scope:
    """What is released together, and the programs among it by what they were built from."""

    made: list[Any] = field(default_factory=list)
    programs: dict[tuple[Any, ...], Any] = field(default_factory=dict)

    def release(self) -> None:
        for thing in reversed(self.made):
            thing.release()


@cache
def _text(name: str) -> str:
    return (files("phoslab.shaders") / name).read_text(encoding="utf-8")


def source(name: str, defines: Defines) -> str:
    """Return a shader's text with its includes pasted in and `defines` after the version line."""
    included: set[str] = set()

    def paste(match: re.Match[str]) -> str:
        # A define may choose the file: #include "SOLVER" with SOLVER = "solver_exact.glsl".
        wanted = str(defines.get(match[1], match[1]))
        if wanted in included:
            return ""
        included.add(wanted)
        return _INCLUDE.sub(paste, _text(f"include/{wanted}"))

    version, _, body = _text(name).partition("\n")
    lines = [f"#define {k} {v}" for k, v in defines.items() if not str(v).endswith(".glsl")]
    return "\n".join([version, *lines, _INCLUDE.sub(paste, body)])


def _padded(data: NDArray[Any] | None, shape: tuple[int, ...], components: int, dtype: str) -> NDArray[Any]:
    if data is not None and data.shape == (*shape, components):
        return np.ascontiguousarray(data, dtype=_stored(dtype))
    texels = np.zeros((*shape, components), dtype=_stored(dtype))
    if data is not None:
        texels[..., : data.shape[-1]] = data
    return texels


def _stored(dtype: str) -> str:
    """NumPy's name of what a texture of moderngl's type holds: those that read as 0..1 are integers."""
    return dtype.removeprefix("n")


def _sampled(texture: Sampled, linear: bool, repeat: bool) -> Sampled:
    # Between the texels of one texel there is nothing, and on a CPU the filter takes its time all the same.
    smooth = linear and texture.size[:2] != (1, 1)
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR) if smooth else (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = repeat
    return texture
