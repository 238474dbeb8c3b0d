"""Figures as SVG elements to put into a page."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANNEL_COLOURS = {"R": "#c0392b", "G": "#1e8449", "B": "#2455a4"}


def svg(figure: Figure) -> str:
    """Return a figure as an <svg> element whose text is text, the same for the same figure."""
    import matplotlib

    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "phoslab"}):
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    content = text.getvalue()
    return content[content.index("<svg") :]
