"""Errors that a calibration could not determine: in its file, and in U at the tool."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin._common.errors import InputError
from twin._common.provenance import NOT_IDENTIFIABLE, SYSTEMATIC_RESIDUALS, merge_warnings
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.calibration_file import MeasuredWith, MisfitEntry, UnidentifiedEntry
from twin.model.effects import AxisLocation
from twin.model.motion_curve import Curve
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics
from twin.tool.population import draw_machines
from twin.tool.uncertainty import ToolUncertainty

UNKNOWN = ("E_X0B", "E_Y0C")
TEXT = st.text(st.characters(codec="utf-8", exclude_categories=["C"]), max_size=40).map("because {}".format)
"""A sentence: a word such as NAN alone would be a number in YAML."""
SIZE = st.floats(0.0, 1e6, allow_subnormal=False)
SHARE = st.floats(0.0, 1.0, allow_subnormal=False)


def unknown(*names: str) -> tuple[UnidentifiedEntry, ...]:
    return tuple(UnidentifiedEntry(name=name, why="cannot be separated from station 1") for name in names)


def known_calibration(machine: Machine) -> Calibration:
    """Return a calibration with two locations of known uncertainty."""
    joint = Covariance(("E_X0C", "E_B0C"), np.array([[9.0, 3.0], [3.0, 16.0]]))
    location = MappingProxyType({"E_X0C": 12.0, "E_B0C": -20.0})
    return replace(Calibration.zero(machine), source="by hand", location=location, joint=joint)


# --- the file ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@given(data=st.data())
def test_round_trip_of_what_is_not_known(
    data: st.DataObject, dmu50: Machine, tmp_path_factory: pytest.TempPathFactory
) -> None:
    every = (*dmu50.motion_names, *dmu50.squareness_names, *dmu50.location_names)
    names = data.draw(st.lists(st.sampled_from(every), unique=True, max_size=5))
    given_misfit = st.builds(
        MisfitEntry,
        verdict=st.sampled_from(["consistent", "systematic", "larger", "untested"]),
        says=TEXT,
        **{name: st.none() | SIZE for name in ("rms_um", "reduced_chi2", "dof", "held_out_rms_um")},
        **{name: st.none() | SHARE for name in ("p_value", "lack_of_fit_p_value")},
    )
    count = st.integers(0, 10**6)
    first = replace(
        known_calibration(dmu50),
        not_identifiable=tuple(UnidentifiedEntry(name=name, why=data.draw(TEXT)) for name in names),
        not_estimated=tuple(data.draw(st.lists(st.sampled_from(every), unique=True, max_size=3))),
        misfit=data.draw(st.none() | given_misfit),
        instruments=tuple(data.draw(st.lists(TEXT, max_size=2))),
        set_up=data.draw(
            st.none()
            | st.builds(MeasuredWith, stations=count, targets_on_tool=count, targets_on_work=count, points=count)
        ),
        settled=data.draw(st.booleans()),
    )
    path = tmp_path_factory.mktemp("file") / "mine.yaml"
    first.save(path)
    again = Calibration.load(path, dmu50)
    for field in ("not_identifiable", "not_estimated", "misfit", "instruments", "set_up", "settled", "warnings"):
        assert getattr(again, field) == getattr(first, field), field
    assert again.to_yaml() == first.to_yaml()
    assert (NOT_IDENTIFIABLE.name in {one.name for one in again.warnings}) is bool(names)


BAD = {
    "not_identifiable: [{name: E_X0Q, why: x}]": r":4: .*no such entry under not_identifiable: 'E_X0Q'",
    "not_identifiable: [{name: E_X0B}]": r":4: .*why` is missing",
    "not_identifiable: [{name: E_X0B, why: ''}]": r":4: .*why` is invalid",
    "not_identifiable: [{name: E_X0B, why: x}, {name: E_X0B, why: y}]": r":4: duplicate entry .*'E_X0B'",
    "not_identifiable: E_X0B": r":4: .*a list",
    "not_estimated: [E_XQ]": r":4: .*no such entry under not_estimated: 'E_XQ'",
    "misfit: {verdict: good}": r":4: `misfit.verdict` is invalid: 'good'",
    "misfit: {verdict: larger, rms_um: -1}": r":4: `misfit.rms_um` is invalid: '-1'",
    "misfit: {verdict: larger, p_value: 2}": r":4: `misfit.p_value` is invalid: '2'",
    "misfit: {verdict: larger, held_out_rms_um: many}": r":4: `misfit.held_out_rms_um` is invalid: 'many'; expected a number",
    "set_up: {stations: 1, targets_on_tool: 1, targets_on_work: one, points: 3}": r":4: `set_up.targets_on_work` is invalid: 'one'",
    "instruments: tracker": r":4: `instruments` is invalid: 'tracker'; expected a list",
}


@pytest.mark.parametrize("entry", BAD)
def test_invalid_entries_are_refused_with_file_line_and_value(entry: str, dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(f"schema: twin.calibration/1\nmachine: {dmu50.name}\nsource: by hand\n{entry}\n")
    with pytest.raises(InputError, match=f"mine.yaml{BAD[entry]}"):
        Calibration.load(path, dmu50)


def test_a_subset_and_another_datum_keep_what_is_not_known(dmu50: Machine, calibration: Calibration) -> None:
    doubtful = replace(calibration, not_identifiable=unknown("E_X0B", "E_XX"))
    names = {one.name for one in doubtful.where(lambda name: name != "E_XX").not_identifiable}
    assert names == {"E_X0B"}  # a subset drops E_XX with its value; the unknown location stays unknown
    assert doubtful.in_datum("end points").not_identifiable == doubtful.not_identifiable
    assert doubtful.with_control(None).warnings == doubtful.warnings


def test_an_error_that_other_readings_determined_is_known(dmu50: Machine) -> None:
    doubtful = replace(known_calibration(dmu50), not_identifiable=unknown(*UNKNOWN))
    found = doubtful.extended([AxisLocation("E_X0B", 7.0)], Covariance(("E_X0B",), np.array([[4.0]])), "a diagnosis")
    assert [one.name for one in found.not_identifiable] == ["E_Y0C"]
    assert ToolUncertainty(Kinematics(dmu50, found)).unknown == ("E_Y0C",)


def test_warnings_of_several_sources_name_all_errors() -> None:
    one, two = NOT_IDENTIFIABLE.about(["E_X0B"]), NOT_IDENTIFIABLE.about(["E_Y0C", "E_X0B"])
    assert merge_warnings([SYSTEMATIC_RESIDUALS, one], [two]) == (
        NOT_IDENTIFIABLE.about(["E_X0B", "E_Y0C"]),
        SYSTEMATIC_RESIDUALS,
    )
    assert "and 2 more could not" in NOT_IDENTIFIABLE.about([f"E_X{i}" for i in range(10)]).text


# --- U at the tool ----------------------------------------------------------------------------------------------------


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("names", [("E_X0B",), UNKNOWN, ("E_XY", "E_C0Y"), ("E_AX", "E_B0C")])
def test_u_covers_machines_drawn_from_the_plausible_range(names: tuple[str, ...], dmu50: Machine) -> None:
    """The truth is drawn by hand and evaluated by the exact kinematics, not by the derivatives that U comes from."""
    first = known_calibration(dmu50)
    listed = unknown(*names)
    real = Kinematics(dmu50, replace(first, not_identifiable=listed), tool_length_mm=120.0)
    q = np.array([[400.0, 100.0, -100.0, 70.0, 200.0], [50.0, 380.0, -300.0, 130.0, 40.0]])
    tool = ToolUncertainty(real)
    # E_B0C of this calibration has a covariance, so its prior is in it already.
    assert tool.unknown == tuple(name for name in names if name not in first.location)
    u, estimate = tool.at(q).expanded_um, real.forward(q).point_mm
    rng, draws = np.random.default_rng(20261126), 1500
    identified = rng.multivariate_normal([12.0, -20.0], first.covariance.matrix, draws)
    inside = np.zeros(len(q))
    for known in identified:
        location = dict(zip(("E_X0C", "E_B0C"), known.tolist(), strict=True))
        squareness: dict[str, float] = {}
        motion: tuple[str, float] | None = None
        for name in tool.unknown:
            size = float(rng.normal(0.0, dmu50.plausible(name)))
            if name in dmu50.location_names:
                location[name] = size
            elif name in dmu50.squareness_names:
                squareness[name] = size
            else:
                motion = name, size
        machine = replace(
            first, location=MappingProxyType(location), squareness=MappingProxyType(squareness), joint=None
        )
        reached = _with_motion(machine, motion).forward(q).point_mm
        inside += np.linalg.norm(reached - estimate, axis=1) * 1e3 <= u
    # Four standard deviations of a binomial share of 0.95 in 1500 draws: 0.0225. Radius and first order are right within 0.003.
    assert np.all(np.abs(inside / draws - 0.95) < 0.0255), inside / draws


def _with_motion(calibration: Calibration, motion: tuple[str, float] | None) -> Kinematics:
    """Return the kinematics with a constant error motion in addition."""
    if motion is not None:
        name, size = motion
        axis = calibration.machine.by_name[name[3]]
        curve = Curve(name, "um" if name[2] in "XYZ" else "urad", axis.domain, "power", (size,))
        calibration = replace(calibration, curves=MappingProxyType({name: curve}))
    return Kinematics(calibration.machine, calibration, tool_length_mm=120.0)


def test_a_combination_that_moves_no_tool_contributes_nothing(dmu50: Machine) -> None:
    """E_XX and E_XY are confounded, their sum is known: constants along x on one side of the machine."""
    big = dmu50.plausible("E_XX") ** 2
    ends = {"E_XX": 500.0, "E_XY": 450.0}
    curves = {name: Curve(name, "um", (0.0, end), "power", (0.0,)) for name, end in ends.items()}
    joint = Covariance(("E_XX[0]", "E_XY[0]"), big * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([1.0, 0.0]))
    doubtful = replace(
        Calibration.zero(dmu50),
        curves=MappingProxyType(curves),
        joint=joint,
        not_identifiable=unknown("E_XX", "E_XY"),
    )
    tool = ToolUncertainty(Kinematics(dmu50, doubtful))
    assert tool.unknown == ()  # both are in the covariance
    u = tool.at(np.array([[250.0, 225.0, -200.0, 30.0, 60.0]])).expanded_um
    # Only the sum's own standard deviation of 1 µm is left, along one line.
    assert u == pytest.approx([1.96], rel=2e-3)


def test_drawn_machines_contain_the_unknown_errors(dmu50: Machine) -> None:
    first = known_calibration(dmu50)
    real = Kinematics(dmu50, replace(first, not_identifiable=unknown(*UNKNOWN)), tool_length_mm=120.0)
    found = draw_machines(real, trials=4000, poses=6)
    assert found.not_identified == UNKNOWN and found.to_dict()["not_identified"] == list(UNKNOWN)
    # The 95 % quantile of 4000 draws has a relative standard deviation of some 2 %.
    assert np.sqrt(np.mean(found.by_draws_um**2)) == pytest.approx(np.sqrt(np.mean(found.first_order_um**2)), rel=0.08)
    alone = ToolUncertainty(Kinematics(dmu50, first, tool_length_mm=120.0)).at(found.positions).expanded_um
    assert found.identified_um == pytest.approx(alone)
    assert found.first_order_um.min() > 50.0 * alone.max()


def test_unknown_and_identified_errors_add_up(dmu50: Machine) -> None:
    real = Kinematics(dmu50, replace(known_calibration(dmu50), not_identifiable=unknown(*UNKNOWN)))
    q = np.array([[400.0, 100.0, -100.0, 70.0, 200.0]])
    whole, identified, alone = (
        ToolUncertainty(real, errors).at(q).covariance for errors in ("all", "identified", "unknown")
    )
    assert whole == pytest.approx(identified + alone, rel=1e-9, abs=1e-6)


def test_the_machine_file_sets_the_plausible_size(dmu50: Machine, tmp_path: Path) -> None:
    folder = dmu50.path.parent
    text = dmu50.path.read_text().replace("urdf: ", f"urdf: {folder}/", 1).replace("file: ", f"file: {folder}/", 1)
    text = text.replace("default_calibration: ", f"default_calibration: {folder}/")
    path = tmp_path / "mine.yaml"
    path.write_text(text + "plausible: {location: {um: 20, urad: 20}}\n")
    sharp = Machine.load(path)
    q = np.array([[400.0, 100.0, -100.0, 70.0, 200.0]])
    wide, narrow = (
        ToolUncertainty(Kinematics(one, replace(Calibration.zero(one), not_identifiable=unknown("E_X0B")))).at(q)
        for one in (dmu50, sharp)
    )
    assert narrow.expanded_um == pytest.approx(wide.expanded_um / 50.0)
