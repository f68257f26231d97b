"""The machine report of a calibration from probe and sphere: words, plan, no correction from a model that does not fit."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.test_convert import run


@pytest.mark.slow
def test_report_of_constants_that_do_not_describe_the_readings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The simulated machine has error motions too: squareness and locations alone do not fit, and nothing is corrected with them."""
    plan, measured, found, report, page = (tmp_path / name for name in ("p.csv", "m.csv", "c.yaml", "r.json", "r.html"))
    assert run("plan", "--instrument", "probe", "--sequence", "turns", "--tool-length", 120, "-o", plan) == 0
    assert run("simulate", plan, "-o", measured, "--instrument", "probe") == 0
    assert run("identify", measured, "-o", found, "--only", "E_?0?", "--json", tmp_path / "i.json") in (0, 3)
    run(
        *("report", "--calibration", found, "--identified", tmp_path / "i.json", "--measured", measured),
        *("--tool-length", 120, "-o", page, "--json", report),
    )
    capsys.readouterr()
    steps = json.loads(report.read_text())["summary"]["steps"]
    assert steps[0]["title"] == "The calibration does not describe the readings"
    assert not [step for step in steps if step["kind"] == "do"]
    assert any(
        step["title"] == "Compensate or adjust with this calibration" for step in steps if step["kind"] == "never"
    )
    assert json.loads((tmp_path / "i.json").read_text())["stations"]["probe"]["instrument"] == "probe"
    text = re.sub(r"<(script|style|svg).*?</\1>|<[^>]+>", " ", page.read_text(), flags=re.S)
    assert not re.search(r"\b(beam|tracker|reflector)", text)
    assert "--reduce" not in text
