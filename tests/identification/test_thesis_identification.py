"""The thesis's identification: exact to first order without noise, with the noise of its equations, and clear messages for bad tables.

Its possible deviation from the truth is known (the module's last paragraph) and subtracted before comparing. The remainder is of second
order. With every error at most e and ω, reflectors within P of an error frame's origin and L of travel, a deviation is at most
Δ = 2(e + ωP); fitted to it, the aligned frame is rotated by at most φ = 6Δ/L (a line through n equidistant points rotates by less than
3Δ/L, in two planes); neglected are squares and products of these rotations over their lever arms and of rotations with deviations:
(ω + φ)²(P + L) + (ω + φ)Δ. The six equations magnify that by the row sums of their inverse. The bound is a twentieth of the errors,
the actual remainder a thousandth of the bound; so half the errors must also give a quarter, which no first-order mistake does.
"""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np
import pytest

from twin._common.errors import InputError
from twin.identification.thesis import ThesisIdentification, identify_as_thesis, three_point
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker, TrackingInterferometer
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve
from twin.samples import thesis_plan

PLACES = np.array(list(thesis_plan.TOOL_PLACES_MM.values())) * 1e-3
TRAVEL = 0.4
Axis = Literal["X", "Y", "Z", "rotary"]


@pytest.fixture(scope="module")
def plan(dmu50: Machine) -> Measurements:
    return thesis_plan.plan(dmu50)


def measured(
    plan: Measurements, machine: Machine, truth: Calibration, seed: int = 0, *, noise: bool = False
) -> Measurements:
    return simulate(plan, machine, truth, LaserTracker(), np.random.default_rng(seed), noise=noise)[0]


def one_axis(machine: Machine, axis: str, seed: int, size: float) -> Calibration:
    """Return six curves of one axis: degree 8, or three harmonics for C; at most ``size`` µm and ten times as many µrad."""
    rng = np.random.default_rng(seed)
    curves = {}
    for name in machine.motion_names:
        if name[3] == axis:
            unlimited = machine.by_name[axis].lower is None
            coefficients = rng.normal(size=7 if unlimited else 9)
            coefficients *= (size if name[2] in "XYZ" else 10.0 * size) / np.abs(coefficients).sum()
            domain = (0.0, 360.0) if unlimited else (machine.by_name[axis].lower, machine.by_name[axis].upper)
            basis = "fourier" if unlimited else "power"
            unit = "um" if name[2] in "XYZ" else "urad"
            curves[name] = Curve(name, unit, domain, basis, tuple(float(c) for c in coefficients))  # type: ignore[arg-type]
    return replace(Calibration.zero(machine), curves=MappingProxyType(curves))


def inverse(places: np.ndarray, axis: Axis) -> np.ndarray:
    """Return (6, 9) the six equations' solution as a matrix."""
    return three_point(np.eye(9).reshape(9, 3, 3), places, axis).T


def neglected(places: np.ndarray, axis: Axis, size: float) -> np.ndarray:
    """Return (6,) the bound on each error motion's error, µm and µrad, for errors of ``size`` µm and ten times as many µrad."""
    away = float(np.linalg.norm(places, axis=-1).max())
    deviation = 2.0 * (size + 10.0 * size * away) * 1e-6
    turn = 10.0 * size * 1e-6 + 6.0 * deviation / TRAVEL
    second = turn**2 * (away + 0.5) + turn * deviation  # 0.5 m: longest travel, and from the rotary axes to the nose
    bound = second * np.abs(inverse(places, axis)).sum(axis=1) * 1e6
    assert bound[:3].max() < 0.05 * size and bound[3:].max() < 0.5 * size, "it would let a first-order slip pass"
    return np.asarray(bound)


