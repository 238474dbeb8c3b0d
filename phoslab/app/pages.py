"""HTML pages from templates: one look for all reports, everything in one file."""

from __future__ import annotations

from typing import Any


def render(template: str, **values: Any) -> str:
    """Fill a template of this folder."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    # Names and notes come from files that anyone may have written: everything is escaped.
    environment = Environment(
        loader=PackageLoader("phoslab.app", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template(template).render(**values)
