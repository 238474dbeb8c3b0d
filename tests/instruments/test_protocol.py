"""docs/rig-protocol.md holds on the firmware under simavr and on the simulated controller alike.

Times of the board are compared with one another; nothing here depends on how fast this machine is, but that a host
may be late by a second now and then.
"""

from __future__ import annotations

import itertools
import random
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from boards import BoardProcess, build_firmware, eventually

from phoslab.instruments import wire

US = 1_000_000


class Host:
    """The plainest host: writes a line, reads lines."""

    def __init__(self, port: str) -> None:
        self.port = serial.Serial(port, wire.BAUD, timeout=0.05)
        self.ids = itertools.count(100)
        self.events: list[wire.Event] = []
        self._lines = wire.Lines()
        self._pending: list[wire.Reply | wire.Event] = []

    def send(self, text: str) -> None:
        self.port.write(wire.encode(text))

    def next(self, timeout_s: float = 5.0) -> wire.Reply | wire.Event | None:
        end = time.monotonic() + timeout_s
        while not self._pending and time.monotonic() < end:
            for line in self._lines.feed(self.port.read(4096)):
                text = wire.decode(line)
                said = wire.parse(text) if text is not None else None
                if said is not None:
                    self._pending.append(said)
        return self._pending.pop(0) if self._pending else None

    def reply(self, timeout_s: float = 5.0) -> wire.Reply | None:
        while (said := self.next(timeout_s)) is not None:
            if isinstance(said, wire.Reply):
                return said
            self.events.append(said)
        return None

    def ask(self, command: str, request: int | None = None) -> wire.Reply:
        number = next(self.ids) if request is None else request
        self.send(f"{number} {command}")
        reply = self.reply()
        if reply is not None and reply.code == "GARBLED":  # it began to listen in the middle of the line
            self.send(f"{number} {command}")
            reply = self.reply()
        assert reply is not None, f"no reply to {command}"
        assert reply.id == number
        return reply

    def event(self, name: str, timeout_s: float = 8.0) -> wire.Event:
        end = time.monotonic() + timeout_s
        while (found := next((e for e in self.events if e.name == name), None)) is None:
            assert time.monotonic() < end, f"no event {name} among {self.events}"
            said = self.next(0.2)
            if isinstance(said, wire.Event):
                self.events.append(said)
        return found


@pytest.fixture
def host(board: BoardProcess) -> Iterator[Host]:
    host = Host(board.port)
    yield host
    host.port.close()


@pytest.fixture
def greeted(host: Host) -> Host:
    assert host.ask("HELLO 1").ok
    return host


def test_a_boot_is_announced_and_everything_is_off(board: BoardProcess, host: Host) -> None:
    board.do("reset")  # what came before the port was opened has been thrown away
    boot = host.event("BOOT")
    assert boot.device_us == 0
    assert (boot.fields["protocol"], boot.fields["reset"]) == ("1", "EXTERNAL")
    assert [board.level(pin) for pin in ("lamp", "main", "alarm", "motor")] == [0, 0, 0, 0]


def test_nothing_but_hello_is_taken_before_hello(board: BoardProcess, host: Host) -> None:
    for command in ("LAMP ON 2000", "PING 500", "STATUS", "DOOR OPEN", "NONSENSE"):
        assert host.ask(command).code == "HELLO"
    hello = host.ask("HELLO 1")
    assert hello.ok
    assert {"protocol", "firmware", "boot", "reset", "max_on_ms"} <= hello.fields.keys()
    assert hello.fields["reset"] == "POWER"
    assert board.pins[0].name == "main"  # no output has moved before


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("HELLO 2", "VERSION"),
        ("HELLO", "ARGUMENT"),
        ("FROBNICATE", "COMMAND"),
        ("LAMP ON", "ARGUMENT"),
        ("LAMP ON 0", "RANGE"),
        ("LAMP ON 2001", "RANGE"),
        ("LAMP ON -5", "ARGUMENT"),
        ("LAMP ON 99999999999999", "RANGE"),
        ("LAMP DIM", "ARGUMENT"),
        ("PING", "ARGUMENT"),
        ("PING 2001", "RANGE"),
        ("LIMITS 14400001 1000 300", "RANGE"),
        ("LIMITS 0 1000 300", "RANGE"),
        ("LIMITS 1000 49 300", "RANGE"),
        ("LIMITS 1000 1000 1001", "RANGE"),
        ("LIMITS 1000 1000", "ARGUMENT"),
        ("LIMITS 1 2 3 4 5 6 7 8 9", "ARGUMENT"),
        ("DOOR AJAR", "ARGUMENT"),
        ("STATUS NOW", "ARGUMENT"),
        ("ACK NONSENSE", "ARGUMENT"),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_reason(greeted: Host, command: str, code: str) -> None:
    reply = greeted.ask(command)
    assert not reply.ok
    assert reply.code == code


