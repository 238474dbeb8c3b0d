"""The rig controller as the bench has it: what the firmware does, over whatever hardware it is given.

    board = SimulatedController(hardware, boot=1)
    board.receive(bytes_from_the_host)
    board.poll()                                    # often; `due_us` says when there will be something to do
    host.write(board.take())

docs/rig-protocol.md is what it follows; the same conformance tests run on it and on instruments/firmware/.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

from phoslab.instruments import wire

FIRMWARE = "1.0.0"
MAX_ON_MS = 14_400_000
LONGEST_KEEP_MS = 2_000
DOOR_LIMIT_US = 3_000_000
HOLD_US = 200_000
"""How long the motor pushes after the end switch has answered."""
REPEAT_US = 1_000_000
"""From one saying of an alarm to the next."""
ALARMS = ("WATCHDOG", "MAXON", "LAMPFAULT", "DOORSTUCK")

Drive = Literal["OPEN", "CLOSE"] | None


class Hardware(Protocol):
    """What the controller is wired to."""

    def now_us(self) -> int:
        """Microseconds since the hardware was switched on; goes on over a reset of the controller."""

    def silence_us(self) -> int:
        """Microseconds of the clock that the heartbeat is measured by.

        On a real board the same as `now_us`. Where simulated time jumps ahead of a host that lives in
        real time, the host's silence is counted in real time.
        """

    def set_lamp(self, on: bool) -> None:
        """Switch the lamp's relay."""

    def set_main(self, on: bool) -> None:
        """Switch the relay before it."""

    def set_alarm(self, on: bool) -> None:
        """Switch the buzzer."""

    def light(self) -> int:
        """The photodiode now, 0..1023."""

    def drive_door(self, to: Drive) -> None:
        """Run the door's motor one way or the other, or stop it."""

    def switches(self) -> tuple[bool, bool]:
        """Whether the end switches for open and for closed are pressed."""


@dataclass
class Faults:
    """What is going to go wrong on the line; each counts down as it happens.

    Args:
        garble_replies: so many of the next replies arrive with a wrong character.
        lose_replies: so many never arrive.
        lose_requests: so many requests are never heard.
        garble_requests: so many are heard with a wrong character.
    """

    garble_replies: int = 0
    lose_replies: int = 0
    lose_requests: int = 0
    garble_requests: int = 0


@dataclass
class _Alarm:
    at_us: int
    said_us: int
    text: str


