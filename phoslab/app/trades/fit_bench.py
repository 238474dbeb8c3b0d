"""What the simulated bench has recorded for the questions that begin at RAW frames: each session once, in one folder.

Rig (flats, the lamp, the filter) and samples are sessions of the plans of `measure all`, carried out on the bench's
physics; the seeds are ones that nothing was tuned on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

from phoslab.fitting.lvf import calibrate
from phoslab.fitting.lvf_file import save
from phoslab.instruments.bench import lights
from phoslab.instruments.bench.campaign import Campaign
from phoslab.instruments.bench.darkroom import Darkroom
from phoslab.instruments.bench.paints import known
from phoslab.instruments.bench.samples import sample
from phoslab.plan_parameters import Decay, Emission, Excitation, Flats, Lamp, Lvf, Parameters

SEED = 11

OF_RIG: Mapping[str, Parameters] = {
    "flats": Flats(),
    "lamp": Lamp(),
    "lvf": Lvf(filters=",".join(lights.READY)),
}
OF_SAMPLE: Mapping[str, Parameters] = {"emission": Emission(), "decay": Decay(), "excitation": Excitation()}
CHARGE_S = Decay().charge_s

FILTERS = "filters"
"""The session of the filters that the calibration does not see."""

RIG_TICKS = len(OF_RIG) + 2

PAINTS = known()
SAMPLES = ("two-states", *PAINTS, "broad")
"""The first follows the model; the others hold traps, as paint does."""


@dataclass(frozen=True)
class Recorded:
    """Sessions of the bench, and the calibration of its rig.

    Args:
        folder: of the samples' sessions, a folder each.
        rig: folder of the rig's sessions.
        lvf: the filter's calibration.
        samples: which.
    """

    folder: Path
    rig: Path
    lvf: Path
    samples: Sequence[str]

    @property
    def has_rig(self) -> bool:
        """Whether the rig's own sessions are there, and not only what they said."""
        return (self.rig / FILTERS).exists()

    def record_rig(self, tick: Callable[[int], None] = lambda n: None) -> None:
        """Record the rig's sessions and calibrate it, if that has not been done; `RIG_TICKS` ticks."""
        if self.lvf.exists():
            return
        others = [n for n in lights.filter_names() if n not in lights.READY]
        bench = Campaign(Darkroom(SEED), (*lights.READY, *others))
        for name, parameters in {**OF_RIG, FILTERS: Lvf(filters=",".join(others))}.items():
            bench.record(self.rig / name, parameters)
            tick(1)
        save(calibrate([self.rig / "lvf", self.rig / "flats"]), self.lvf)
        tick(1)

    def record(self, name: str) -> Path:
        """Record a sample's sessions, if that has not been done; return their folder."""
        folder = self.folder / name
        if not folder.exists():
            bench = Campaign(Darkroom(SEED + 1 + SAMPLES.index(name), sample(name)), lights.READY)
            for plan, parameters in OF_SAMPLE.items():
                bench.record(folder / plan, parameters)
        return folder


def whole(folder: Path) -> Recorded:
    """All samples on a rig that is itself measured, in `folder`; nothing is recorded yet."""
    return Recorded(folder, folder / "rig", folder / "lvf.json", SAMPLES)


@contextmanager
def rig_that_ships(folder: Path) -> Iterator[Recorded]:
    """The calibration and the lamp of the sample data, made by the same rig, and samples that follow the model."""
    with as_file(files("phoslab.sample_data") / "sessions" / "green") as shipped:
        yield Recorded(folder, shipped, shipped / "lvf.json", SAMPLES[:1])
