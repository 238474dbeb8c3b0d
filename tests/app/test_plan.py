"""`phoslab plan` and `phoslab render --max-error`: the table, the file, and what is refused."""

from __future__ import annotations

import json
import re
from importlib.resources import as_file, files
from pathlib import Path

import pytest

from phoslab.app.cli import main
from phoslab.model_plan import read_plan

SMALL = ("--at", "off+1s", "--size", "32x24")


@pytest.fixture(scope="module")
def fading():
    with as_file(files("phoslab.sample_data") / "scenes" / "fading") as folder:
        yield folder


@pytest.fixture(scope="module")
def plan(fading, tmp_path_factory):
    """A plan of coarse picture, as a file."""
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    assert main(["plan", str(fading), "--max-error", "30%", *SMALL, "-o", str(path)]) == 0
    return path


def refused(capsys, *arguments: str) -> str:
    assert main(list(arguments)) == 1
    return capsys.readouterr().err


def test_the_shares_of_the_decisions_sum_to_what_is_predicted_within_the_bound(plan):
    planned = read_plan(plan)
    assert 0 < planned.predicted_error <= 30
    assert planned.predicted_error == pytest.approx(
        sum(term.error for term in planned.terms if term.kind != "outside")
    )
    assert 0 < sum(term.seconds for term in planned.terms) <= planned.predicted_s
    assert {term.name for term in planned.terms} >= {"states", "bands", "solver", "texels", "gi"}
    assert all(term.why for term in planned.terms)


def test_what_no_plan_models_stands_in_brackets_and_not_in_the_sum(fading, tmp_path, capsys):
    """Lamp light of a second reflection adds half as much again to the lit `cornell`: docs/accuracy.md."""
    path = tmp_path / "plan.json"
    arguments = ["plan", str(fading.parent / "cornell"), "--max-error", "5%", "--at", "1", "--size", "32x32"]
    assert main([*arguments, "-o", str(path)]) == 0
    planned = read_plan(path)
    outside = {term.name: term.error for term in planned.terms if term.kind == "outside"}
    # One ray from each of 576 pixels, and the first reflection is 1.
    assert outside["lamp bounces"] == pytest.approx(56, rel=0.2)
    assert planned.predicted_error < 5
    assert re.search(r"lamp bounces +first only +\(\d+%\)", capsys.readouterr().out)


def test_a_coarser_bound_never_costs_more(fading, capsys):
    cost = []
    for bound in ("60%", "30%", "10%"):
        assert main(["plan", str(fading), "--max-error", bound, *SMALL, "--json"]) == 0
        cost.append(json.loads(capsys.readouterr().out)["predicted_s"])
    assert cost == sorted(cost)


def test_a_saved_plan_is_followed_and_the_bound_stands_in_the_picture(plan, fading, tmp_path):
    from PIL import Image

    assert main(["render", str(fading), "--plan", str(plan), "-o", str(tmp_path / "glow.png")]) == 0
    with Image.open(tmp_path / "glow.png") as picture:
        assert picture.size == (32, 24)
        assert picture.text["phoslab:max_error"] == "30%"
        assert "states" in picture.text["phoslab:model"]


def test_an_edited_plan_that_breaks_its_bound_says_which_decision_breaks_it(plan, fading, tmp_path, capsys):
    data = json.loads(plan.read_text())
    data["bound"] = "0.0001%"
    edited = tmp_path / "edited.json"
    edited.write_text(json.dumps(data))
    said = refused(capsys, "plan", str(fading), "--plan", str(edited))
    assert "breaks its bound" in said
    assert "edited.json" in said


def test_a_plan_of_another_scene_is_refused(plan, fading, capsys):
    other = fading.parent / "cornell"
    said = refused(capsys, "plan", str(other), "--plan", str(plan))
    assert "plan.json" in said
    assert "the plan is of fading" in said


def test_what_moves_is_not_planned(fading, capsys):
    assert "moves" in refused(capsys, "plan", str(fading.parent / "lantern"), "--max-error", "5%")


def test_a_solver_and_a_step_that_were_edited_in_are_judged_by_what_they_err(fading, tmp_path, capsys):
    """Euler's method is of the first order: half the step, half the error; and one that overshoots is refused."""
    path = tmp_path / "plan.json"
    cornell = str(fading.parent / "cornell")
    arguments = ["plan", cornell, "--max-error", "60%", "--at", "off+1s", "--size", "16x16", "-o", str(path)]
    assert main(arguments) == 0
    capsys.readouterr()
    data, errors = json.loads(path.read_text()), []
    for step_s in (0.4, 0.2):
        data["choices"].update(solver="euler", step_s=step_s)
        path.write_text(json.dumps(data))
        assert main(["plan", cornell, "--plan", str(path), "--json"]) == 0
        out = json.loads(capsys.readouterr().out)
        errors.append(next(t["error"] for t in out["terms"] if t["name"] == "solver"))
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)
    data["choices"]["step_s"] = 1000.0
    path.write_text(json.dumps(data))
    said = refused(capsys, "plan", cornell, "--plan", str(path))
    assert "overshoots" in said
    assert "step_s" in said