@pytest.mark.parametrize(
    "line",
    [
        b"500 LAMP ON 2000*0000\n",
        b"500 LAMP ON 2000\n",
        b"LAMP ON 2000*" + wire.encode("LAMP ON 2000")[-5:],
        wire.encode("0 LAMP ON 2000"),
        wire.encode("65536 LAMP ON 2000"),
        wire.encode("5x LAMP ON 2000"),
        wire.encode("500 LAMP ON 2000 " + "X" * 60),
        b"X" * 500 + wire.encode("500 LAMP ON 2000"),
        b"\xff\x00" + wire.encode("500 LAMP ON 2000"),
    ],
)
def test_a_line_that_is_not_whole_is_called_garbled_and_does_nothing(
    board: BoardProcess, greeted: Host, line: bytes
) -> None:
    greeted.port.write(line)
    reply = greeted.reply()
    assert reply is not None
    assert (reply.id, reply.code) == (0, "GARBLED")
    assert greeted.ask("STATUS").fields["lamp"] == "OFF"


def test_noise_on_the_line_never_switches_anything_on(board: BoardProcess, greeted: Host) -> None:
    """Random bytes, and good commands with a byte changed, which the checksum must catch (a burst of 8 bits)."""
    rng = random.Random(1)
    good = [wire.encode(f"{n} {command}") for n, command in enumerate(("LAMP ON 2000", "DOOR OPEN"), 200)]
    moved = len(board.pins)
    for _ in range(60):
        greeted.port.write(rng.randbytes(rng.randrange(1, 200)) + b"\n")
        line = bytearray(rng.choice(good))
        line[rng.randrange(len(line) - 1)] ^= rng.randrange(1, 256)
        greeted.port.write(bytes(line))
        greeted.next(0.02)
    greeted.port.write(b"\n")
    while greeted.next(2.0) is not None:
        pass  # each was called garbled; a slow simulator is still at it
    assert greeted.ask("STATUS").fields["lamp"] == "OFF"
    assert board.pins[moved:] == []


def test_empty_lines_and_carriage_returns_are_ignored(greeted: Host) -> None:
    greeted.port.write(b"\r\n\n" + wire.encode("700 PING 0").replace(b"\n", b"\r\n"))
    reply = greeted.reply()
    assert reply is not None
    assert (reply.id, reply.ok) == (700, True)


def test_a_repeated_request_is_answered_again_and_not_done_again(board: BoardProcess, greeted: Host) -> None:
    first = greeted.ask("LAMP ON 2000", 7)
    second = greeted.ask("LAMP ON 2000", 7)
    assert second == first
    off = greeted.ask("LAMP OFF", 8)
    assert off.ok
    assert greeted.ask("LAMP OFF", 8) == off
    assert [pin.value for pin in board.pins if pin.name == "lamp"] == [1, 0]


def test_hello_is_never_answered_from_memory(greeted: Host) -> None:
    first, second = greeted.ask("HELLO 1", 9), greeted.ask("HELLO 1", 9)
    assert second.device_us > first.device_us
    ping = greeted.ask("PING 0", 9)  # nor does it leave an ID behind
    assert ping.fields["lamp"] == "OFF"


def test_the_lamp_is_on_from_the_time_of_the_reply(board: BoardProcess, greeted: Host) -> None:
    reply = greeted.ask("LAMP ON 2000")
    assert reply.fields == {"lamp": "ON", "since": str(reply.device_us)}
    board.pin("lamp", 1)
    status = greeted.ask("STATUS").fields
    assert (status["lamp"], status["since"], status["why"]) == ("ON", str(reply.device_us), "HOST")
    assert 0 < int(status["keep_ms"]) <= 2000


def test_the_lamp_goes_out_when_the_host_falls_silent(board: BoardProcess, greeted: Host) -> None:
    on = greeted.ask("LAMP ON 700")
    alarm = greeted.event("WATCHDOG")
    late_us = alarm.device_us - on.device_us - 700_000
    # The loop of either takes a few ms at most, but the simulated controller may lose its processor to others.
    assert 0 <= late_us < 1 * US
    assert board.pin("lamp", 0).value == 0
    assert greeted.ask("PING 0").fields["why"] == "WATCHDOG"


def test_only_a_ping_keeps_the_lamp_on(greeted: Host) -> None:
    on = greeted.ask("LAMP ON 1000")
    for _ in range(100):
        greeted.ask("STATUS")
        if greeted.ask("PING 0").fields["lamp"] == "OFF":
            break
        time.sleep(0.05)
    assert greeted.event("WATCHDOG").device_us - on.device_us < 2 * US


