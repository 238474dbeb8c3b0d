"""The rig controller's driver: a lamp and a door on one serial line.

    rig = RigController("usb:2341:0043")
    rig.lamp.stage()
    rig.lamp.allow_until(time.monotonic() + 60)
    rig.lamp.set("on").wait(3)
    ...
    rig.lamp.unstage()

What goes wrong between calls (a stuck relay, a reset, a pulled cable, a lamp that went out) is told to those who
subscribed, at once, and raised by every call from then on, until `stage`; only switching off, `stop` and `unstage`
are never refused. Whatever it is, the lamp is not kept on any longer.

Time-outs of the line are in real time, the door's in the controller's. `clock` may be another: promises
(`allow_until`) and readings are in its time.
"""

from __future__ import annotations

from phoslab.instruments.devices import Clock
from phoslab.instruments.rig_connection import RigConnection
from phoslab.instruments.rig_parts import RigDoor, RigLamp


class RigController(RigConnection):
    """The connection to one controller board, its `lamp` and its `door`.

    Args:
        port: see ports.resolve; looked up anew at every `stage`, so that an adapter may move.
        name: of the board, in messages.
        max_on_s: maximum on-time, which the board enforces.
        settle_s: how long lamp and photodiode may disagree after a change.
        threshold: photodiode value (1..1000) from which on the lamp shines; 0: there is no photodiode.
        clock: the host's.
    """

    def __init__(
        self,
        port: str,
        *,
        name: str = "rig",
        max_on_s: float = 7200.0,
        settle_s: float = 1.0,
        threshold: int = 300,
        clock: Clock | None = None,
    ) -> None:
        super().__init__(
            port, name=name, max_on_s=max_on_s, settle_s=settle_s, threshold=threshold, clock=clock
        )
        self.lamp = RigLamp(self)
        self.door = RigDoor(self)