def without(values: np.ndarray, at: np.ndarray, *, line: bool) -> np.ndarray:
    """Return values minus their mean, or minus their least-squares line."""
    return np.asarray(values - np.polyval(np.polyfit(at, values, 1 if line else 0), at))


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_linear_axis_comes_back(dmu50: Machine, plan: Measurements, axis: Literal["X", "Y", "Z"], seed: int) -> None:
    """At the positions within the bound; in between within it times the magnification of degree 8 on 11 points."""
    q = thesis_plan.POSITIONS[axis]
    power = np.vander(np.linspace(-1.0, 1.0, 11), 9)
    magnified = np.abs(np.vander(np.linspace(-1.0, 1.0, 201), 9) @ np.linalg.pinv(power)).sum(axis=1).max()
    largest = []
    for size in (1.0, 0.5):
        truth = one_axis(dmu50, axis, seed, size)
        found = identify_as_thesis(measured(plan, dmu50, truth), dmu50)
        bounds = neglected(PLACES, axis, size)
        left = []
        for (name, curve), bound in zip(truth.curves.items(), bounds, strict=True):
            motion = found.motions[name]
            line = name[2] in "XYZ" and name[2] != axis
            error = without(motion.mean - curve(q), q, line=line)
            left.append(np.abs(error).max() / bound)
            fine = np.linspace(*curve.domain, 201)
            between = without(found.calibration.curves[name](fine) - curve(fine), fine, line=line)
            assert np.abs(between).max() <= 2.0 * magnified * bound, name  # twice: what is taken off fits both
            assert motion.mean[0] == pytest.approx(0.0, abs=1e-9) and motion.deviation.max() < 1e-6  # four rounds alike
            assert found.calibration.curves[name](0.0) == pytest.approx(0.0, abs=1e-9)  # the constant listing 3.1 drops
        largest.append(max(left))
    assert largest[0] <= 1.0
    assert largest[1] == pytest.approx(largest[0], rel=0.05)  # of a bound that is a quarter; 5 %: third order


@pytest.mark.parametrize("axis", ["B", "C"])
def test_a_rotary_axis_comes_back(dmu50: Machine, plan: Measurements, axis: str) -> None:
    """Up to the fitted circle's frame: found − true = g − Ad(R)·(g + true at the first position), for one small motion g."""
    work = np.array(list(thesis_plan.WORK_PLACES_MM.values())) * 1e-3
    d, h = 0.154996, np.sqrt(0.5)
    if axis == "B":  # in B's frame: origin at the height d, its axis leaning by 45° about x
        work = (work - [0.0, 0.0, d]) @ np.array([[1.0, 0.0, 0.0], [0.0, h, -h], [0.0, h, h]])
    q = thesis_plan.POSITIONS[axis]
    turns = [
        np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        for c, s in ((np.cos(a), np.sin(a)) for a in np.radians(q) * (-1.0 if axis == "C" else 1.0))
    ]
    names = [f"E_{direction}{axis}" for direction in "XYZABC"]
    largest = []
    for size in (1.0, 0.5):
        truth = one_axis(dmu50, axis, 3, size)
        found = identify_as_thesis(measured(plan, dmu50, truth), dmu50)
        difference = np.array([found.motions[name].mean - truth.curves[name](q) for name in names]).T
        assert np.abs(difference).max() > 0.5 * size  # what is taken off is no formality
        first = np.array([truth.curves[name](q[0]) for name in names])
        both = [np.kron(np.eye(2), turn) for turn in turns]
        right = np.concatenate([row + turn @ first for turn, row in zip(both, difference, strict=True)])
        matrix = np.concatenate([np.eye(6) - turn for turn in both])
        g, *_ = np.linalg.lstsq(matrix, right, rcond=None)
        bounds = np.array([neglected(work @ turn.T, "rotary", size) for turn in turns])
        largest.append(np.max(np.abs(right - matrix @ g).reshape(-1, 6) / bounds))
    assert largest[0] <= 1.0
    assert largest[1] == pytest.approx(largest[0], rel=0.05)


def test_squareness_and_orientation_at_rest(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """The default calibration: squareness, slopes of its own straightness at the 11 points, and orientation of the axes at rest.

    Within 0.5 µrad: the square of the largest angle, 700 µrad.
    """
    found = identify_as_thesis(measured(plan, dmu50, calibration), dmu50).calibration.squareness
    truth = calibration.curves

    def slope(name: str) -> float:
        q = thesis_plan.POSITIONS[name[3]]
        return float(np.polyfit(q, truth[name](q), 1)[0] * 1e3)

    def at_rest(name: str) -> float:
        return float(truth[name](0.0))

    given = calibration.squareness
    expected = {
        "E_C0Y": given["E_C0Y"] + at_rest("E_CX") - slope("E_XY") - slope("E_YX"),
        "E_A0Z": given["E_A0Z"] + at_rest("E_AY") - slope("E_YZ") - slope("E_ZY"),
        "E_B0Z": given["E_B0Z"] + at_rest("E_BX") + at_rest("E_BY") + slope("E_XZ") + slope("E_ZX"),
    }
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=0.5), name


