"""Plans carried out on the bench's physics directly, on a simulated clock: the same seed gives the same bytes.

`phoslab measure --simulate` goes through drivers, wires and threads as on a rig, and so no two runs have the same
moments. Here the same plans are taken step by step without any of them: hours in seconds, for samples that ship and for
tests. What is recorded reads alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from phoslab import __version__
from phoslab.instruments.bench import darkroom
from phoslab.instruments.bench.bench import STATEMENT, SimulatedClock
from phoslab.instruments.bench.body import CHOICES, true_settings
from phoslab.instruments.bench.darkroom import Darkroom
from phoslab.instruments.bench.dng import dng
from phoslab.instruments.bench.lights import LED
from phoslab.instruments.devices import Exposure
from phoslab.instruments.history import PLAN
from phoslab.instruments.operator import instructions
from phoslab.instruments.plans import start
from phoslab.instruments.plans.ladder import Ladder
from phoslab.instruments.plans.steps import (
    Cold,
    Dark,
    Door,
    Lamp,
    Part,
    Setup,
    Shoot,
    Shot,
    Stage,
    Step,
    Wait,
)
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.runner import COLD_AFTER_S
from phoslab.instruments.shooting import measure_level
from phoslab.plan_parameters import PLANS, Parameters

LAG_S, READOUT_S, HAND_S = 0.065, 0.12, 30.0
"""From command to open shutter; from closed shutter to a frame; a hand movement."""


@dataclass
class Campaign:
    """Sessions one after another in one dark room.

    Args:
        room: the physics; its seed is that of all noise.
        filters: colour filters that lie ready.
    """

    room: Darkroom
    filters: Sequence[str] = ()
    clock: SimulatedClock = field(default_factory=SimulatedClock)

    def __post_init__(self) -> None:
        self._stage: Stage | None = None
        self._warm_s: dict[str, float] = {}
        self._dark_since_s = 0.0
        self._lamp_on = False
        self._door_open = False
        self._exposures = 0
        self._true = true_settings(self.room.camera.serial)

    def record(self, folder: Path, parameters: Parameters) -> None:
        """Carry a plan out into a new session.

        Raises:
            PhoslabError: the folder holds something.
        """
        (name,) = (n for n, kind in PLANS.items() if kind is type(parameters))
        setup = Setup(ladder=Ladder.of(CHOICES), cycle_s=0.5, filters=tuple(self.filters))
        with Recorder(folder, self._header(name, asdict(parameters)), self.clock) as recorder:
            recorder.note(STATEMENT)
            self._recorder, self._part, self._edges = recorder, -1, dict[str, str]()
            steps, answer = start(parameters, setup), None
            while True:
                try:
                    step = steps.send(answer)
                except StopIteration:
                    break
                answer = self._take(step)
            self._end_part()
            if self._lamp_on:
                self._switch("off")

    def _header(self, plan: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
        camera = self.room.camera
        return {
            "operator": "nobody",
            "room_temperature_C": self.room.room.temperature_C,
            "plan": {"name": plan, "parameters": dict(parameters)},
            "sample": {"name": self.room.sample.name, "note": STATEMENT},
            "rig": {"name": "bench", "led": {"spectrum": LED}},
            "camera": {
                "make": camera.sensor.make,
                "model": camera.sensor.model,
                "serial": f"SIM{camera.serial:06d}",
                "sensitivities": camera.sensitivities,
            },
            "lens": {"name": "simulated"},
            "software": {"phoslab": __version__},
            "simulated": {"statement": STATEMENT, "seed": self.room.seed},
        }

    def _take(self, step: Step) -> Any:
        now = self.clock.now_s
        match step:
            case Part(name):
                self._end_part()
                self._part = self._recorder.command(PLAN, "part", {"part": name, "attempt": 1})
            case Stage():
                self._place(step)
            case Cold(light):
                since_s = self._warm_s.get(light)
                self._warm_s[light] = now
                return since_s is None or (light == "lamp" and now - since_s > COLD_AFTER_S)
            case Lamp(to):
                return self._switch(to)
            case Door(to):
                return self._swing(to)
            case Wait(duration_s, _, since_s):
                self.clock.sleep_until((now if since_s is None else since_s) + duration_s)
            case Dark(duration_s):
                self.clock.sleep_until(self._dark_since_s + duration_s)
            case Shoot():
                return self._shoot(step)
        return None

    def _end_part(self) -> None:
        if self._part >= 0:
            self._recorder.ack(self._part, ok=True)

    def _place(self, wanted: Stage) -> None:
        todo = instructions(self._stage, wanted)
        if not todo:
            return
        if self._lamp_on:
            self._switch("off")
        if self._stage is not None and wanted.light != self._stage.light:
            self._warm_s.pop(wanted.light, None)
        command = self._recorder.command("hand", "place", {**asdict(wanted), "instructions": todo})
        self.clock.sleep_until(self.clock.now_s + HAND_S * len(todo))
        physical = darkroom.Stage(wanted.target, wanted.lvf, wanted.filter, wanted.light, wanted.angle_deg)
        self.room.place(self.clock.now_s, physical)
        self._stage = wanted
        self._recorder.ack(command, ok=True)

    def _switch(self, to: str) -> float:
        command = self._recorder.command("lamp", "set", {"to": to})
        self.room.lamp.switch(self.clock.now_s, to == "on")
        if self._lamp_on or to == "on":
            self._dark_since_s = self._warm_s["lamp"] = self.clock.now_s
        self._lamp_on = to == "on"
        return self._edge(command, "lamp", to)

    def _swing(self, to: str) -> float:
        command = self._recorder.command("door", "set", {"to": to})
        if (to == "open") != self._door_open:
            self._door_open = to == "open"
            self.room.door.drive(self.clock.now_s, float(self._door_open), self.room.door.hinge.travel_s)
            self.clock.sleep_until(self.clock.now_s + self.room.door.hinge.travel_s)
        return self._edge(command, "door", to)

    def _edge(self, command: int, device: str, to: str) -> float:
        at_s = self.clock.now_s
        self._recorder.ack(command, ok=True, reply="OK")
        if self._edges.get(device) != to:
            self._recorder.edge(device, to, at_mono_s=at_s, at_device_s=self.clock.device_at(at_s))
            self._edges[device] = to
        return at_s

    def _shoot(self, step: Shoot) -> Shot:
        exposure = step.exposure
        command = self._recorder.command("camera", "capture", asdict(exposure))
        if step.at_s is not None:
            self.clock.sleep_until(step.at_s - LAG_S)
        open_s = self.clock.now_s + LAG_S
        content, close_s = self._frame(exposure, open_s)
        self.clock.sleep_until(close_s + READOUT_S)
        name = self._recorder.frame(
            lambda path: path.write_bytes(content),
            role=step.role,
            at_mono_s=open_s,
            at_device_s=self.clock.device_at(open_s),
            exposure_s=exposure.exposure_s,
            iso=exposure.iso,
            f_number=exposure.f_number,
            planned_mono_s=step.at_s,
        )
        self._recorder.ack(command, ok=True)
        level, saturated = measure_level(self._recorder.path / "frames" / name)
        return Shot(name, exposure, open_s, level, saturated)

    def _frame(self, exposure: Exposure, open_s: float) -> tuple[bytes, float]:
        """A frame's file, and when its shutter closed: at the settings that the dials really mean."""
        self._exposures += 1
        assert exposure.f_number is not None
        true_s = self._true["exposure_s"][exposure.exposure_s]
        camera, room = self.room.camera, self.room
        values = camera.numbers(
            camera.on_pixels(room.expose(open_s, true_s)),
            exposure_s=true_s,
            iso=self._true["iso"][exposure.iso],
            f_number=self._true["f_number"][exposure.f_number],
            rng=np.random.default_rng([room.seed, 2, self._exposures]),
            warmer_C=room.room.sensor_at(open_s - room.born_s),
        )
        content = dng(
            values,
            camera.sensor,
            exposure_s=exposure.exposure_s,
            iso=int(exposure.iso),
            f_number=exposure.f_number,
            taken=self.clock.wall().strftime("%Y:%m:%d %H:%M:%S"),
            description=STATEMENT,
        )
        return content, open_s + true_s
