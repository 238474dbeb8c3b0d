"""Prefix sums on the device: where each of many items, of which every one makes some others, puts what it makes."""

from __future__ import annotations

import moderngl
import numpy as np

from phoslab.render.device import Device, bind_buffers, set_uniforms

CHUNK = 128  # values that one thread adds up
BYTES = 8  # of a value: 64 bits, the low word first


def sum_buffer(device: Device, n: int) -> moderngl.Buffer:
    """Make a buffer of `n` values and, after them, their sum; all 0."""
    return device.buffer(np.zeros(n + 1, dtype=np.uint64))


def prefix_sums(device: Device, values: moderngl.Buffer, n: int) -> int:
    """Replace each of `n` values by the sum of those before it; write the sum of all after them, and return it.

    Buffers that it needs on the way live as long as the scope of `device` that is open.
    """
    _spread(device, values, n + 1)
    return int.from_bytes(values.read(BYTES, offset=n * BYTES), "little")


def _spread(device: Device, values: moderngl.Buffer, n: int) -> None:
    n_chunks = -(-n // CHUNK)
    chunks = values
    if n_chunks > 1:
        chunks = device.buffer(np.zeros(n_chunks, dtype=np.uint64))
        _run(device, {"CHUNK": CHUNK}, values, chunks, n, n_chunks)
        _spread(device, chunks, n_chunks)
    _run(device, {"CHUNK": CHUNK, "SPREAD": 1}, values, chunks, n, n_chunks)


def _run(
    device: Device,
    defines: dict[str, int],
    values: moderngl.Buffer,
    chunks: moderngl.Buffer,
    n: int,
    n_chunks: int,
) -> None:
    shader = device.compute("prefix_sums", defines)
    # A value is not its own chunk: where there is one chunk only, none is read.
    bind_buffers(values, chunks)
    set_uniforms(shader, count=n, has_chunks=n_chunks > 1)
    device.dispatch_items(shader, n_chunks)
