"""Figures as SVG elements to put into a page."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

CHANNEL_COLOURS = {"R": "#c0392b", "G": "#1e8449", "B": "#2455a4"}


def svg(figure: Figure) -> str:
    """Return a figure as an <svg> element whose text is text, the same for the same figure."""
    import matplotlib

    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "phoslab"}):
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    content = text.getvalue()
    return content[content.index("<svg") :]


def missed_percent(signal: Array, predicted: Array, sigma: Array) -> tuple[Array, Array]:
    """Return what a fit misses of each value, and its noise, in per cent of the value; not a number where it is 0."""
    seen = np.where(signal == 0, np.nan, signal)
    return 100 * (seen - predicted) / np.abs(seen), 100 * sigma / np.abs(seen)
