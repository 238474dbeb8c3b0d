"""Numbers as people read them: to the digits that their errors leave."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def with_error(value: float, error: float, *, share: bool = False) -> str:
    """Write `0.1320 ± 0.0011`: to the second digit of the error; `share` adds it as a share: ` (0.8%)`."""
    if value == 0:
        return "0"
    if not 0 < error < 1e3 * abs(value):
        return f"{value:.4g} (error not determined)"
    if 1e-4 <= abs(value) < 1e6:
        decimals = int(np.clip(1 - np.floor(np.log10(error)), -12, 12))
        shown = max(0, decimals)
        text = f"{round(value, decimals):.{shown}f} ± {round(error, decimals):.{shown}f}"
    else:
        digits = int(np.clip(np.ceil(np.log10(abs(value) / error)) + 2, 2, 12))
        text = f"{value:.{digits}g} ± {error:.2g}"
    return text + (f" ({error / abs(value):.1%})" if share else "")


def number(value: float) -> str:
    """Write a number of statistics shortly, without an exponent where it is merely large; a dash for none."""
    if not np.isfinite(value):
        return "-"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.4g}"


def criterion(value: float) -> str:
    """Write AICc or BIC, or that there are too few values for it."""
    return f"{value:.5g}" if np.isfinite(value) else "-"


def by_chance(p: float | None) -> str:
    """Write a probability, or that there is none."""
    if p is None:
        return "-"
    return f"{p:.2g}" if p >= 1e-9 else "< 1e-9"


def for_json(values: float | NDArray[np.float64]) -> Any:
    """Return a number, or an array as lists, with null for what is not finite."""
    if np.ndim(values):
        return [for_json(v) for v in np.asarray(values)]
    return float(values) if np.isfinite(values) else None
