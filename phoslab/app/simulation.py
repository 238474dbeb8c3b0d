"""The simulated bench as a laboratory: the same drivers, plans and recorder as on a rig, and hands that never tire."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from phoslab.instruments.bench import rig as bench_rig
from phoslab.instruments.bench.lights import LED, READY
from phoslab.instruments.bench.rig import Bench
from phoslab.instruments.plans.steps import Stage
from phoslab.instruments.rig import SCHEMA, Rig
from phoslab.instruments.simulated import BenchClock, Hands, Link

STATEMENT = "SIMULATED by the phoslab bench: no light was measured."

AWAY = timedelta(minutes=10)
"""How much later it is on a bench that is started anew for a session that was interrupted."""


@dataclass(frozen=True)
class Simulation:
    """A bench that runs.

    Args:
        rig: how to reach its devices.
        clock: its clock.
        operator: its hands.
        header: what session.toml says of it.
        word: about where a session goes on that was interrupted, for the journal.
    """

    rig: Rig
    clock: BenchClock
    operator: BenchOperator
    header: dict[str, Any]
    word: str = ""


class BenchOperator:
    """The `Operator` of the bench: does at once what is asked for."""

    def __init__(self, hands: Hands) -> None:
        self._hands = hands

    def do(self, texts: list[str], stage: Stage | None, check: Callable[[], None]) -> None:
        """See `Operator`."""
        check()
        if stage is not None:
            self._hands.place(
                target=stage.target,
                lvf=stage.lvf,
                filter_name=stage.filter,
                light=stage.light,
                angle_deg=stage.angle_deg,
            )


def bench_of(port: Path, socket: Path) -> Rig:
    """The bench's rig file."""
    return Rig.of(
        {
            "schema": SCHEMA,
            "name": "bench",
            "lamp": {"driver": "controller", "port": str(port), "max_on_s": 14400},
            "door": {"driver": "controller", "port": str(port)},
            "camera": {"driver": "simulated", "port": str(socket), "cycle_s": 0.5, "frame_MB": 0.2},
            "filters": {"names": list(READY)},
            "led": {"spectrum": LED},
        }
    )


def _found(session: Path, sample: str, seed: int, last: str) -> tuple[Bench, str]:
    """The bench on which a session was interrupted, or a new one on which nothing goes wrong, and a word about it."""
    bench = bench_rig.serving(session)
    if bench is not None and (bench.sample, bench.seed) == (sample, seed):
        return (
            bench,
            f"goes on on the same simulated bench (process {bench.pid}), which has outlived its host",
        )
    at = datetime.fromisoformat(last) + AWAY
    bench = bench_rig.start(sample, seed=seed, at=at, session=session)
    return bench, (
        "the simulated bench has gone meanwhile: goes on on a new one, "
        f"whose samples have been in the dark for {AWAY.total_seconds():g} s"
    )


@contextmanager
def started(
    session: Path, sample: str, seed: int, faults: Sequence[str], not_before: str | None
) -> Iterator[Simulation]:
    """Start a bench, or find the one that outlived its host, and stop it at the end.

    It outlives this process for a while if that dies.

    Args:
        session: folder of the session, or of several.
        sample: a preset: what the sample looks like, and how long it glows.
        seed: of all that is random.
        faults: see docs/simulation.md; of a bench that is started for a new session.
        not_before: wall time, RFC 3339, of the last line of a session that goes on.
    """
    if not_before is None:
        found = bench_rig.start(sample, seed=seed, faults=tuple(faults), session=session), ""
    else:
        found = _found(session, sample, seed, not_before)
    bench, word = found
    with bench:
        clock = BenchClock(bench.folder, Link(bench.socket))
        hands = Hands(Link(bench.socket))
        rig = bench_of(Path(bench.port), bench.socket)
        header = {
            "operator": "nobody",
            "sample": {"note": STATEMENT},
            "simulated": {"statement": STATEMENT, "seed": seed, "sample": sample, "faults": list(faults)},
        }
        yield Simulation(rig, clock, BenchOperator(hands), header, word)