def test_known_places_do_instead_of_rotary_runs(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """The same within second order: measured places are off by 0.3 mm (700 µrad over the 0.4 m to the nose), 0.2 µm if rotated by
    as much again. Without either, the message names what is missing.
    """
    whole = measured(plan, dmu50, calibration)
    tool = np.flatnonzero(plan.carrier == "tool")
    linear = whole.select(tool)
    with pytest.raises(InputError, match="places of the tool side's targets are unknown"):
        identify_as_thesis(linear, dmu50)
    placed = replace(linear, place_mm=plan.select(tool).place_mm)
    with_places, with_circles = identify_as_thesis(placed, dmu50), identify_as_thesis(whole, dmu50)
    assert set(with_places.motions) == {name for name in with_circles.motions if name[3] in "XYZ"}
    for name, motion in with_places.motions.items():
        difference = np.abs(motion.mean - with_circles.motions[name].mean).max()
        assert 0.0 < difference < (0.2 if name[2] in "XYZ" else 2.0), name  # 2 µrad: 0.2 µm over a lever of 0.1 m


def test_noise_is_that_of_the_tracker_through_the_six_equations(
    dmu50: Machine, calibration: Calibration, plan: Measurements
) -> None:
    """20 seeds of the AT960: RMS of E_XX, E_YY, E_ZZ at the positions, constant removed, as predicted from the tracker's covariance.

    Within 20 %: four standard errors of an RMS with 200 degrees of freedom. Measured: points 6.02, 1.16, 5.74 µm, predicted 5.69, 1.15,
    5.76 µm; degree 8 on 11 points smooths nothing: the curves' RMS over the axis is 6.25, 1.10, 5.58 µm.
    """
    runs = [measured(plan, dmu50, calibration, seed, noise=True) for seed in range(20)]
    results = [identify_as_thesis(run, dmu50) for run in runs]
    station = thesis_plan.thesis_stations()[0]
    exact = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(0), noise=False)[0]
    covariance = LaserTracker().covariance(exact.point_mm * 1e-3)
    turn = station.to_station_mm(np.eye(3) + station.origin_mm)  # rows: base axes in the station's frame
    in_base = turn @ covariance @ turn.T
    for axis in ("X", "Y", "Z"):
        name = f"E_{axis}{axis}"
        column = "XYZ".index(axis)
        q = thesis_plan.POSITIONS[axis]
        rows = [
            np.flatnonzero((plan.approach[:, column] != 0) & (plan.round == "1") & (plan.target == target))
            for target in "KPQ"
        ]
        by_reading = inverse(PLACES, axis)[column].reshape(3, 3)
        variance = sum(np.einsum("i,nij,j->n", a, in_base[of], a) for a, of in zip(by_reading, rows, strict=True))
        predicted = np.sqrt(np.mean(variance) / thesis_plan.ROUNDS * (1.0 - 1.0 / len(q))) * 1e6
        points = [without(r.motions[name].mean - calibration.curves[name](q), q, line=False) for r in results]
        fine = np.linspace(q.min(), q.max(), 201)
        curves = [
            without(r.calibration.curves[name](fine) - calibration.curves[name](fine), fine, line=False)
            for r in results
        ]
        rms = float(np.sqrt(np.mean(np.square(points))))
        assert rms == pytest.approx(predicted, rel=0.2), name
        assert np.sqrt(np.mean(np.square(curves))) == pytest.approx(rms, rel=0.2), name
    rows = [np.flatnonzero((plan.approach[:, 0] != 0) & (plan.round == "1") & (plan.target == t)) for t in "KPQ"]
    by_reading = inverse(PLACES, "X")[:3].reshape(3, 3, 3)
    variance = sum(
        np.einsum("ki,nij,kj->kn", by_reading[:, k], in_base[of], by_reading[:, k]) for k, of in enumerate(rows)
    )
    # Each position against the first, in four rounds: a standard deviation of n − 1 = 3 is 0.9213 σ on average.
    expected = 0.9213 * np.sqrt(variance[:, 1:] + variance[:, :1]).mean(axis=1) * 1e6
    assert expected[1] < 0.6 * min(
        expected[0], expected[2]
    )  # thesis 5.1.1: E_YX has short error bars in Pos. 1, E_XX long ones
    # One seed has a standard deviation of 30 %, as all its positions share the first: four standard errors of 20 seeds are 27 %.
    deviations = np.array([[r.motions[f"E_{d}X"].deviation[1:].mean() for d in "XYZ"] for r in results]).mean(axis=0)
    assert deviations == pytest.approx(expected, rel=0.27)


