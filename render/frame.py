"""A rendered picture: band radiance first, colour only when it is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.colorimetry import xyz_matrix
from phoslab.render.passes import Picture


@dataclass(frozen=True, eq=False)
class Frame:
    """The scene at one time.

    Args:
        time_s: seconds of the scene's schedule.
        label: the time as it was asked for.
        bands: the K transport bands.
        radiance: (h, w, K) band-mean radiance in the scene's units, W m⁻² sr⁻¹ nm⁻¹ in an absolute scene; top row
            first.
        warnings: what to know before trusting the picture.
        debug: (h, w, 3) views of passes in [0, 1], by `PASS.VIEW`.
    """

    time_s: float
    label: str
    bands: Bands
    radiance: NDArray[np.float32]
    warnings: tuple[str, ...] = ()
    debug: Mapping[str, Picture] = field(default_factory=dict)

    @cached_property
    def xyz(self) -> NDArray[np.float32]:
        """(h, w, 3) CIE 1931 XYZ; Y in cd/m² in an absolute scene."""
        # What float32 cannot hold of a product is far below a pixel's other errors.
        return self.radiance @ xyz_matrix(self.bands).astype(np.float32)
