"""How a phosphor's state is kept in textures, each format behind one name.

    f32      float32, the default
    f16      float16: a last place of 5e-4 near 1
    unorm16  equal parts of 1/65535
    f32c     compensated float32: the value, and in a second texture what its rounding lost, so that the smallest
             increment of a step is not lost either

A new format is a file `shaders/include/format_NAME.glsl` that defines

    void store_sum(ivec2 texel, STATE from, STATE change)

and one line in `FORMATS`.
"""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import look_up
from phoslab.render.device import RENDERABLE, Defines, Device, read_texture, set_uniforms

Array = NDArray[np.float64]

_CHANNELS = {1: "r", 2: "rg", 4: "rgba"}


@dataclass(frozen=True)
class StateFormat:
    """One way to keep a state.

    Args:
        include: the file in shaders/include that stores it.
        dtype: of its textures, as `Device.texture` has it.
        image: the end of its image format's name in shaders.
        bytes_per_channel: of all its textures together; three states take four channels.
        compensated: whether a second texture has what rounding lost.
    """

    include: str
    dtype: str
    image: str
    bytes_per_channel: int
    compensated: bool = False

    def bytes_per_texel(self, n_states: int) -> int:
        """Return the bytes that one texel takes."""
        return RENDERABLE[n_states] * self.bytes_per_channel


FORMATS: dict[str, StateFormat] = {
    "f32": StateFormat("format_f32.glsl", "f4", "32f", 4),
    "f16": StateFormat("format_f16.glsl", "f2", "16f", 2),
    "unorm16": StateFormat("format_unorm16.glsl", "nu2", "16", 2),
    "f32c": StateFormat("format_f32c.glsl", "f4", "32f", 8, compensated=True),
}


def find_format(name: str) -> StateFormat:
    """Return the format `name`.

    Raises:
        PhoslabError: there is none of that name.
    """
    return look_up(FORMATS, name, "state format")


def image_format(n_states: int, kind: str = "32f") -> str:
    """Return the shaders' name of an image of so many states: `rg32f`."""
    return _CHANNELS[RENDERABLE[n_states]] + kind


class StateTexture:
    """The concentrations of n_c states on (width, height) texels, in one format.

    Attributes:
        value: what pictures read, bilinear.
        low: what rounding kept back from it; None where the format is not compensated.
    """

    def __init__(self, device: Device, size: tuple[int, int], n_states: int, name: str) -> None:
        self.format, self.n_states = find_format(name), n_states
        self.value = device.texture(size, n_states, dtype=self.format.dtype, linear=True)
        self.low: moderngl.Texture | None = None
        if self.format.compensated:
            self.low = device.texture(size, n_states, dtype=self.format.dtype)

    def write(self, r: Array) -> None:
        """Write concentrations that broadcast to (height, width, n_c), rounded to nearest."""
        texels = np.zeros((self.value.height, self.value.width, self.value.components))
        texels[..., : self.n_states] = r
        if self.format.dtype == "nu2":
            self.value.write(np.rint(texels * 65535).astype("u2").tobytes())
            return
        rounded = texels.astype(self.format.dtype)
        self.value.write(rounded.tobytes())
        if self.low is not None:
            self.low.write((texels - rounded).astype("f4").tobytes())

    def read(self) -> Array:
        """Return (height, width, n_c) concentrations; row 0 is v = 0."""
        r = read_texture(self.value).astype(np.float64)
        if self.low is not None:
            r += read_texture(self.low)
        return r[..., : self.n_states]


def texels_of_group(n_states: int) -> tuple[int, int]:
    """Return the texels of one work group of such a shader: the invocations' rows, as texels.glsl shares them out.

    More rows cost less each, until the registers do not hold what they share.
    """
    return 64, 6 if n_states <= 2 else 4


def state_defines(r: StateTexture, target: StateTexture) -> Defines:
    """Return what a shader that includes `state_texture.glsl` must define to step from `r` to `target`."""
    defines: dict[str, int | str] = {
        "STATES": r.n_states,
        "ROWS": texels_of_group(r.n_states)[1],
        "FORMAT": target.format.include,
        "IMAGE_FORMAT": image_format(r.n_states, target.format.image),
    }
    return {**defines, "COMPENSATED": 1} if r.format.compensated else defines


def bind_states(shader: moderngl.ComputeShader, r: StateTexture, target: StateTexture) -> None:
    """Let such a shader read `r` (texture units 0 and 1) and write `target` (image units 0 and 1)."""
    r.value.use(0)
    target.value.bind_to_image(0, read=False, write=True)
    if r.low is not None:
        r.low.use(1)
    if target.low is not None:
        target.low.bind_to_image(1, read=False, write=True)
    set_uniforms(shader, r_in=0, low_in=1)
