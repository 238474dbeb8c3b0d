"""What pictures cost, as plans read it from a trade: by the variant of Mitsuba that this machine takes."""

from __future__ import annotations

import json
from importlib.resources import files

import pytest

import phoslab.trades
from phoslab.errors import PhoslabError
from phoslab.render import path_tracer
from phoslab.render.planning import costs
from phoslab.render.planning.costs import FEATURES, PATH_FEATURES, load_costs

PATHS_S = {
    path_tracer.LLVM: {"path_start": 1.0, "path_picture": 0.1, "path": 1e-7},
    path_tracer.SCALAR: {"path_start": 0.0, "path_picture": 0.01, "path": 1e-6},
}


@pytest.fixture
def trade(tmp_path):
    """Write a trade whose paths cost what is given."""

    def write(costs_s: dict[str, float], **more: object):
        data = json.loads((files(phoslab.trades) / "model.json").read_text())
        data.pop("paths_s", None)
        path = tmp_path / "trade.json"
        path.write_text(json.dumps({**data, "costs_s": {**dict.fromkeys(FEATURES, 0.0), **costs_s}, **more}))
        return path

    return write


@pytest.mark.parametrize("variant", [path_tracer.LLVM, path_tracer.SCALAR])
def test_paths_cost_what_they_do_with_the_variant_of_this_machine(variant, trade, monkeypatch):
    monkeypatch.setattr(costs, "usual_variant", lambda: variant)
    found = load_costs(trade({}, paths_s=PATHS_S)).costs_s
    assert {k: found[k] for k in PATH_FEATURES} == PATHS_S[variant]


def test_a_variant_that_was_not_measured_costs_what_another_does(trade, monkeypatch):
    monkeypatch.setattr(costs, "usual_variant", lambda: path_tracer.LLVM)
    scalar = {path_tracer.SCALAR: PATHS_S[path_tracer.SCALAR]}
    assert load_costs(trade({}, paths_s=scalar)).costs_s["path"] == 1e-6


def test_a_trade_from_before_variants_were_told_apart_is_read(trade):
    assert load_costs(trade({"path_picture": 0.2, "path": 3e-6})).costs_s["path"] == 3e-6


def test_a_trade_that_does_not_say_what_paths_cost_is_refused(trade):
    with pytest.raises(PhoslabError, match="trade"):
        load_costs(trade({}))


def test_the_trade_that_ships_knows_both_variants():
    data = phoslab.trades.load("model")
    assert not data["quick"]
    assert set(data["paths_s"]) == {path_tracer.LLVM, path_tracer.SCALAR}