def test_standard_deviation_over_the_rounds(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """Four rounds, n − 1: as from each round identified by itself, except for the frame fitted to it, rotated by 14 µm over 0.5 m."""
    table = measured(plan, dmu50, calibration, 5, noise=True)
    whole = identify_as_thesis(table, dmu50).motions
    alone = [identify_as_thesis(table.select(table.round == number), dmu50).motions for number in "1234"]
    for name in ("E_XX", "E_YY", "E_ZZ"):
        values = np.array([motions[name].mean for motions in alone])
        assert whole[name].mean == pytest.approx(values.mean(axis=0), abs=0.02)
        assert whole[name].deviation == pytest.approx(np.sqrt(values.var(axis=0) * 4.0 / 3.0), abs=0.02)
        assert np.isnan(alone[0][name].deviation).all()


def test_the_constant_and_the_degree(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    table = measured(plan, dmu50, calibration, 4, noise=True)
    dropped = identify_as_thesis(table, dmu50, degrees={"E_XX": 1, "E_AX": 0, "E_YY": 5})
    kept = identify_as_thesis(table, dmu50, degrees={"E_XX": 1, "E_AX": 0, "E_YY": 5}, constant=True)
    q = thesis_plan.POSITIONS["Y"]
    fit = np.polyfit(q, kept.motions["E_YY"].mean, 5)
    # numpy.polyfit in mm, as the listing has it: 1e-6 of 40 µm is what its conditioning leaves
    assert kept.calibration.curves["E_YY"](q) == pytest.approx(np.polyval(fit, q), abs=4e-5)
    assert dropped.calibration.curves["E_YY"](q) == pytest.approx(np.polyval([*fit[:-1], 0.0], q), abs=4e-5)
    assert len(kept.calibration.curves["E_AX"].coefficients) == 1
    for name in ("E_XX", "E_AX"):  # not above degree 1: the constant stays
        assert dropped.calibration.curves[name].coefficients == kept.calibration.curves[name].coefficients


def test_the_calibration_is_one_to_save_and_load(
    dmu50: Machine, calibration: Calibration, plan: Measurements, tmp_path_factory: pytest.TempPathFactory
) -> None:
    found: ThesisIdentification = identify_as_thesis(measured(plan, dmu50, calibration), dmu50)
    path = tmp_path_factory.mktemp("thesis") / "c.yaml"
    found.calibration.save(path)
    again = Calibration.load(path, dmu50)
    assert "thesis's method" in again.source and set(again.curves) == set(dmu50.motion_names)
    assert again.curves["E_CB"].coefficients == found.calibration.curves["E_CB"].coefficients
    assert set(again.without_uncertainty) == {*dmu50.motion_names, *dmu50.squareness_names}


def test_tables_it_cannot_use_are_refused(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    table = measured(plan, dmu50, calibration)
    every = np.arange(len(table))
    moved = np.array(table.positions)
    moved[7, 1] = 3.0
    flat = np.array(plan.place_mm)
    flat[:, 2] = 50.0
    partly = np.array(table.point_mm)
    partly[9, 2] = np.nan
    stations = np.array(table.station)
    stations[3] = "2"
    for bad, words, line in (
        (table.select(table.approach[:, 2] == 0), "no run of Z; expected rows with approach_Z", None),
        (table.select(table.approach[:, 3] == 0), "only a run of C", None),
        (table.select(every != 5), "round 1 lacks target K at 250", 1),
        (table.select(np.append(every, 5)), "target K twice at 250 in round 1", 6),
        (table.select(table.target != "Q"), "targets K, P; expected three targets", 1),
        (replace(table, positions=moved), "another axis moved", 8),
        (replace(table, point_mm=partly), "a coordinate that was not measured", 10),
        (replace(table, station=stations), "several stations: '1, 2'", None),
        (replace(table, place_mm=flat), "do not determine six errors", None),
    ):
        with pytest.raises(InputError) as caught:
            identify_as_thesis(bad, dmu50)
        assert words in str(caught.value) and caught.value.line == line
    lengths, _ = simulate(plan, dmu50, calibration, TrackingInterferometer(), np.random.default_rng(0))
    with pytest.raises(InputError, match="x, y and z"):
        identify_as_thesis(lengths, dmu50)
    for degrees, words in (({"E_XX": 11}, "0 to 10, for 11 positions"), ({"E_XW": 2}, "unknown error motion")):
        with pytest.raises(InputError, match=words):
            identify_as_thesis(table, dmu50, degrees=degrees)


def test_another_machine_design_is_refused(plan: Measurements) -> None:
    for name in ("trunnion_ac", "xyzbc_trunnion"):
        with pytest.raises(InputError, match="does not apply to this machine"):
            identify_as_thesis(plan, Machine.load(name))