def test_pings_keep_the_lamp_on_and_the_last_one_says_how_long(greeted: Host) -> None:
    on = greeted.ask("LAMP ON 2000")
    while (last := greeted.ask("PING 2000")).device_us < on.device_us + 3 * US:
        assert last.fields["lamp"] == "ON"
        time.sleep(0.2)
    last = greeted.ask("PING 100")
    off = greeted.event("WATCHDOG")
    assert 100_000 <= off.device_us - last.device_us < 1 * US


def test_the_maximum_on_time_counts_from_the_first_on(board: BoardProcess, greeted: Host) -> None:
    greeted.ask("LIMITS 800 1000 300")
    on = greeted.ask("LAMP ON 2000")
    for _ in range(100):
        greeted.ask("LAMP ON 2000")  # which must not begin it anew
        if greeted.ask("STATUS").fields["why"] == "MAXON":
            break
        time.sleep(0.02)
    alarm = greeted.event("MAXON")
    assert 800_000 <= alarm.device_us - on.device_us < 2 * US
    assert board.pin("lamp", 0)


def test_an_alarm_is_said_until_it_is_acknowledged(board: BoardProcess, greeted: Host) -> None:
    greeted.ask("LAMP ON 100")
    first = greeted.event("WATCHDOG")
    board.pin("alarm", 1)
    assert greeted.ask("PING 0").fields["alarms"] == "WATCHDOG"
    for _ in range(2):
        greeted.events.clear()
        assert greeted.event("WATCHDOG") == first
    assert greeted.ask("ACK WATCHDOG").fields["alarms"] == "-"
    seen = len(board.pins)
    assert board.level("alarm") == 0 or board.pin("alarm", 0, after=seen - 1)
    greeted.events.clear()
    while (said := greeted.next(1.5)) is not None:
        assert not isinstance(said, wire.Event) or said.name != "WATCHDOG"


def test_a_stuck_relay_opens_the_main_relay_and_sounds(board: BoardProcess, greeted: Host) -> None:
    greeted.ask("LIMITS 60000 300 300")
    greeted.ask("LAMP ON 2000")
    greeted.event("LIGHT")
    board.do("relay stuck")
    off = greeted.ask("LAMP OFF")
    fault = greeted.event("LAMPFAULT")
    assert fault.fields["verdict"] == "STUCK"
    assert fault.device_us - off.device_us >= 300_000
    board.pin("main", 0)
    board.pin("alarm", 1)
    assert greeted.ask("LAMP ON 2000").code == "FAULT"
    assert greeted.ask("STATUS").fields["verdict"] == "STUCK"
    assert greeted.ask("HELLO 1").ok  # tries again, with the relay still stuck, and notices again
    greeted.events.clear()
    assert greeted.event("LAMPFAULT").fields["verdict"] == "STUCK"


def test_light_that_cannot_be_switched_off_sounds_whatever_the_host_says(
    board: BoardProcess, greeted: Host
) -> None:
    greeted.ask("LIMITS 60000 300 300")
    board.do("relay stuck")
    board.do("main stuck")
    greeted.event("LAMPFAULT")
    board.pin("alarm", 1)
    greeted.ask("ACK LAMPFAULT")
    time.sleep(0.3)
    assert board.level("alarm") == 1
    board.do("relay free")
    board.pin("alarm", 0)


def test_a_dead_lamp_is_noticed_and_switched_off(board: BoardProcess, greeted: Host) -> None:
    greeted.ask("LIMITS 60000 300 300")
    board.do("lamp dead")
    on = greeted.ask("LAMP ON 2000")
    fault = greeted.event("LAMPFAULT")
    assert fault.fields["verdict"] == "DEAD"
    assert fault.device_us - on.device_us >= 300_000
    board.pin("lamp", 0)
    assert greeted.ask("PING 0").fields["why"] == "FAULT"


def test_without_a_photodiode_there_is_no_verdict(board: BoardProcess, greeted: Host) -> None:
    greeted.ask("LIMITS 60000 50 0")
    board.do("lamp dead")
    greeted.ask("LAMP ON 2000")
    time.sleep(0.5)
    status = greeted.ask("STATUS").fields
    assert (status["lamp"], status["verdict"]) == ("ON", "NONE")


def test_the_photodiode_tells_when_the_light_came_and_went(greeted: Host) -> None:
    on = greeted.ask("LAMP ON 2000")
    came = greeted.event("LIGHT")
    assert came.fields["state"] == "ON"
    assert came.device_us >= on.device_us + 40_000  # that is how long the wired lamp takes
    greeted.events.clear()
    off = greeted.ask("LAMP OFF")
    went = greeted.event("LIGHT")
    assert went.fields["state"] == "OFF"
    assert went.device_us >= off.device_us + 40_000


