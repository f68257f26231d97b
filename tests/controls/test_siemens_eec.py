"""Leadscrew error compensation of SINUMERIK: tests in addition to those of all formats (`tests.controls.test_control_formats`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.controls.cases.siemens_eec import by_hand
from tests.controls.test_control_formats import MACHINE, put
from tests.controls.test_control_tables import drawn, state_of
from twin._common.errors import InputError
from twin.compensation.tables import Request, account_of, make
from twin.controls import ControlCurve, ControlTerm, TableSum, read_tables
from twin.controls.formats.siemens_eec import SiemensEec
from twin.model.calibration import Calibration
from twin.model.effects import Reversal
from twin.tool.forward import Kinematics


def test_the_example_of_the_manual(tmp_path: Path) -> None:
    """K3, p. 242: 3, 10 and 12 µm at −200, −199 and −198 mm of machine axis X1; a positive value moves the axis back."""
    text = """%_N_AX_EEC_INI
CHANDATA(1)
$AA_ENC_COMP[0,0,X1]=0.003 ; 1st compensation value (interpolation point 0): +3 µm
$AA_ENC_COMP[0,1,X1]=0.01
$AA_ENC_COMP[0,2,X1]=0.012
$AA_ENC_COMP_STEP[0,X1]=1.0
$AA_ENC_COMP_MIN[0,X1]=-200.0
$AA_ENC_COMP_MAX[0,X1]=-198.0
$AA_ENC_COMP_IS_MODULO[0,X1]=0
M17
"""
    back = read_tables("siemens_eec", put(tmp_path, {"eec.mpf": text}), MACHINE)
    assert back.axes == ("X",)
    assert [back.shift("X", {"X": q}) for q in (-300.0, -200.0, -199.5, -198.0, 0.0)] == pytest.approx(
        [-3.0, -3.0, -6.5, -12.0, -12.0]
    )


def test_the_axis_is_corrected_and_the_rest_is_reported() -> None:
    bare = drawn(MACHINE, 7, rotary=True).where(lambda name: name in ("E_XX", "E_YX", "E_AX", "E_CC"))
    calibration = replace(bare, extra=(Reversal(MACHINE.by_name["Y"], 8.0),))
    made = make(MACHINE, calibration, Request("siemens_eec", tool_length_mm=100.0))
    assert made.unmet == () and made.correction.axes == ("X", "C")
    q = np.tile([250.0, 225.0, -200.0, 0.0, 0.0], (50, 1))
    q[:, 0] = np.linspace(10.0, 490.0, 50)
    commands = q.copy()
    commands[:, 0] += made.correction.shift("X", state_of(MACHINE, q)) * 1e-3
    real, meant = (
        Kinematics(MACHINE, one, tool_length_mm=100.0).forward for one in (calibration, Calibration.zero(MACHINE))
    )
    before, after = ((real(one).point_mm - meant(q).point_mm)[:, 0] * 1e3 for one in (q, commands))
    assert np.abs(before - before[0]).max() > 5.0
    assert np.abs(after - after[0]).max() < 2.1  # the tolerance, up and down
    shares = {one.name: one.share for one in account_of(made, calibration, calibration, {}).carried}
    assert shares == {"E_XX": "whole", "E_YX": "no", "E_AX": "line", "E_CC": "whole", "reversal:Y": "no"}


def test_other_tables_are_refused() -> None:
    curve = ControlCurve("X", (0.0, 250.0, 500.0), (0.0, 1.0, 2.0))
    for term in (
        ControlTerm("Y", (curve,)),
        ControlTerm("X", (curve, curve)),
        ControlTerm("X", (replace(curve, direction=1),)),
        ControlTerm("X", (replace(curve, at=(0.0, 100.0, 500.0)),)),
    ):
        with pytest.raises(InputError, match="not possible as leadscrew error compensation"):
            SiemensEec().write(TableSum((term,), MACHINE))


def test_modulo(tmp_path: Path) -> None:
    curve = ControlCurve("C", (0.0, 90.0, 180.0, 270.0, 360.0), (0.0, 10.0, 0.0, -10.0, 0.0), 360.0)
    put(tmp_path, SiemensEec().write(TableSum((ControlTerm("C", (curve,)),), MACHINE)))
    state = {name: np.array([450.0, -90.0]) for name in MACHINE.names}
    assert by_hand(tmp_path, "C", state) == pytest.approx([10.0, -10.0], abs=0.01)
