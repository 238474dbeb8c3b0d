"""Numbers out of glTF 2.0 buffers: views, strides, sparse accessors, normalised integers.

Everything in a file is untrusted: every range is checked before it is read, and names of buffers and images
stay inside the scene's folder.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.files import inside, read_regular

COMPONENT = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

LARGEST_BYTES = 1 << 30  # of a glTF file, a buffer or an image

REMEDY = "Export the file again, as glTF 2.0."


@dataclass(frozen=True)
class Buffers:
    """The buffers of one glTF document.

    Args:
        document: a `pygltflib.GLTF2`.
        file: its path; buffers and images are beside it.
    """

    document: Any
    file: Path
    _loaded: dict[int, bytes] = field(default_factory=dict)

    def read_accessor(self, index: int) -> NDArray[Any]:
        """Return (count, width) the values of an accessor: integers as they are, normalised ones as float32."""
        accessor = self.pick("accessors", index)
        where = f"accessors[{index}]"
        if accessor.componentType not in COMPONENT or accessor.type not in WIDTH:
            raise self.error(where, "has an unknown type")
        dtype, width = COMPONENT[accessor.componentType], WIDTH[accessor.type]
        count = accessor.count
        if accessor.bufferView is None:
            # Only sparse values: the rest is 0. The count is bounded by what a file of this size could mean.
            if accessor.sparse is None or not (isinstance(count, int) and 0 <= count <= 1 << 24):
                raise self.error(where, "has no buffer view")
            values = np.zeros((count, width), dtype=dtype)
        else:
            values = self._strided(accessor.bufferView, accessor.byteOffset or 0, count, dtype, width, where)
        if accessor.sparse is not None:
            values = self._with_sparse(values, accessor.sparse, dtype, width, where)
        if accessor.normalized and values.dtype.kind in "iu":
            return np.maximum(values.astype(np.float32) / np.iinfo(values.dtype).max, -1.0)
        return values

    def read_image(self, index: int) -> bytes:
        """Return the encoded bytes of an image."""
        image = self.pick("images", index)
        if image.bufferView is not None:
            view = self.pick("bufferViews", image.bufferView)
            start = view.byteOffset or 0
            data = self._buffer(view.buffer)
            if start < 0 or view.byteLength < 0 or start + view.byteLength > len(data):
                raise self.error(f"images[{index}]", "reaches beyond its buffer")
            return data[start : start + view.byteLength]
        return self._uri(image.uri, f"images[{index}].uri")

    def pick(self, table: str, index: Any, items: Any = None) -> Any:
        """Return the element `index` of the document's `table`, or of `items`: every index goes through here.

        Raises:
            PhoslabError: it is no index, or of nothing. (Python would count a negative one from the end.)
        """
        items = getattr(self.document, table) if items is None else items
        if type(index) is not int or not 0 <= index < len(items or ()):
            raise self.error(f"{table}[{index!r}]", "does not exist, but something refers to it")
        return items[index]

    def error(self, where: str, problem: str, remedy: str = REMEDY) -> PhoslabError:
        """Make the error that names this file and a place in it."""
        return PhoslabError(problem, file=self.file, field=where, remedy=remedy)

    def _strided(
        self, view_index: int, offset: int, count: int, dtype: str, width: int, where: str
    ) -> NDArray[Any]:
        view = self.pick("bufferViews", view_index)
        data = self._buffer(view.buffer)
        if type(count) is not int or count < 0:
            raise self.error(where, "has no valid count")
        item = np.dtype(dtype).itemsize * width
        stride = view.byteStride or item
        start = (view.byteOffset or 0) + offset
        end_of_view = (view.byteOffset or 0) + view.byteLength
        last = start + (count - 1) * stride + item if count else start
        if min(start, offset, view.byteLength) < 0 or stride < item or last > min(end_of_view, len(data)):
            raise self.error(where, "reaches beyond its buffer")
        rows = np.ndarray((count, item), dtype="u1", buffer=data, offset=start, strides=(stride, 1))
        return np.ascontiguousarray(rows).view(dtype).reshape(count, width).copy()

    def _with_sparse(
        self, values: NDArray[Any], sparse: Any, dtype: str, width: int, where: str
    ) -> NDArray[Any]:
        at, replaced = sparse.indices, sparse.values
        index_type = COMPONENT[at.componentType]
        index = self._strided(at.bufferView, at.byteOffset or 0, sparse.count, index_type, 1, where)[:, 0]
        if index.size and int(index.max()) >= len(values):
            raise self.error(where, "has a sparse index beyond its count")
        values[index] = self._strided(
            replaced.bufferView, replaced.byteOffset or 0, sparse.count, dtype, width, where
        )
        return values

    def _buffer(self, index: int) -> bytes:
        if index not in self._loaded:
            buffer = self.pick("buffers", index)
            if buffer.uri is None:
                data = self.document.binary_blob()
                if data is None:
                    raise self.error(f"buffers[{index}]", "has no data")
            else:
                data = self._uri(buffer.uri, f"buffers[{index}].uri")
            self._loaded[index] = bytes(data)
        return self._loaded[index]

    def _uri(self, uri: Any, where: str) -> bytes:
        if not isinstance(uri, str):
            raise self.error(where, "is missing")
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            if not head.endswith(";base64"):
                raise self.error(where, "is a data URI that is not base64")
            return base64.b64decode(body, validate=True)
        path = inside(self.file.parent, unquote(uri), file=self.file, field=where)
        return read_regular(
            path, LARGEST_BYTES, remedy=f"{self.file.name} names it in {where}: put that file beside it."
        )