@pytest.mark.parametrize("bound", ["0%", "-2%", "500%", "2", "two%", "nan%", "3flip"])
def test_an_absurd_bound_is_refused_with_what_it_could_be(fading, capsys, bound):
    said = refused(capsys, "plan", str(fading), f"--max-error={bound}")
    assert "dE" in said or "flip" in said or "%" in said


def test_a_bound_that_no_plan_reaches_names_the_obstacle_and_the_best_that_can_be_had(fading, capsys):
    said = refused(capsys, "plan", str(fading), "--max-error", "0.000001%", *SMALL)
    assert "%" in said
    assert "gi" in said or "texels" in said or "state format" in said


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (lambda c: c["surfaces"].pop(next(iter(c["surfaces"]))), "surfaces"),
        (lambda c: next(iter(c["surfaces"].values())).update(states=[[3]]), "states"),
        (lambda c: next(iter(c["surfaces"].values())).update(states=[[0], [0]]), "states"),
        (lambda c: c["bands_nm"].__setitem__(0, 123.0), "bands_nm"),
        (lambda c: c.update(solver="leapfrog"), "leapfrog"),
        (lambda c: c.update(state_format="f8"), "f8"),
        (lambda c: c.update(gi={"method": "radiosity"}), "radiosity"),
        (lambda c: c.update(gi={"method": "tiles", "bounces": 1000}), "bounces"),
        (lambda c: c.update(gi={"method": "tiles", "colour": "red"}), "choices.gi.colour"),
        (lambda c: c.update(gi={"method": "tiles", "directions": "many"}), "choices.gi.directions is 'many'"),
        (lambda c: c.update(bands_nm=[700.0, 400.0]), "choices.bands_nm"),
    ],
)
def test_an_edited_plan_that_does_not_fit_the_scene_says_what_does_not(
    plan, fading, tmp_path, capsys, edit, field
):
    data = json.loads(plan.read_text())
    edit(data["choices"])
    edited = tmp_path / "edited.json"
    edited.write_text(json.dumps(data))
    said = refused(capsys, "plan", str(fading), "--plan", str(edited))
    assert field in said
    assert "edited.json" in said
    assert field in refused(
        capsys, "render", str(fading), "--plan", str(edited), "-o", str(tmp_path / "x.png")
    )
    assert not (tmp_path / "x.png").exists()


def test_a_time_beyond_what_the_material_s_data_support_is_noted(fading, tmp_path, capsys):
    import shutil

    scene = tmp_path / "scene"
    shutil.copytree(fading, scene)
    for file in scene.glob("*.json"):
        material = json.loads(file.read_text())
        if material.get("schema", "").startswith("phoslab-material"):
            file.write_text(json.dumps({**material, "valid_s": [0.0, 2.0]}))
    arguments = ["plan", str(scene), "--max-error", "60%", "--size", "16x12"]
    assert main([*arguments, "--at", "off+1s"]) == 0
    assert "beyond" not in capsys.readouterr().out
    assert main([*arguments, "--at", "off+30s"]) == 0
    said = capsys.readouterr().out
    assert re.search(
        r"30 s after the light is later than the data of some materials support: .*pawn .* 2 s", said
    )


def test_how_well_a_measured_material_is_known_is_said_beside_the_bound(fading, capsys):
    """Its fit had three states under a weak lamp: each emission alone is unknown, the glow that was measured is not."""
    assert main(["plan", str(fading), "--max-error", "60%", "--at", "off+60s", "--size", "16x12"]) == 0
    said = re.search(r"one standard error, of fitted-pawn \(green\) to ([\d.]+)%", capsys.readouterr().out)
    assert said is not None
    assert 0.1 < float(said[1]) < 5


def test_what_a_plan_decides_cannot_be_given_beside_it(plan, fading, tmp_path, capsys):
    out = str(tmp_path / "x.png")
    said = refused(capsys, "render", str(fading), "--max-error", "30%", "--solver", "euler", "-o", out)
    assert "--solver" in said
    assert not Path(out).exists()


def test_a_plan_is_saved_as_json_alone(fading, tmp_path, capsys):
    picture = tmp_path / "keep.png"
    picture.write_bytes(b"mine")
    said = refused(capsys, "plan", str(fading), "--max-error", "30%", *SMALL, "-o", str(picture))
    assert "keep.png" in said
    assert picture.read_bytes() == b"mine"


def test_light_is_followed_to_its_end_by_the_reference_alone(fading, tmp_path, capsys):
    out = str(tmp_path / "x.png")
    said = refused(capsys, "render", str(fading), "--gi", "tiles", "--full-transport", "-o", out)
    assert "--full-transport" in said
    assert "--gi reference" in said
