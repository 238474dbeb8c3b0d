"""Compiling Python to machine code. The only module that imports numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile a function at its first call, and keep the result on disk where a folder can be written to."""
    try:
        return _with_cache(function, True)
    except RuntimeError:  # numba finds no folder for its cache
        return _with_cache(function, False)


def _with_cache(function: _F, cache: bool) -> _F:
    # Sums may be taken in any order (SIMD), but NaN and infinity keep their meaning.
    fast = {"reassoc", "contract", "nsz"}
    return cast(_F, numba.njit(cache=cache, nogil=True, fastmath=fast, error_model="numpy")(function))