def test_the_door_opens_and_closes_between_its_end_switches(board: BoardProcess, greeted: Host) -> None:
    for command, motor, state in (("OPEN", 1, "OPEN"), ("CLOSE", -1, "CLOSED")):
        greeted.events.clear()
        seen = len(board.pins)
        sent = greeted.ask(f"DOOR {command}")
        assert sent.fields["drive"] == command
        board.pin("motor", motor, after=seen)
        assert greeted.event("DOOR").fields["state"] == "BETWEEN"
        greeted.events.clear()
        arrived = greeted.event("DOOR")
        assert arrived.fields["state"] == state
        assert arrived.device_us - sent.device_us >= 250_000  # travel is 280 ms from the first pulse
        board.pin("motor", 0, after=seen)  # no humming while a camera looks
        status = greeted.ask("STATUS").fields
        assert (status["door"], status["drive"]) == (state, "IDLE")
        assert int(status["door_us"]) == arrived.device_us


def test_a_stuck_door_is_an_alarm_and_the_motor_rests(board: BoardProcess, greeted: Host) -> None:
    board.do("door stuck")
    sent = greeted.ask("DOOR OPEN")
    alarm = greeted.event("DOORSTUCK")
    assert alarm.fields["to"] == "OPEN"
    assert 3 * US <= alarm.device_us - sent.device_us < 4 * US
    board.pin("motor", 0)
    assert greeted.ask("STATUS").fields["drive"] == "STUCK"
    board.do("door free")
    greeted.events.clear()
    assert greeted.ask("DOOR OPEN").ok
    assert eventually(lambda: greeted.ask("STATUS").fields["door"] == "OPEN")


def test_a_door_that_a_hand_moves_is_noticed(board: BoardProcess, greeted: Host) -> None:
    board.do("push 0.5")
    assert greeted.event("DOOR").fields["state"] == "BETWEEN"
    assert greeted.ask("STATUS").fields["drive"] == "IDLE"


def test_door_stop_leaves_it_between(board: BoardProcess, greeted: Host) -> None:
    greeted.ask("DOOR OPEN")
    board.pin("motor", 1)
    assert greeted.event("DOOR").fields["state"] == "BETWEEN"
    greeted.ask("DOOR STOP")
    board.pin("motor", 0)
    status = greeted.ask("STATUS").fields
    assert status["drive"] == "IDLE"


@pytest.mark.parametrize(("what", "cause"), [("reset", "EXTERNAL"), ("hang", "WATCHDOG")])
def test_a_reset_switches_off_and_cannot_be_overlooked(
    board: BoardProcess, greeted: Host, what: str, cause: str
) -> None:
    before = int(greeted.ask("HELLO 1").fields["boot"])
    greeted.ask("LAMP ON 2000")
    board.pin("lamp", 1)
    greeted.events.clear()
    board.do(what)
    board.pin("lamp", 0, timeout_s=1.9)  # before the heartbeat would
    boot = greeted.event("BOOT")
    assert (int(boot.fields["boot"]), boot.fields["reset"]) == (before + 1, cause)
    assert greeted.ask("PING 2000").code == "HELLO"


def test_servo_pulses_are_as_wide_as_they_are_meant_to_be(firmware: list[str], tmp_path: Path) -> None:
    """The timer sets and clears the pin by itself: half a microsecond a tick, and no interrupt adds to it."""
    board = BoardProcess(firmware, tmp_path / "port")
    host = Host(board.port)
    host.ask("HELLO 1")
    for command, pulse_us in (("OPEN", 2000), ("CLOSE", 1000)):
        host.ask(f"DOOR {command}")
        assert eventually(lambda pulse_us=pulse_us: abs(board.pulse_us() - pulse_us) <= 1)
    host.port.close()
    board.close()


def test_the_clock_survives_32_bits_of_microseconds(
    firmware: list[str], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """2^32 us are 131072 turns of the timer; this build starts 31 turns, 1.016 s, before."""
    command = build_firmware(tmp_path_factory.mktemp("late"), "-DFIRST_OVERFLOW=131041")
    board = BoardProcess(command, tmp_path / "port")
    host = Host(board.port)
    before = host.ask("HELLO 1").device_us
    host.ask("LAMP ON 2000")
    times = [before]
    while times[-1] < 2**32 + US:
        reply = host.ask("PING 2000")
        assert reply.fields["lamp"] == "ON"
        times.append(reply.device_us)
        time.sleep(0.05)
    assert before < 2**32
    assert times == sorted(times)
    assert max(b - a for a, b in itertools.pairwise(times)) < 2 * US
    host.ask("LAMP ON 100")
    assert host.event("WATCHDOG").device_us > 2**32
    host.port.close()
    board.close()
