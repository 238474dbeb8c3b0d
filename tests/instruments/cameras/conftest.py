"""What the tests of cameras share."""

from __future__ import annotations

from pathlib import Path

import pytest

import phoslab.sample_data

FRAMES = Path(phoslab.sample_data.__file__).parent / "sessions" / "green-decay" / "frames"


@pytest.fixture
def frame() -> Path:
    """A RAW file: 1/8 s at ISO 100 and f/2.8."""
    return FRAMES / "0000.dng"
