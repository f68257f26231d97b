"""`twin evaluate` on readings of a level: tilts given by formulas, in the machine's frame and in another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import twin
from tests.standards import motions
from tests.standards.test_evaluate import run, values
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.standards.iso230_1 import angular_error

TARGETS = np.linspace(0.0, 500.0, 11)


def level_table(path: Path, *, carrier: str = "tool", turn_deg: float | None = None, visits: int = 2) -> Path:
    """Write two cycles along X: E_AX = 40 µrad·(x/500)² + 3 µrad by direction, E_BX = −12 µrad·x/500; u = 0.5 µrad."""
    x = motions.there_and_back(TARGETS, visits)
    side = np.tile(np.repeat([1.0, -1.0], len(TARGETS)), visits)
    a = 40.0 * (x / 500.0) ** 2 + 1.5 * side + 700.0
    b = -12.0 * x / 500.0 - 300.0
    if turn_deg is not None:  # the level's x is the machine's x turned about z
        c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
        a, b = c * a + s * b, -s * a + c * b
    head = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,station,station_carrier,a_urad,b_urad,u_a_urad,u_b_urad,approach_X,time_s"
    pose = (
        "" if turn_deg is None else ",station_x_mm,station_y_mm,station_z_mm,station_a_deg,station_b_deg,station_c_deg"
    )
    given = "" if turn_deg is None else f",0,0,0,0,0,{turn_deg}"
    station = "work" if carrier == "tool" else "tool"
    sign = 1.0 if carrier == "tool" else -1.0  # a level on the table shows the head's tilt with the other sign
    rows = [
        f"{q},225,-200,0,0,level,{carrier},nest,{station},{sign * one:.6f},{sign * two:.6f},0.5,0.5,{way:.0f},{i}{given}"
        for i, (q, one, two, way) in enumerate(zip(x, a, b, side, strict=True))
    ]
    path.write_text("\n".join([head + pose, *rows]) + "\n")
    return path


@pytest.mark.parametrize(("carrier", "turn_deg"), [("tool", None), ("work", None), ("tool", 30.0)])
def test_range_of_the_tilts(dmu50: Machine, tmp_path: Path, carrier: str, turn_deg: float | None) -> None:
    """The slope of E_BX counts; the reversal widens the range of both directions together by its size."""
    path = level_table(tmp_path / "m.csv", carrier=carrier, turn_deg=turn_deg)
    found = twin.evaluate(Measurements.load(path, dmu50), dmu50)
    a, b = values(found, "E_AX", "angular error"), values(found, "E_BX", "angular error")
    assert a == pytest.approx(
        {"E_AX": 43.0, "E_AX_forward": 40.0, "E_AX_backward": 40.0, "E_AX_reversal": 3.0}, abs=1e-4
    )
    assert b["E_BX"] == pytest.approx(12.0, abs=1e-4) and b["E_BX_reversal"] == pytest.approx(0.0, abs=1e-4)
    assert [one.name for one in found.tests] == ["E_AX", "E_BX"]
    # The range is the difference of two means of two readings.
    assert found.tests[0].values[0].u == pytest.approx(0.5)
    assert any("not available" in text for text in found.tests[0].remarks)


def test_page_tolerance_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, page = level_table(tmp_path / "m.csv"), tmp_path / "m.html"
    status, text = run(capsys, path, "--tolerance", "E_AX=42", "E_BX=14", "--html", page, "--json", tmp_path / "m.json")
    assert status == 3
    assert "FAIL E_AX: angular error" in text and "PASS E_BX: angular error" in text and "conformity is proven" in text
    assert "angular error" in page.read_text() and page.read_text().count("<img") == 2
    assert "forward_urad" in (tmp_path / "m.json").read_text()


def test_what_angles_cannot_show(dmu50: Machine, tmp_path: Path) -> None:
    """A level on a rotary axis, and one that moves with its reference."""
    path = level_table(tmp_path / "m.csv")
    text = path.read_text()
    header, *rows = text.splitlines()
    turned = [",".join(["250", "225", "-200", "0", row.split(",")[0], *row.split(",")[5:]]) for row in rows]
    path.write_text("\n".join([header, *turned]) + "\n")
    found = twin.evaluate(Measurements.load(path, dmu50), dmu50)
    assert not found.tests and any("linear axes" in one.why for one in found.not_evaluated)
    path.write_text(text.replace(",nest,work,", ",nest,tool,"))
    found = twin.evaluate(Measurements.load(path, dmu50), dmu50)
    assert not found.tests and any("do not show X" in one.why for one in found.not_evaluated)


def test_one_direction_and_refusals() -> None:
    found = angular_error([0.0, 1.0, 2.0], [0.0, 5.0, -1.0], [1.0, 1.0, 1.0], name="E_AX")
    assert found.value_urad == found.forward_value_urad == 6.0
    assert found.backward_value_urad is None and found.reversal_urad is None and len(found.shortfalls) == 2
    with pytest.raises(InputError, match="direction"):
        angular_error([0.0, 1.0], [0.0, 1.0], [1.0, 0.0], name="E_AX")
    with pytest.raises(InputError, match="two positions"):
        angular_error([1.0, 1.0], [0.0, 1.0], [1.0, -1.0], name="E_AX")
