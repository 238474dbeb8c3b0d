"""What the bench really did, for tests of those who measure it; nothing that measures may ask."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from phoslab.instruments.bench import scene
from phoslab.instruments.bench.body import Body
from phoslab.instruments.bench.darkroom import NM, Darkroom, Stage


def truth(room: Darkroom, body: Body, piece: int, times_s: Sequence[float]) -> dict[str, Any]:
    """Return everything that a measurement tries to find out, as plain numbers.

    Args:
        room, body: the bench's.
        piece: of the samples, from 1 on.
        times_s: ascending moments in the dark.

    Returns:
        `nm`: wavelengths. `emission`, `excitation`: of the sample, by the nm. `lamp`, `led`, `mercury`: light at the
        target. `lvf`: `u` along the strip, the `centre_nm` that passes there, the `transmission` (u, nm), and the
        strip's corners in the frame, `corners_px`: (x, y) of blue top, red top, red bottom, blue bottom.
        `settings`: what the dial says and what is true, for exposure_s, iso and f_number. `times_s`, `light`: the
        sample's light at those moments, in recombinations per second as a share of its traps.
    """
    u = np.linspace(0, 1, 101)
    return {
        "nm": NM.tolist(),
        "emission": room.sample.emission(NM).tolist(),
        "excitation": room.sample.excitation(NM).tolist(),
        **{name: room.light(Stage(light=name)).tolist() for name in ("lamp", "led", "mercury")},
        "lvf": {
            "u": u.tolist(),
            "centre_nm": room.lvf.centre_nm(u).tolist(),
            "transmission": room.lvf.transmission(u, NM).round(7).tolist(),
            "corners_px": scene.corners_px(room.strip, room.camera.shape),
        },
        "settings": {name: [list(pair) for pair in known.items()] for name, known in body.true.items()},
        "times_s": list(times_s),
        "light": room.afterglow(piece, times_s) if times_s else [],
    }
