"""rig.toml: what is wrong in it is refused by its name, before anything is opened."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest

from phoslab.errors import PhoslabError
from phoslab.instruments.rig import DRIVERS, Rig, connect

PAGE = Path(__file__).parents[2] / "docs" / "formats-rig.md"


def example() -> dict[str, Any]:
    """The example of the documentation."""
    block = [line[4:] for line in PAGE.read_text().splitlines() if line.startswith("    ")]
    return tomllib.loads("\n".join(block))


def refused(change: Any) -> PhoslabError:
    data = copy.deepcopy(example())
    change(data)
    with pytest.raises(PhoslabError) as caught:
        Rig.of(data)
    assert caught.value.remedy
    return caught.value


def test_the_documented_example_is_a_rig() -> None:
    rig = Rig.of(example())
    assert rig.max_on_s == 7200
    assert rig.frame_bytes == 27_000_000
    setup = rig.setup()
    assert setup.ladder.isos[-1] <= 1600
    assert setup.filters == ("R02", "R27", "R80")
    assert setup.fade_s == 0.32


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda d: d.update(colour="red"), "'colour' was unexpected"),
        (lambda d: d["lamp"].update(watts=400), "'watts' was unexpected"),
        (lambda d: d["camera"]["limits"].update(iso=100), "'iso' was unexpected"),
        (lambda d: d.pop("door"), "'door' is a required property"),
        (lambda d: d["lamp"].update(max_on_s=-1), "lamp.max_on_s"),
        (lambda d: d["lamp"].update(driver="bulb"), "'bulb', which is no driver of a lamp"),
        (lambda d: d["door"].update(driver="gphoto2"), "no driver of a door"),
        (lambda d: d.update(schema="phoslab-rig/2"), "schema"),
        (lambda d: d["filters"]["names"].append("R02"), "filters.names"),
        (lambda d: d["filters"]["names"].append("../R02"), "filters.names"),
    ],
)
def test_what_is_wrong_in_a_rig_file_is_named(change: Any, named: str) -> None:
    assert named in str(refused(change))


def test_an_unknown_driver_comes_with_those_that_there_are() -> None:
    error = refused(lambda d: d["camera"].update(driver="nikon"))
    assert all(name in error.remedy for name in DRIVERS["camera"])


def test_a_file_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[lamp\n")
    with pytest.raises(PhoslabError, match="not valid TOML"):
        Rig.load(path)
    with pytest.raises(PhoslabError, match=r"Name a rig file"):
        Rig.load(tmp_path / "absent.toml")


def test_limits_that_leave_nothing_are_refused() -> None:
    data = example()
    data["camera"]["limits"] = {"iso_min": 100_000, "iso_max": 200_000}
    with pytest.raises(PhoslabError, match="no exposure time or ISO"):
        Rig.of(data).setup()


def test_a_rig_comes_back_from_a_sessions_header(tmp_path: Path) -> None:
    from phoslab import journal

    rig = Rig.of(example(), tmp_path / "rig.toml")
    header = rig.header({"make": "Canon", "model": "EOS 5D Mark II", "serial": None})
    assert header["camera"]["model"] == "EOS 5D Mark II"
    assert "serial" not in header["camera"]
    again = Rig.from_header(journal.frozen(header["rig"]))
    assert again.data == rig.data
    assert again.file == tmp_path / "rig.toml"


def test_what_a_driver_needs_and_lacks_is_named() -> None:
    data = example()
    del data["lamp"]["port"]
    with pytest.raises(PhoslabError, match=r"lamp\.port is missing"):
        connect(Rig.of(data), None, None, lambda: None)  # type: ignore[arg-type] # refused before either is used
