"""docs/accuracy.md says what was measured: its figures are those of the trade that ships."""

from itertools import groupby
from pathlib import Path

from phoslab.app.trades.precision import Measured, Point, problems
from phoslab.trades import load

PAGE = Path(__file__).parent.parent / "docs" / "accuracy.md"
METHODS = ("euler", "rk23", "exact", "exact2", "closed form")


def equal_error_table() -> str:
    trade = load("solver")
    lights = {p.name: p for p in problems(1, 1.0)}
    strong = [p for p in trade["points"] if p["strength"] == 1.0]
    rows = []
    for name, own in groupby(strong, key=lambda p: p["problem"]):
        points = [
            Point(**{k: p[k] for k in ("method", "setting", "error", "ns", "spread", "lights")}) for p in own
        ]
        measured = Measured(lights[name], points)
        times = [measured.time_to(method) for method in METHODS]
        gains = [measured.gain(rival) for rival in ("euler", "rk23")]
        cells = [name, *("-" if t is None else f"{t:,.0f}" for t in times)]
        cells += [f"{'> ' if bound else ''}{gain:.3g}" for gain, bound in (g for g in gains if g is not None)]
        rows.append(f"| {' | '.join(cells)} |")
    head = f"| light | {' | '.join(METHODS)} | gain over euler | gain over rk23 |"
    return "\n".join([head, "| --- " * (len(METHODS) + 3) + "|", *rows])


def test_times_to_equal_error_are_those_of_the_trade_that_ships():
    assert equal_error_table() in PAGE.read_text()


def test_bytes_and_hours_are_those_of_the_trade_that_ships():
    page, trade = PAGE.read_text(), load("solver")
    for step in trade["steps"]:
        if step["solver"] == "exact":
            assert any(
                line.startswith(f"| `{step['state_format']}`") and f"| {step['bytes_per_texel']} |" in line
                for line in page.splitlines()
            )
    for error in trade["hours"]:
        if error["method"].startswith("f32, anchored") and error["hours"] == 24.0:
            assert f"{error['error']:.0e}".replace("e-0", "e-") in page
