"""A model plan: what of a scene is modelled and what is left out, as plain data that a person can read and edit.

`phoslab plan` makes one, `phoslab render --plan` follows it. Errors are in the unit of the bound that was asked for.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

from phoslab import __version__, schemas
from phoslab.errors import PhoslabError
from phoslab.files import read_regular, write_text
from phoslab.journal import decode

SCHEMA = "phoslab-plan/1"

# What no plan models.
OUTSIDE = "outside"

_LARGEST_BYTES = 1 << 24


@dataclass(frozen=True)
class Term:
    """One decision.

    Args:
        name: what is decided.
        choice: what was chosen.
        error: what it adds to the error, in the bound's unit; None: not known.
        kind: "bound" where the error cannot be larger, "estimate" where it was measured on samples, "outside" where no
            plan models it: not in the sum, nor in the bound.
        why: the reason, in one line.
        seconds: what it takes of the predicted time.
    """

    name: str
    choice: str
    error: float | None
    kind: str
    why: str
    seconds: float = 0.0


@dataclass(frozen=True)
class Surface:
    """How one mesh with a phosphor is modelled.

    Args:
        glows: whether its glow is modelled at all; else it only reflects.
        states: the states that are kept, by their number in the material; several in one group become one state.
        atlas_texels: texels along the side of its state.
    """

    glows: bool
    states: tuple[tuple[int, ...], ...]
    atlas_texels: int


@dataclass(frozen=True)
class Choices:
    """All that a plan decides.

    Args:
        bands_nm: edges of the bands in which light travels.
        surfaces: by the name of the mesh.
        solver, step_s, state_format: how states advance.
        gi: parameters of glow transport, by name; `method` among them.
    """

    bands_nm: tuple[float, ...]
    surfaces: Mapping[str, Surface]
    solver: str
    step_s: float
    state_format: str
    gi: Mapping[str, Any]


@dataclass(frozen=True)
class ModelPlan:
    """A plan for one scene, size and times.

    Args:
        scene: folder and file of the scene.
        scene_sha256: the hash of its scene.toml.
        bound: how wrong the picture may be, as `2%`, `1dE` or `0.05flip`.
        notes: what the bound does not cover.
        predicted_s: the time of all pictures in s.
    """

    scene: str
    scene_sha256: str
    bound: str
    size: tuple[int, int]
    times: tuple[str, ...]
    choices: Choices
    terms: tuple[Term, ...]
    predicted_s: float
    notes: tuple[str, ...] = field(default=())

    @property
    def predicted_error(self) -> float:
        """The sum of what all decisions add, in the bound's unit."""
        return math.fsum(term.error or 0.0 for term in self.terms if term.kind != OUTSIDE)

    @property
    def worst(self) -> Term:
        """The decision that adds most."""
        return max((t for t in self.terms if t.kind != OUTSIDE), key=lambda term: term.error or 0.0)

    def to_json(self) -> str:
        """Return the plan file's text; `read_plan` gives back the same plan."""
        data = {
            "schema": SCHEMA,
            "phoslab": __version__,
            **asdict(self),
            "predicted_error": self.predicted_error,
        }
        return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def save(self, path: str | PathLike[str]) -> None:
        """Write the plan file, whole or not at all."""
        write_text(path, self.to_json())


def read_plan(path: str | PathLike[str]) -> ModelPlan:
    """Read a plan file.

    Raises:
        PhoslabError: it is missing, malformed or of an unknown version.
    """
    file = Path(path)
    remedy = "Make one: phoslab plan SCENE -o plan.json."
    text = decode(read_regular(file, _LARGEST_BYTES, remedy=remedy), file, "the file", remedy=remedy)
    data: Any = schemas.read_json(text, file=file)
    version = data.get("schema") if isinstance(data, dict) else None
    if version != SCHEMA:
        raise PhoslabError(
            f"is {version!r}, which this version of phoslab cannot read",
            file=file,
            field="schema",
            remedy=f"It reads {SCHEMA!r}.",
        )
    schemas.check(data, "plan-1", file=file)
    made = data["choices"]
    return ModelPlan(
        scene=data["scene"],
        scene_sha256=data.get("scene_sha256", ""),
        bound=data["bound"],
        size=(data["size"][0], data["size"][1]),
        times=tuple(data["times"]),
        choices=Choices(
            bands_nm=tuple(float(e) for e in made["bands_nm"]),
            surfaces={
                name: Surface(s["glows"], tuple(tuple(group) for group in s["states"]), s["atlas_texels"])
                for name, s in made["surfaces"].items()
            },
            solver=made["solver"],
            step_s=float(made["step_s"]),
            state_format=made["state_format"],
            gi=dict(made["gi"]),
        ),
        terms=tuple(
            Term(
                str(t["name"]),
                str(t["choice"]),
                None if t["error"] is None else float(t["error"]),
                t["kind"],
                str(t["why"]),
                float(t.get("seconds", 0.0)),
            )
            for t in data["terms"]
        ),
        predicted_s=float(data["predicted_s"]),
        notes=tuple(data.get("notes", ())),
    )
