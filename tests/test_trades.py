"""trade.json: what ships is readable, and what is not a trade is refused by its field."""

import json
from importlib.resources import files

import pytest

import phoslab.trades
from phoslab.errors import PhoslabError
from phoslab.render.solvers import SOLVERS
from phoslab.render.state_formats import FORMATS
from phoslab.trades import load


def test_the_trade_that_ships_knows_every_solver_and_format():
    trade = load("solver")
    assert not trade["quick"]  # a planner must not plan by a measurement in a hurry
    assert {(s["solver"], s["state_format"]) for s in trade["steps"]} == {
        (s, f) for s in SOLVERS for f in FORMATS
    }
    assert all(s["bytes_per_texel"] == FORMATS[s["state_format"]].bytes_per_texel(2) for s in trade["steps"])
    assert {p["problem"] for p in trade["points"]} >= {"constant", "switched", "sinusoidal", "mains flicker"}


def test_a_trade_of_another_machine_is_read_from_its_file(tmp_path):
    other = load("solver")
    other["machine"]["processor"] = "another"
    path = tmp_path / "trade.json"
    path.write_text(json.dumps(other))
    assert load("solver", path) == other


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": "gi"}, "kind is 'gi', and 'solver' is asked for"),
        ({"schema": "phoslab-trade/2"}, "schema"),
        ({"machine": {}}, "machine"),
        ({"steps": None}, "steps"),
        ({"points": [{"error": -1.0}]}, r"points\[0\]"),
    ],
)
def test_what_is_no_such_trade_is_refused(tmp_path, change, says):
    path = tmp_path / "trade.json"
    path.write_text(json.dumps(json.loads((files(phoslab.trades) / "solver.json").read_text()) | change))
    with pytest.raises(PhoslabError, match=says) as caught:
        load("solver", path)
    assert caught.value.file == str(path)


def test_a_trade_that_is_not_there_says_how_to_make_one(tmp_path):
    with pytest.raises(PhoslabError, match="phoslab trade solver -o DIR"):
        load("solver", tmp_path / "none.json")
