"""The published JSON Schemas of phoslab's files, and checking against them."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from os import PathLike
from typing import Any

from phoslab.errors import PhoslabError


@cache
def _validator(name: str) -> Any:
    from jsonschema import Draft202012Validator

    schema = json.loads((files(__package__) / f"{name}.schema.json").read_text(encoding="utf-8"))
    return Draft202012Validator(schema)


def check(data: Any, name: str, *, file: str | PathLike[str] | None, where: str = "") -> None:
    """Check `data` against the schema `name` ("material-1").

    Args:
        data: what was read, as plain dicts, lists, strings and numbers.
        file: the file it came from, for the message.
        where: what to put before the field's name in the message ("line 12: ").

    Raises:
        PhoslabError: `data` does not fit; the error names the deepest field that is wrong.
    """
    from jsonschema.exceptions import best_match

    error = best_match(_validator(name).iter_errors(data))
    if error is None:
        return
    field = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in error.absolute_path).lstrip(".")
    described = error.schema.get("description") if isinstance(error.schema, dict) else None
    raise PhoslabError(
        f"does not fit the format: {error.message[:300]}",
        file=file,
        field=f"{where}{field or 'the top level'}",
        remedy=f"It must be: {described}." if described else f"See the schema {name}.schema.json.",
    )


def read_json(text: str, *, file: str | PathLike[str] | None, where: str = "the file") -> Any:
    """Parse strict JSON: no NaN, no infinity, no field given twice.

    Raises:
        PhoslabError: the text is not JSON in this sense.
    """

    def refuse_constant(token: str) -> Any:
        raise ValueError(f"{token} is not a number in JSON")

    def finite(token: str) -> float:
        number = float(token)
        if number in (float("inf"), float("-inf")):
            raise ValueError(f"{token} is too large for a float64")
        return number

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        fields = dict(pairs)
        if len(fields) != len(pairs):
            raise ValueError("a field is given twice")
        return fields

    try:
        return json.loads(text, parse_constant=refuse_constant, parse_float=finite, object_pairs_hook=unique)
    except (ValueError, RecursionError) as error:
        raise PhoslabError(
            f"is not valid JSON: {error}", file=file, field=where, remedy="Correct it or write it anew."
        ) from error
