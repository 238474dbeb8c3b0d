"""The person beside the rig: what to ask a hand for, and who answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from phoslab.instruments.plans.steps import Stage

_LVF = {
    "none": "Take the LVF away",
    "camera": "Put the LVF before the camera, between lens and {target}",
    "sample": "Put the LVF on the {target}",
}
_LIGHT = {
    "lamp": "Switch LED and mercury lamp off; let the rig's lamp shine on the {target}",
    "led": "Switch the white LED on and let it shine on the {target}; switch the mercury lamp off",
    "mercury": "Switch the mercury lamp on and let it shine on the {target} (it emits UV: wear glasses)",
}


def instructions(now: Stage | None, wanted: Stage) -> list[str]:
    """Say what a hand must do to bring the bench from `now` (None: nobody knows) to `wanted`.

    >>> instructions(Stage("card"), Stage("sample", lvf="camera"))
    ['Put the sample in place of the card.', 'Put the LVF before the camera, between lens and sample.']
    >>> instructions(Stage("sample"), Stage("sample"))
    []
    """
    target = "grey card" if wanted.target == "card" else wanted.target
    texts = []
    if now is None or now.target != wanted.target:
        texts.append(f"Put the {target} in place" + (f" of the {now.target}." if now else "."))
    if (now is None and wanted.light != "lamp") or (now is not None and now.light != wanted.light):
        texts.append(_LIGHT[wanted.light].format(target=target) + ".")
    if now is None or now.lvf != wanted.lvf:
        texts.append(_LVF[wanted.lvf].format(target=target) + ".")
    if (now is None and wanted.filter != "none") or (now is not None and now.filter != wanted.filter):
        if wanted.filter == "none":
            texts.append("Take the colour filter away.")
        else:
            where = f" ({wanted.progress})" if wanted.progress else ""
            texts.append(f"Put filter {wanted.filter} in the light's way{where}.")
    if (now is None and wanted.angle_deg) or (now is not None and now.angle_deg != wanted.angle_deg):
        texts.append(f"Turn the sample to {wanted.angle_deg:g} degrees from the camera's axis.")
    return texts


@runtime_checkable
class Operator(Protocol):
    """Who does by hand what the rig cannot."""

    def do(self, texts: list[str], stage: Stage | None, check: Callable[[], None]) -> None:
        """Have it done, and return when it is.

        Args:
            texts: instructions for people.
            stage: how the bench stands afterwards; None if only the door is concerned.
            check: to call now and then while waiting; it raises when the plan shall stop.
        """
