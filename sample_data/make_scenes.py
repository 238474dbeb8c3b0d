"""Makes the sample scenes: `python -m phoslab.sample_data.make_scenes`. Seeded, so that it makes the same files again.

fading: a shelf of glow-in-the-dark things, a lamp that goes off (Nalbach 2017, Fig. 8.1).
cornell: the Cornell box with phosphorescent red and blue walls (Fig. 8.15).
occluder: an open box whose inside no glow reaches (Fig. 6.5).
confetti: many small triangles, some of which glow.
corridor: a long corridor with the glowing marks of an escape route.
lantern: a lamp that is carried past a glowing wall, and a cube that turns before it.
"""

from __future__ import annotations

from pathlib import Path

from phoslab.sample_data import (
    scene_confetti,
    scene_cornell,
    scene_corridor,
    scene_fading,
    scene_lantern,
    scene_occluder,
)

SCENES = Path(__file__).resolve().parent / "scenes"

WRITERS = {
    "fading": scene_fading.write,
    "cornell": scene_cornell.write,
    "occluder": scene_occluder.write,
    "confetti": scene_confetti.write,
    "corridor": scene_corridor.write,
    "lantern": scene_lantern.write,
}


def main() -> None:
    """Write every sample scene."""
    for name, write in WRITERS.items():
        write(SCENES / name)


if __name__ == "__main__":
    main()