@dataclass
class SimulatedController:
    """One controller board from its power-up; `reset` is what its reset line does.

    Args:
        hardware: what it is wired to.
        boot: how many times it has been started, this one included.
        faults: what goes wrong on the line.
    """

    hardware: Hardware
    boot: int = 1
    faults: Faults = field(default_factory=Faults)

    def __post_init__(self) -> None:
        self._commands: dict[str, Callable[[list[str], int], str]] = {
            "LIMITS": self._limits,
            "LAMP": self._lamp,
            "PING": self._ping,
            "DOOR": self._door,
            "STATUS": self._status,
            "ACK": self._ack,
        }
        self._start("POWER")

    def reset(self, cause: Literal["EXTERNAL", "WATCHDOG", "BROWNOUT", "POWER"] = "EXTERNAL") -> None:
        """Lose everything and start anew, as by the reset line or a power cut; what was not yet taken is lost."""
        self.boot += 1
        self._start(cause)

    def _start(self, cause: str) -> None:
        hardware = self.hardware
        hardware.set_lamp(False)
        hardware.set_main(False)
        hardware.set_alarm(False)
        hardware.drive_door(None)
        self._born_us = hardware.now_us()
        self._cause = cause
        self._greeted = False
        self._lines = wire.Lines()
        self._out = b"\n"  # the reset may have cut a line short
        self._lamp_on, self._since_us, self._why = False, 0, "BOOT"
        self._keep_until_us = 0  # by the clock of silence
        self._alarms: dict[str, _Alarm] = {}
        self._lit, self._agreed_us = False, 0
        self._place, self._place_us = self._switches(), 0
        self._seen_place, self._seen_us = self._place, 0
        self._drive = "IDLE"
        self._drive_until_us: int | None = None
        self._forget()
        self._event(0, f"BOOT {self._about()}")

    def _forget(self) -> None:
        """As after HELLO."""
        self._max_on_us, self._settle_us, self._threshold = 600_000_000, 1_000_000, 300
        self._fault = ""
        self._alarms.clear()
        self._last: tuple[int, str] | None = None

    # --- what the outside calls ---------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        """Take in bytes from the host, and do what the lines that they complete say."""
        for line in self._lines.feed(data):
            self.poll()
            if self._takes("lose_requests"):
                continue
            self._line(_garbled(line) if self._takes("garble_requests") else line)

    def take(self) -> bytes:
        """Return the bytes that are to go to the host, and forget them."""
        out, self._out = self._out, b""
        return out

    def poll(self) -> None:
        """Look at clock, photodiode and switches, and act on them."""
        now = self._now()
        self._watch_lamp(now)
        self._watch_light(now)
        self._watch_door(now)
        for alarm in self._alarms.values():
            if now - alarm.said_us >= REPEAT_US:
                alarm.said_us = now
                self._event(alarm.at_us, alarm.text)
        self.hardware.set_alarm(bool(self._alarms) or (self._fault == "STUCK" and self._lit))

    def due_us(self) -> int | None:
        """When, by `Hardware.now_us`, the clock alone will give `poll` something to do; None for never."""
        due = [alarm.said_us + REPEAT_US for alarm in self._alarms.values()]
        if self._lamp_on:
            due.append(self._since_us + self._max_on_us)
        if self._threshold and not self._fault and self._lit != self._lamp_on:
            due.append(self._agreed_us + self._settle_us)
        if self._drive_until_us is not None:
            due.append(self._drive_until_us)
        if self._seen_place != self._place:
            due.append(self._seen_us + 5_000)
        return self._born_us + min(due) if due else None

    # --- lines --------------------------------------------------------------------------------

    def _line(self, line: bytes) -> None:
        now = self._now()
        text = wire.decode(line)
        words = text.split() if text is not None and len(line) <= 60 else []
        if len(words) < 2 or not words[0].isdigit() or not 1 <= int(words[0]) <= 65535:
            self._say(f"ERR 0 {now} GARBLED")
            return
        number, (name, *arguments) = int(words[0]), words[1:]
        if name == "HELLO":
            self._say(self._hello(number, arguments, now))
        elif not self._greeted:
            self._say(f"ERR {number} {now} HELLO")
        elif self._last is not None and self._last[0] == number:
            self._say(self._last[1])
        else:
            try:
                act = self._commands.get(name)
                if act is None:
                    raise _RefusedError("COMMAND")
                reply = f"OK {number} {now} {act(arguments, now)}"
            except _RefusedError as refused:
                reply = f"ERR {number} {now} {refused}"
            self._last = number, reply
            self._say(reply)

    def _hello(self, number: int, arguments: list[str], now: int) -> str:
        if len(arguments) != 1:
            return f"ERR {number} {now} ARGUMENT"
        if arguments[0] != str(wire.PROTOCOL):
            return f"ERR {number} {now} VERSION"
        self._switch(False, "HOST", now)
        self._stop_door("IDLE")
        self._forget()
        self._agreed_us = now
        self._greeted = True
        self.hardware.set_main(True)
        return f"OK {number} {now} {self._about()} max_on_ms={MAX_ON_MS}"

    def _limits(self, arguments: list[str], now: int) -> str:
        if len(arguments) != 3:
            raise _RefusedError("ARGUMENT")
        max_on = _number(arguments[0], 1, MAX_ON_MS)
        settle = _number(arguments[1], 50, 60_000)
        threshold = _number(arguments[2], 0, 1000)
        self._max_on_us, self._settle_us, self._threshold = 1000 * max_on, 1000 * settle, threshold
        self._agreed_us = now
        return f"max_on_ms={max_on} settle_ms={settle} threshold={threshold}"

    def _lamp(self, arguments: list[str], now: int) -> str:
        if arguments == ["OFF"]:
            self._switch(False, "HOST", now)
        elif len(arguments) == 2 and arguments[0] == "ON":
            keep = _number(arguments[1], 1, LONGEST_KEEP_MS)
            if self._fault:
                raise _RefusedError("FAULT")
            self._keep_until_us = self.hardware.silence_us() + 1000 * keep
            self._switch(True, "HOST", now)
        else:
            raise _RefusedError("ARGUMENT")
        return f"lamp={_on(self._lamp_on)} since={self._since_us}"

    def _ping(self, arguments: list[str], _: int) -> str:
        if len(arguments) != 1:
            raise _RefusedError("ARGUMENT")
        keep = _number(arguments[0], 0, LONGEST_KEEP_MS)
        if keep:
            self._keep_until_us = self.hardware.silence_us() + 1000 * keep
        return f"lamp={_on(self._lamp_on)} why={self._why} alarms={self._alarm_names()}"

    def _door(self, arguments: list[str], now: int) -> str:
        if arguments == ["STOP"]:
            self._stop_door("IDLE")
        elif arguments == ["OPEN"] or arguments == ["CLOSE"]:
            self._drive = arguments[0]
            self._drive_until_us = now + DOOR_LIMIT_US
            self.hardware.drive_door("OPEN" if self._drive == "OPEN" else "CLOSE")
            self._arrive(now)
        else:
            raise _RefusedError("ARGUMENT")
        return f"door={self._place} drive={self._drive}"

    def _status(self, arguments: list[str], now: int) -> str:
        if arguments:
            raise _RefusedError("ARGUMENT")
        left = keep = 0
        if self._lamp_on:
            left = max(0, self._since_us + self._max_on_us - now) // 1000
            keep = max(0, self._keep_until_us - self.hardware.silence_us()) // 1000
        return (
            f"lamp={_on(self._lamp_on)} since={self._since_us} why={self._why} left_ms={left} keep_ms={keep} "
            f"light={self.hardware.light()} verdict={self._verdict()} door={self._place} "
            f"door_us={self._place_us} drive={self._drive} alarms={self._alarm_names()}"
        )

    def _ack(self, arguments: list[str], _: int) -> str:
        if len(arguments) != 1 or arguments[0] not in ALARMS:
            raise _RefusedError("ARGUMENT")
        self._alarms.pop(arguments[0], None)
        return f"alarms={self._alarm_names()}"

    # --- lamp, light and door -----------------------------------------------------------------

    def _switch(self, on: bool, why: str, now: int) -> None:
        self.hardware.set_lamp(on)
        if on != self._lamp_on:
            self._lamp_on, self._since_us, self._why, self._agreed_us = on, now, why, now

    def _watch_lamp(self, now: int) -> None:
        if self._lamp_on and now - self._since_us >= self._max_on_us:
            self._switch(False, "MAXON", now)
            self._alarm("MAXON", now)
        elif self._lamp_on and self.hardware.silence_us() >= self._keep_until_us:
            self._switch(False, "WATCHDOG", now)
            self._alarm("WATCHDOG", now)

    def _watch_light(self, now: int) -> None:
        if not self._threshold:
            self._lit = False
            return
        level = self.hardware.light()
        lit = level >= (self._threshold - self._threshold // 8 if self._lit else self._threshold)
        if lit != self._lit:
            self._lit = lit
            self._event(now, f"LIGHT state={_on(lit)}")
        if lit == self._lamp_on or not self._greeted:
            self._agreed_us = now
        elif not self._fault and now - self._agreed_us >= self._settle_us:
            self._fault = "STUCK" if lit else "DEAD"
            self._switch(False, "FAULT", now)
            self.hardware.set_main(False)
            self._alarm("LAMPFAULT", now, f" verdict={self._fault}")

    def _verdict(self) -> str:
        if not self._threshold:
            return "NONE"
        return self._fault or ("OK" if self._lit == self._lamp_on else "WAIT")

    def _watch_door(self, now: int) -> None:
        seen = self._switches()
        if seen != self._seen_place:
            self._seen_place, self._seen_us = seen, now
        if seen != self._place and now - self._seen_us >= 5_000:
            self._place, self._place_us = seen, self._seen_us
            self._event(self._seen_us, f"DOOR state={seen}")
        self._arrive(now)
        if self._drive_until_us is not None and now >= self._drive_until_us:
            to = self._drive
            self._stop_door("IDLE" if to == "IDLE" else "STUCK")
            if to != "IDLE":
                self._alarm("DOORSTUCK", now, f" to={to}")

    def _arrive(self, now: int) -> None:
        if (self._drive, self._place) in (("OPEN", "OPEN"), ("CLOSE", "CLOSED")):
            self._drive, self._drive_until_us = "IDLE", now + HOLD_US

    def _stop_door(self, drive: str) -> None:
        self._drive, self._drive_until_us = drive, None
        self.hardware.drive_door(None)

    def _switches(self) -> str:
        at_open, at_closed = self.hardware.switches()
        if at_open:
            return "BOTH" if at_closed else "OPEN"
        return "CLOSED" if at_closed else "BETWEEN"

    # --- the rest -----------------------------------------------------------------------------

    def _now(self) -> int:
        return self.hardware.now_us() - self._born_us

    def _about(self) -> str:
        return f"protocol={wire.PROTOCOL} firmware={FIRMWARE} boot={self.boot} reset={self._cause}"

    def _alarm_names(self) -> str:
        return ",".join(name for name in ALARMS if name in self._alarms) or "-"

    def _alarm(self, name: str, now: int, more: str = "") -> None:
        self._alarms[name] = _Alarm(now, now, name + more)
        self._event(now, name + more)

    def _event(self, at_us: int, text: str) -> None:
        self._out += wire.encode(f"EV {at_us} {text}")

    def _say(self, reply: str) -> None:
        if self._takes("lose_replies"):
            return
        line = wire.encode(reply)
        self._out += _garbled(line) if self._takes("garble_replies") else line

    def _takes(self, fault: str) -> bool:
        left: int = getattr(self.faults, fault)
        if left:
            setattr(self.faults, fault, left - 1)
        return left > 0


class _RefusedError(Exception):
    """An ERR code."""


def _number(word: str, lowest: int, highest: int) -> int:
    if not (word.isascii() and word.isdigit()):
        raise _RefusedError("ARGUMENT")
    if not lowest <= int(word) <= highest or len(word) > 9:
        raise _RefusedError("RANGE")
    return int(word)


def _on(state: bool) -> str:
    return "ON" if state else "OFF"


def _garbled(line: bytes) -> bytes:
    """The line with one bit of its third byte turned over."""
    return line[:2] + bytes([line[2] ^ 0x04]) + line[3:]
