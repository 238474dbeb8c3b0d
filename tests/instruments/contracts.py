"""What every lamp and every door must do, whoever made them: test classes to inherit.

A subclass gives the fixtures `lamp` or `door` (made, not staged) and, for what only the outside can see, `shines`.
Times are compared with a margin for a busy computer: a lamp may be on for LATE_S more than was promised, never less
than it was promised to stay on.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

import pytest
from boards import eventually, raises_soon

from phoslab.instruments.devices import Device, DeviceError, Door, Lamp

LATE_S = 1.0


class DeviceContract:
    """What lamps and doors have in common. A subclass gives `device`."""

    @pytest.fixture
    def staged(self, device: Device) -> Iterator[Device]:
        device.stage()
        yield device
        device.unstage()

    def test_it_follows_the_protocol_of_bluesky(self, staged: Device) -> None:
        from bluesky.protocols import Readable, Stageable, Stoppable, check_supports

        for protocol in (Readable, Stageable, Stoppable):
            check_supports(staged, protocol)

    def test_readings_are_described_and_have_unit_and_time(self, staged: Device) -> None:
        readings, described = staged.read(), staged.describe()
        assert readings.keys() == described.keys()
        assert next(iter(readings)) == staged.name
        now_s, now = time.monotonic(), time.time()
        for name, reading in readings.items():
            assert {"value", "unit", "timestamp", "mono_s", "device_s"} == reading.keys()
            assert described[name]["units"] == reading["unit"]
            assert {"source", "dtype", "shape"} <= described[name].keys()
            assert reading["mono_s"] <= now_s + LATE_S
            # Both clocks name the same moment.
            assert math.isclose(now - reading["timestamp"], now_s - reading["mono_s"], abs_tol=LATE_S)

    def test_unstaging_is_harmless_and_may_be_repeated(self, device: Device) -> None:
        device.unstage()
        device.stage()
        device.unstage()
        device.unstage()

    def test_it_can_be_staged_again(self, device: Device) -> None:
        for _ in range(2):
            device.stage()
            assert device.read()
            device.unstage()

    def test_what_is_not_staged_says_so(self, device: Device) -> None:
        with pytest.raises(DeviceError, match="not staged"):
            device.read()

    def test_stop_is_harmless_at_any_moment(self, device: Device) -> None:
        device.stop()
        device.stage()
        device.stop()
        device.stop(success=True)
        device.unstage()
        device.stop()

    def test_nonsense_is_refused_with_what_is_possible(self, staged: Device) -> None:
        assert isinstance(staged, Lamp | Door)
        with pytest.raises(DeviceError, match='Set it "o'):
            staged.set("sideways")  # type: ignore[arg-type]


class LampContract(DeviceContract):
    """A subclass gives `lamp`, and `shines`: whether the lamp is switched on, seen from outside."""

    @pytest.fixture
    def device(self, lamp: Lamp) -> Device:
        return lamp

    def test_it_is_a_lamp(self, lamp: Lamp) -> None:
        assert isinstance(lamp, Lamp)
        assert isinstance(lamp.failsafe, bool)

    def test_it_is_off_when_staged_and_after_unstaging(self, lamp: Lamp, shines: Callable[[], bool]) -> None:
        lamp.stage()
        assert lamp.read()[lamp.name]["value"] == "off"
        lamp.set("on").wait(5)
        assert eventually(shines)
        lamp.unstage()
        assert eventually(lambda: not shines())

    def test_switching_shows_outside_and_in_its_reading(
        self, staged: Lamp, shines: Callable[[], bool]
    ) -> None:
        for value, lit in (("on", True), ("off", False), ("on", True)):
            before_s = time.monotonic()
            status = staged.set(value)  # type: ignore[arg-type]
            status.wait(5)
            after_s = time.monotonic()
            assert status.done
            assert status.success
            assert eventually(lambda lit=lit: shines() == lit)
            readings = staged.read()
            assert readings[staged.name]["value"] == value
            edge_s = readings[staged.name]["mono_s"]
            # The edge came between the command and its status, to within what the lamp says of itself.
            doubt_s = readings[f"{staged.name}_uncertainty"]["value"]
            assert 0 <= doubt_s < LATE_S
            assert before_s - doubt_s <= edge_s <= after_s + doubt_s

    def test_setting_what_is_already_so_is_no_new_edge(self, staged: Lamp) -> None:
        staged.set("on").wait(5)
        first = staged.read()[staged.name]
        time.sleep(0.1)
        staged.set("on").wait(5)
        second = staged.read()[staged.name]
        # By the device's own clock, where it has one: the mapping to the host's is refined all the time.
        clock = "mono_s" if first["device_s"] is None else "device_s"
        assert second[clock] == first[clock]

    def test_it_stays_on_as_long_as_was_promised_and_no_longer(
        self, staged: Lamp, shines: Callable[[], bool]
    ) -> None:
        until_s = time.monotonic() + 3.0  # more than any heartbeat keeps it on
        staged.allow_until(until_s)
        staged.set("on").wait(5)
        assert eventually(shines)
        while (now_s := time.monotonic()) < until_s - 0.3:
            assert shines() or time.monotonic() > until_s, f"out {until_s - now_s:g} s too early"
            time.sleep(0.02)
        assert eventually(lambda: not shines(), until_s - time.monotonic() + LATE_S)

    def test_a_renewed_promise_holds(self, staged: Lamp, shines: Callable[[], bool]) -> None:
        staged.allow_until(time.monotonic() + 1.0)
        staged.set("on").wait(5)
        staged.allow_until(time.monotonic() + 4.0)
        time.sleep(2.0)
        assert shines()

    def test_a_lamp_that_went_out_by_itself_is_an_error_until_it_is_staged_again(
        self, staged: Lamp, shines: Callable[[], bool]
    ) -> None:
        told: list[DeviceError] = []
        getattr(staged, "subscribe", told.append)(told.append)
        staged.allow_until(time.monotonic() + 0.3)
        staged.set("on").wait(5)
        assert eventually(lambda: not shines())
        raises_soon(staged.read, "promise")
        with pytest.raises(DeviceError, match="promise"):
            staged.read()
        with pytest.raises(DeviceError, match="promise"):
            staged.set("on").wait(5)
        staged.set("off").wait(5)  # never refused
        assert not shines()
        staged.stage()
        staged.set("on").wait(5)
        assert eventually(shines)

    def test_stop_switches_off_from_another_thread(self, staged: Lamp, shines: Callable[[], bool]) -> None:
        import threading

        staged.set("on").wait(5)
        assert eventually(shines)
        other = threading.Thread(target=staged.stop)
        other.start()
        other.join(5)
        assert not other.is_alive()
        assert eventually(lambda: not shines())
        staged.read()  # and that is no error


class DoorContract(DeviceContract):
    """A subclass gives `door`."""

    @pytest.fixture
    def device(self, door: Door) -> Device:
        return door

    def test_it_is_a_door(self, door: Door) -> None:
        assert isinstance(door, Door)

    def test_it_arrives_where_it_is_set(self, staged: Door) -> None:
        for value in ("open", "closed", "closed", "open"):
            before_s = time.monotonic()
            status = staged.set(value)  # type: ignore[arg-type]
            status.wait(60)
            assert status.success
            readings = staged.read()
            assert readings[staged.name]["value"] == value
            edge_s = readings[staged.name]["mono_s"]
            assert edge_s <= time.monotonic()
            # Arrival is after the command, but where it was there already.
            doubt_s = readings[f"{staged.name}_uncertainty"]["value"]
            assert value == "closed" or edge_s >= before_s - doubt_s

    def test_a_stopped_door_can_be_set_again(self, staged: Door) -> None:
        staged.set("open")
        staged.stop()
        staged.set("closed").wait(60)
        assert staged.read()[staged.name]["value"] == "closed"

    def test_set_does_not_wait(self, staged: Door) -> None:
        status = staged.set("open")
        assert not status.done  # a door takes a tenth of a second or more
        status.wait(60)
