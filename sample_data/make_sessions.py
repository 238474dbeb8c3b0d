"""Make the sample sessions again.

    python -m phoslab.sample_data.make_sessions OUT
    phoslab calibrate OUT/calibration/flats OUT/calibration/lvf -o OUT/sessions/green/lvf.json

It only calls the bench. The same seeds give the same bytes; what ships is what this wrote, but for the two sessions of
the calibration: hundreds of frames, of which lvf.json keeps what they say.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from phoslab.files import write_text
from phoslab.instruments.bench.bench import STATEMENT, Bench, record_decay
from phoslab.instruments.bench.campaign import Campaign
from phoslab.instruments.bench.darkroom import Darkroom
from phoslab.instruments.bench.lights import READY
from phoslab.instruments.bench.sample import Sample
from phoslab.plan_parameters import Decay, Emission, Excitation, Flats, Lamp, Lvf

SEED = 20260115


def main(out: Path) -> None:
    """Write all of them."""
    decay_alone(out)
    campaign(out)


def campaign(out: Path) -> None:
    """Write sessions/green, all that a material needs, and calibration/, from which lvf.json is made.

    One dark room: the sample that is charged for one session rests before the next. Few dark frames, so that it is
    small.
    """
    room = Campaign(Darkroom(SEED, Sample(name="green")), READY)
    room.record(out / "calibration" / "flats", Flats())
    room.record(out / "calibration" / "lvf", Lvf())
    sessions = out / "sessions" / "green"
    room.record(sessions / "lamp", Lamp(frames=2, darks=2))
    room.record(sessions / "emission", Emission(frames=2, darks=2))
    room.record(sessions / "decay", Decay(darks=2))
    room.record(sessions / "excitation", Excitation(last_s=512.0, between=2, darks=1))


def decay_alone(out: Path) -> None:
    """Write sessions/green-decay, a decay and nothing else, and, beside it, what the sample really did."""
    bench = Bench(SEED, Sample(name="green"))
    record_decay(out / "sessions" / "green-decay", bench)
    # A second in steps of 10 ms, the recorded time in steps of 0.1 s, then ever wider to an hour.
    times_s = np.unique(
        np.concatenate(
            [np.arange(0, 100) / 100, np.arange(10, 2001) / 10, np.geomspace(200, 3600, 101)]
        ).round(6)
    )
    light = bench.true_light(times_s)
    light /= light[times_s == 0.6]
    rows = "".join(f"{t:g},{value:.9e}\n" for t, value in zip(times_s, light, strict=True))
    write_text(
        out / "sessions" / "green-decay.truth.csv",
        f"# {STATEMENT}\n"
        "# True light of green-decay, for tests only; 1 where the first frame starts, 0.6 s after lamp-off.\n"
        f"time_since_lamp_off_s,light\n{rows}",
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m phoslab.sample_data.make_sessions OUT")
    main(Path(sys.argv[1]))
