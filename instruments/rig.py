"""rig.toml: what stands in the dark room, read, checked, and made into devices.

A driver is one line in `DRIVERS` and a function that makes it from its table; its module is loaded when a rig file
names it. docs/formats-rig.md describes the file.
"""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phoslab import schemas
from phoslab.errors import PhoslabError
from phoslab.files import read_regular
from phoslab.instruments.devices import Camera, Clock, Door, Lamp
from phoslab.instruments.operator import Operator
from phoslab.instruments.plans.ladder import NOMINAL, Ladder
from phoslab.instruments.plans.steps import Setup

if TYPE_CHECKING:
    from phoslab.instruments.controller import RigController

SCHEMA = "phoslab-rig/1"

DRIVERS: Mapping[str, Mapping[str, str]] = {
    "lamp": {
        "controller": "phoslab.instruments.rig:_controller_lamp",
        "lcus-1": "phoslab.instruments.rig:_relay_lamp",
        "kmtronic": "phoslab.instruments.rig:_relay_lamp",
    },
    "door": {
        "controller": "phoslab.instruments.rig:_controller_door",
        "hand": "phoslab.instruments.rig:_hand_door",
    },
    "camera": {
        "gphoto2": "phoslab.instruments.rig:_gphoto2_camera",
        "drop-folder": "phoslab.instruments.rig:_drop_folder_camera",
        "simulated": "phoslab.instruments.rig:_simulated_camera",
    },
}
"""By kind and name: the function that makes the device."""

_LARGEST_BYTES = 1 << 20
_MAX_ON_S = 7200.0


@dataclass(frozen=True)
class Rig:
    """A rig file that has passed its checks.

    Args:
        data: its tables, as they stand in it.
        file: where it stood; None for one that was made by the program.
    """

    data: Mapping[str, Any]
    file: Path | None = None

    @classmethod
    def load(cls, path: Path) -> Rig:
        """Read and check a rig file.

        Raises:
            PhoslabError: it is missing, malformed, or names a key or a driver that there is not.
        """
        content = read_regular(
            path, _LARGEST_BYTES, remedy="Name a rig file; docs/formats-rig.md has an example."
        )
        try:
            data = tomllib.loads(content.decode())
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise PhoslabError(f"is not valid TOML: {error}", file=path, remedy="Correct it.") from error
        return cls.of(data, path)

    @classmethod
    def of(cls, data: Mapping[str, Any], file: Path | None = None) -> Rig:
        """Check tables that were read elsewhere, as from a session that is resumed."""
        schemas.check(dict(data), "rig-1", file=file)
        for kind, drivers in DRIVERS.items():
            name = data[kind]["driver"]
            if name not in drivers:
                raise PhoslabError(
                    f"is {name!r}, which is no driver of a {kind}",
                    file=file,
                    field=f"{kind}.driver",
                    remedy=f"There are: {', '.join(drivers)}.",
                )
        return cls(data, file)

    @property
    def max_on_s(self) -> float:
        """How long the lamp may shine without a break."""
        return float(self.data["lamp"].get("max_on_s", _MAX_ON_S))

    @property
    def frame_bytes(self) -> int:
        """Size of a frame, as far as the file says."""
        return int(float(self.data["camera"].get("frame_MB", 30.0)) * 1e6)

    @property
    def choices(self) -> dict[str, tuple[float, ...]]:
        """Settings that the file says the camera offers; what it does not say is missing."""
        camera = self.data["camera"]
        named = {"exposure_s": "exposures_s", "iso": "isos", "f_number": "f_numbers"}
        return {key: tuple(sorted(camera[name])) for key, name in named.items() if name in camera}

    def setup(self, choices: Mapping[str, Any] | None = None) -> Setup:
        """What plans know of this rig.

        Args:
            choices: what the camera offers; None: what cameras usually do, for a rehearsal.
        """
        lamp, door, camera = self.data["lamp"], self.data["door"], self.data["camera"]
        offered = {**(NOMINAL if choices is None else choices), **self.choices}
        return Setup(
            ladder=Ladder.of(offered, camera.get("limits")),
            fade_s=float(lamp.get("fade_s", 0.32)),
            door_s=float(door.get("travel_s", 0.28)),
            cycle_s=float(camera.get("cycle_s", 2.0)),
            warm_up_s=float(lamp.get("warm_up_s", 900.0)),
            lux_lx=float(lamp.get("lux_lx", 0.0)),
            filters=tuple(self.data.get("filters", {}).get("names", ())),
        )

    def header(self, facts: Mapping[str, Any]) -> dict[str, Any]:
        """The tables of session.toml that describe this rig.

        Args:
            facts: make, model, serial and sensitivities as the camera tells them.
        """
        camera = self.data["camera"]
        told = {name: camera[name] for name in ("make", "model", "sensitivities") if name in camera}
        known = {
            name: str(value)
            for name, value in {**facts, **told}.items()
            if value is not None and name in ("make", "model", "serial", "sensitivities")
        }
        header: dict[str, Any] = {
            "camera": {"make": "unknown", "model": "unknown", **known},
            "rig": {name: value for name, value in self.data.items() if name != "schema"},
        }
        if self.file is not None:
            header["rig"]["file"] = str(self.file.resolve())
        for name in ("operator", "room_temperature_C", "lens"):
            if name in self.data:
                header[name] = self.data[name]
        return header

    @classmethod
    def from_header(cls, rig: Mapping[str, Any]) -> Rig:
        """The rig that a session was begun with, from its header's `rig` table."""
        data = {name: plain(value) for name, value in rig.items() if name != "file"}
        return cls.of({"schema": SCHEMA, **data}, Path(rig["file"]) if "file" in rig else None)


