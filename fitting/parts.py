"""The parts of a session: stretches of its plan that were each done in one go, with the frames of each."""

from __future__ import annotations

from dataclasses import dataclass

from phoslab.session import Frame, Session


@dataclass(frozen=True)
class SessionPart:
    """A part that was finished.

    Args:
        name: as the plan says.
        frames: taken in it, in order, without dark frames and trials.
        lamp_off_s: the last time that the lamp went off before the first of them, or None.
        arguments: what was asked of the hand that placed things, the last time: `filter`, `angle_deg`, `lvf`.
    """

    name: str
    frames: tuple[Frame, ...]
    lamp_off_s: float | None
    placed: dict[str, object]


def finished_parts(session: Session) -> list[SessionPart]:
    """Return them in order; of a part that was begun again, the attempt that came to its end."""
    by_name = {f.name: f for f in session.frames}
    off_s = [e.at_s for e in session.edges_of("lamp") if e.to == "off"]
    parts: list[SessionPart] = []
    name, begun = "", -1
    frames: list[Frame] = []
    placed: dict[str, object] = {}
    for event in session.events:
        fields = event.fields
        if event.event == "command" and (fields["device"], fields["name"]) == ("plan", "part"):
            name, begun, frames = str(fields["arguments"]["part"]), event.seq, []
        elif event.event == "command" and (fields["device"], fields["name"]) == ("hand", "place"):
            placed = dict(fields["arguments"])
        elif event.event == "exposure" and (frame := by_name.get(str(fields["frame"]))) is not None:
            if frame.role not in ("dark", "meter"):
                frames.append(frame)
        elif event.event == "ack" and fields["command"] == begun and fields["ok"] and frames:
            before = [t for t in off_s if t <= frames[0].start_s]
            parts.append(SessionPart(name, tuple(frames), max(before, default=None), dict(placed)))
            frames = []
    return parts
