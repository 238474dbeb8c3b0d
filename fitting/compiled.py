"""Compiling Python to machine code. The only module that imports numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile a function at its first call, and keep the result on disk where a folder can be written to."""
    # Sums may be taken in any order (SIMD), but NaN and infinity keep their meaning.
    options = {"nogil": True, "fastmath": {"reassoc", "contract", "nsz"}, "error_model": "numpy"}
    try:
        return cast(_F, numba.njit(cache=True, **options)(function))
    except RuntimeError:  # numba finds no folder for its cache
        return cast(_F, numba.njit(**options)(function))
