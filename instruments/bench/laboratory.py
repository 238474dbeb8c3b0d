"""The simulated laboratory: dark room, controller on a pseudo-terminal, camera body and clock, and what goes wrong.

Two rates of time meet here. Simulated time flows as real time does, and jumps when a plan sleeps; the controller's
timestamps, the lamp, the door, the sample and the shutter live in it. The host lives in real time, and so its silence
is measured in it: a jump of hours is no silence.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import threading
import time
import tty
from pathlib import Path
from typing import Any

from phoslab.instruments.bench import lights
from phoslab.instruments.bench.body import CHOICES, Body
from phoslab.instruments.bench.controller import SimulatedController
from phoslab.instruments.bench.darkroom import Darkroom, Stage
from phoslab.instruments.bench.faults import Fault, parse
from phoslab.instruments.bench.host import Host
from phoslab.instruments.bench.timekeeper import Timekeeper
from phoslab.instruments.bench.truth import truth
from phoslab.instruments.bench.wiring import Wiring

_AWAY_S = 1.0
"""Real time for which a pulled cable is out."""

_POLL_S = 0.002
"""Real time between two looks of the controller at its pins."""

_SHUTTER_PATIENCE_S = 2.0
"""Real time for which a host that has released the shutter may not ask after it."""

PORT = "port"


class Laboratory:
    """Everything that the bench's process holds; thread-safe.

    Args:
        folder: where the link `port` leads to its serial port, while the cable is in.
        room, keeper, body: see there.
        host: the program that measures.
        faults: what is going to go wrong.
    """

    def __init__(
        self, folder: Path, room: Darkroom, keeper: Timekeeper, body: Body, host: Host, faults: list[Fault]
    ) -> None:
        self._port, self._host = folder / PORT, host
        self.room, self.keeper, self.body = room, keeper, body
        self._wiring = Wiring(room, keeper)
        self._controller = SimulatedController(self._wiring, boot=1)
        self._faults = list(faults)
        self._born_s = keeper.now_s()
        self._lock = threading.RLock()
        self._developing = threading.Lock()
        self._ends = False
        self._master, self._slave = -1, -1
        self._back_at = 0.0
        self._plug(*os.openpty())
        threading.Thread(target=self._run, name="controller", daemon=True).start()

    def close(self) -> None:
        """Cut the current."""
        self._ends = True

    # --- what a host may ask ------------------------------------------------------------------

    def answer(self, do: str, asked: dict[str, Any], pid: int) -> tuple[dict[str, Any], bytes | None]:
        """Return the answer to a request of a process, and the bytes that follow it.

        Raises:
            PhoslabError: it cannot be done.
            KeyError, TypeError, ValueError: the request is malformed.
        """
        if do == "download":  # the only slow one: it does not keep the others waiting
            with self._developing:
                self.body.check(int(asked["connection"]))
                content = self.body.develop(int(asked["number"]))
                with self._lock:
                    return {"size": len(content)}, self.body.sent(content)
        if do == "truth":
            with self._developing:
                known = truth(self.room, self.body, int(asked["piece"]), [float(t) for t in asked["times_s"]])
                return {}, json.dumps(known).encode()
        if do == "delete":
            with self._developing:
                self.body.check(int(asked["connection"]))
                self.body.delete(int(asked["number"]))
                return {}, None
        if do == "sleep_until":
            self._see_shutter_open()
        with self._lock:
            if do == "connect":
                self._host.connected(pid)
            return self._answer(do, asked), None

    def _answer(self, do: str, asked: dict[str, Any]) -> dict[str, Any]:
        body = self.body
        match do:
            case "sleep_until":
                self._jump(float(asked["mono_s"]))
                return {}
            case "place":
                stage = Stage(
                    str(asked["target"]),
                    str(asked["lvf"]),
                    str(asked["filter"]),
                    str(asked["light"]),
                    float(asked["angle_deg"]),
                )
                self.room.place(self.keeper.now_s(), stage)
                return {}
            case "filters":
                return {"filters": lights.filter_names()}
            case "inject":
                fault = parse(str(asked["fault"]))
                if fault.exposure is None and fault.at_s is None:
                    self._happen(fault)
                else:
                    self._faults.append(fault)
                return {}
            case "repair":
                self._wiring.repair()
                return {}
            case "state":
                return {
                    "mono_s": self.keeper.now_s(),
                    "lamp": self.room.lamp.level(self.keeper.now_s()),
                    "current": self.room.lamp.on,
                    "door": self.room.door.share(self.keeper.now_s()),
                    "alarm": self._wiring.alarm,
                    "exposures": body.exposures,
                }
            case "connect":
                sensor = self.room.camera.sensor
                return {
                    "connection": body.connect(),
                    "choices": CHOICES,
                    "settings": body.settings,
                    "make": sensor.make,
                    "model": sensor.model,
                    "serial": f"SIM{self.room.camera.serial:06d}",
                    "sensitivities": self.room.camera.sensitivities,
                    "lag_s": [body.lag_s, 4 * body.lag_jitter_s],
                }
            case "set":
                body.check(int(asked["connection"]))
                body.set(float(asked["exposure_s"]), float(asked["iso"]), float(asked["f_number"]))
                return {}
            case "expose":
                self._next_exposure()
                body.check(int(asked["connection"]))
                return {"number": body.expose().number}
            case "abort":
                body.check(int(asked["connection"]))
                body.abort()
                return {}
            case "phase":
                body.check(int(asked["connection"]))
                shot = body.card[int(asked["number"])]
                phase = body.tell(shot)
                return {
                    "phase": phase,
                    "now_s": self.keeper.now_s(),
                    "ready_s": shot.close_s + body.readout_s,
                }
        raise ValueError(f"there is no {do!r}")

    # --- time ---------------------------------------------------------------------------------

    def _see_shutter_open(self) -> None:
        """Let time flow as it does until the host has seen the shutter open: a jump would hide when that was."""
        patience_until = time.monotonic() + _SHUTTER_PATIENCE_S
        while self.body.about_to_open and time.monotonic() < patience_until:
            time.sleep(0.001)

    def _jump(self, to_s: float) -> None:
        """Let time pass until a moment, with all that happens on the way at its own moment."""
        while (now := self.keeper.now_s()) < to_s:
            self._controller.poll()
            due = self._controller.due_us()
            moments = [to_s, *self._wiring.changes_s(now + 1e-6)]
            if due is not None:
                # A clock of whole microseconds shows them all a microsecond later.
                moments.append(max(self._wiring.at_s(due) + 2e-6, now + 1e-5))
            moments += [
                at for f in self._faults if f.at_s is not None and (at := f.at_s + self._born_s) > now
            ]
            self.keeper.jump_to(min(moments) + 1e-6 if min(moments) < to_s else to_s)
            self._pass_faults()
        self._controller.poll()
        self._say()

    # --- faults -------------------------------------------------------------------------------

    def _next_exposure(self) -> None:
        number = self.body.exposures + 1
        due = [f for f in self._faults if f.exposure == number]
        self._faults = [f for f in self._faults if f not in due]
        for fault in due:
            self._happen(fault)

    def _pass_faults(self) -> None:
        since = self.keeper.now_s() - self._born_s
        due = [f for f in self._faults if f.at_s is not None and f.at_s <= since]
        self._faults = [f for f in self._faults if f not in due]
        for fault in due:
            self._happen(fault)

    def _happen(self, fault: Fault) -> None:
        controller, body = self._controller, self.body
        match fault.kind:
            case "camera-busy":
                body.refusals = 3
            case "camera-gone":
                body.go(_AWAY_S)
            case "card-full":
                body.full = True
            case "truncated-download":
                body.cut = True
            case "late-shutter":
                body.late_s = 0.7
            case "serial-unplug":
                self._unplug()
            case "garbled-ack":
                controller.faults.garble_replies += 1
            case "lost-ack":
                controller.faults.lose_replies += 1
            case "controller-reset":
                controller.reset("WATCHDOG")
            case "stuck-door":
                self._wiring.jam()
            case "stuck-relay":
                self._wiring.stick()
            case "clock-step":
                self.keeper.set_wall(3600.0)
            case "disk-full":
                self._host.fill_disk()
            case "ctrl-c":
                self._host.send(signal.SIGINT)
            case "kill":
                self._host.send(signal.SIGKILL)
            case "second-process":
                self._host.start_rival(self._port)

    # --- the serial line ----------------------------------------------------------------------

    def _plug(self, master: int, slave: int) -> None:
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._master, self._slave = master, slave
        # As /dev/serial/by-id does: one name that holds, whatever path the adapter comes back under.
        beside = self._port.with_name(".port")
        beside.unlink(missing_ok=True)
        beside.symlink_to(os.ttyname(slave))
        beside.replace(self._port)

    def _unplug(self) -> None:
        if self._master < 0:  # pulled while it is out: it stays so for longer
            self._back_at = time.monotonic() + _AWAY_S
            return
        # The next one is opened first: so it gets another path.
        following = os.openpty()
        self._port.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master, self._slave = -1, -1
        self._following, self._back_at = following, time.monotonic() + _AWAY_S

    def _run(self) -> None:
        """The controller's life, and the bench's: else hosts would wait for a controller that never answers."""
        try:
            self._live()
        finally:
            if not self._ends:
                os.kill(os.getpid(), signal.SIGTERM)

    def _live(self) -> None:
        while not self._ends:
            with self._lock:
                self._pass_faults()
                if self._master < 0 and time.monotonic() >= self._back_at:
                    self._plug(*self._following)
                self._hear()
                self._controller.poll()
                self._say()
                master = self._master
            if master < 0:
                time.sleep(_POLL_S)
            else:
                with contextlib.suppress(OSError, ValueError):  # closed meanwhile
                    select.select([master], [], [], _POLL_S)

    def _hear(self) -> None:
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):
                while data := os.read(self._master, 4096):
                    self._controller.receive(data)

    def _say(self) -> None:
        said = self._controller.take()
        if self._master >= 0 and said:
            # Where nobody listens the line fills up, and the rest is lost, as on a real one.
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, said)