@dataclass
class Devices:
    """The devices of a rig, made but not staged.

    Args:
        clock: theirs and the plans'.
    """

    lamp: Lamp
    door: Door
    camera: Camera
    clock: Clock

    def stage(self) -> None:
        """Make them ready, lamp first: it goes off, and what is wrong is found before anything is switched on."""
        for device in (self.lamp, self.door, self.camera):
            device.stage()

    def unstage(self) -> None:
        """Leave them safe and let them go."""
        for device in (self.camera, self.door, self.lamp):
            device.unstage()


@dataclass
class Making:
    """What a function that makes a device is given.

    Args:
        rig: the file.
        host_clock: this computer's, or the bench's.
        operator, check: see the devices.
        clock: the same clock as `host_clock`, which knows the controller's as well where there is one.
        controllers: by port: lamp and door may share one.
    """

    rig: Rig
    host_clock: Clock
    operator: Operator
    check: Callable[[], None]
    clock: Clock = field(init=False)
    controllers: dict[str, RigController] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.clock = self.host_clock


def connect(rig: Rig, clock: Clock, operator: Operator, check: Callable[[], None]) -> Devices:
    """Make a rig's devices. Nothing is opened before they are staged.

    Raises:
        PhoslabError: a table lacks what its driver needs, or a driver cannot be loaded.
    """
    making = Making(rig, clock, operator, check)
    made = {kind: _function(kind, rig)(making, rig.data[kind]) for kind in DRIVERS}
    return Devices(made["lamp"], made["door"], made["camera"], making.clock)


def _function(kind: str, rig: Rig) -> Callable[[Making, Mapping[str, Any]], Any]:
    module, _, name = DRIVERS[kind][rig.data[kind]["driver"]].partition(":")
    function: Callable[[Making, Mapping[str, Any]], Any] = getattr(importlib.import_module(module), name)
    return function


def _needed(making: Making, kind: str, name: str) -> Any:
    table = making.rig.data[kind]
    if name not in table:
        raise PhoslabError(
            "is missing",
            file=making.rig.file,
            field=f"{kind}.{name}",
            remedy=f"The driver {table['driver']!r} needs it; docs/formats-rig.md says how to find it.",
        )
    return table[name]


def plain(value: Any) -> Any:
    """Read-only tables and tuples as the dicts and lists that they were."""
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, tuple) else value


def _controller(making: Making, kind: str) -> RigController:
    from phoslab.instruments.controller import RigController

    port = _needed(making, kind, "port")
    if port not in making.controllers:
        lamp = making.rig.data["lamp"]
        controller = RigController(
            port,
            max_on_s=making.rig.max_on_s,
            settle_s=float(lamp.get("settle_s", 1.0)),
            threshold=int(lamp.get("lit_from", 300)),
            clock=making.host_clock,
        )
        making.controllers[port] = controller
        making.clock = controller.clock
    return making.controllers[port]


def _controller_lamp(making: Making, table: Mapping[str, Any]) -> Lamp:
    return _controller(making, "lamp").lamp


def _controller_door(making: Making, table: Mapping[str, Any]) -> Door:
    return _controller(making, "door").door


def _relay_lamp(making: Making, table: Mapping[str, Any]) -> Lamp:
    from phoslab.instruments.relays import RelayLamp

    return RelayLamp(
        _needed(making, "lamp", "port"),
        table["driver"],
        accept_no_failsafe=bool(table.get("accept_no_failsafe", False)),
        clock=making.clock,
    )


def _told(making: Making) -> dict[str, Any]:
    """What the rig file says of the camera itself."""
    camera = making.rig.data["camera"]
    return {name: camera[name] for name in ("make", "model", "sensitivities") if name in camera}


def _gphoto2_camera(making: Making, table: Mapping[str, Any]) -> Camera:
    from phoslab.instruments.cameras.gphoto2 import GphotoCamera

    return GphotoCamera(making.clock, port=table.get("port"), sensitivities=table.get("sensitivities"))


def _drop_folder_camera(making: Making, table: Mapping[str, Any]) -> Camera:
    from phoslab.instruments.cameras.drop_folder import DropFolder

    return DropFolder(
        Path(_needed(making, "camera", "folder")),
        making.clock,
        command=table.get("command", ()),
        choices=making.rig.choices,
        facts=_told(making),
        patience_s=float(table.get("patience_s", 60.0)),
    )


def _simulated_camera(making: Making, table: Mapping[str, Any]) -> Camera:
    from phoslab.instruments.cameras.simulated import SimulatedCamera
    from phoslab.instruments.simulated import BenchClock, Link

    clock = making.host_clock
    if not isinstance(clock, BenchClock):
        raise PhoslabError(
            "is 'simulated', which is the bench's own",
            file=making.rig.file,
            field="camera.driver",
            remedy="Use --simulate in place of --rig, or name the driver of a real camera.",
        )
    clock.device_s = making.clock.device_s
    return SimulatedCamera(Link(Path(_needed(making, "camera", "port")), "camera"), clock)


def _hand_door(making: Making, table: Mapping[str, Any]) -> Door:
    from phoslab.instruments.hand import HandDoor

    return HandDoor(making.operator, making.clock, making.check)
