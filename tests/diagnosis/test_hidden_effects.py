"""An effect of every kind is added to the data of a realistic plan: `twin diagnose` must find its name, place and size.

The truth machine (`tests.truth.hidden`) shares no code with `twin`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.diagnosis import battery
from tests.truth import hidden
from tests.truth.hidden import Hidden, Plan
from twin.diagnosis import Cause, Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Harmonic

POSES = 90
SIGMA_MM = 3e-3


def one(effect: str, where: str, **numbers: float) -> Hidden:
    return Hidden(effect, where, numbers)


# Each several times what 1,500 points at 3 µm can show; curves in the calibration's datum (no constant, a straightness no slope).
EVERY = [
    one("reversal", "Y", size=5.0),
    one("pitch_error", "X", amplitude=3.0, period=10.0, phase=0.7),
    one("squareness", "E_B0Z", angle=20.0),
    one("axis_location", "E_A0C", offset=30.0),
    one("axis_location", "E_X0C", offset=5.0),
    one("angular_error_motion", "E_BX", c1=30.0, c2=40.0),
    one("straightness", "E_ZY", c0=-2.0, c2=6.0),
    one("positioning", "E_XX", c1=8.0),
    one("harmonic", "E_XC", order=3, cos=4.0, sin=-3.0),
    one("thermal_expansion", "Y", coefficient=11.0),
    one("thermal_growth", "Z by bed", coefficient=4.0),
    one("thermal_lag", "Z by bed", coefficient=8.0, time_constant=1500.0),
    one("thermal_tilt", "E_AZ by bed", coefficient=30.0),
    one("thermal_tilt", "E_B0C by bed", coefficient=30.0),
    one("scale_growth", "Y", coefficient=15.0, offset=-15.0),
    one("thermal_drift", "Z", amplitude=9.0, time_constant=2500.0),
    one("cross_axis", "E_ZY by Z", coefficient=60.0),
    one("cross_axis", "E_BZ by Y", coefficient=100.0),
    one("table_load", "B", tilt=30.0),
    one("frame_shift", "round 2", shift_x=5.0, shift_y=-4.0, shift_z=2.0, turn_x=2.0, turn_y=-3.0, turn_z=4.0),
    one("gravity_compliance", "B", compliance=0.08),
    one("zero_offset", "B", offset=40.0),
    one("refraction_scale", "—", scale=6.0),
    one("station_drift", "1", rate_x=3.0, rate_y=-2.0, rate_z=1.0),
    one("target_shift", "P from round 3", shift_x=6.0, shift_y=0.0, shift_z=-5.0),
    one("reversal", "C", size=40.0),
    one("pitch_error", "Z", amplitude=2.5, period=17.3, phase=-1.2),
    one("harmonic", "E_BB", order=2, cos=30.0, sin=10.0),
    one("reversal_curve", "Y", c0=4.0, c1=6.0, c2=-5.0),
    one("reversal_curve", "B", c0=10.0, c1=-50.0),
]
IN_TIME = ("thermal_expansion", "thermal_growth", "thermal_lag", "thermal_tilt", "thermal_drift", "scale_growth")
INSTRUMENT = ("frame_shift", "refraction_scale", "station_drift", "target_shift")
CURVES = {"positioning": 9, "straightness": 9, "angular_error_motion": 9, "reversal_curve": 5}
"""Coefficients of the longest curve that is tried: how many a curve has is chosen from the data."""
ONE_IN_370 = 0.0027
"""Chance beyond three standard deviations of a normal."""
# One of each kind by default; the others are slow.
SAMPLE = list({hidden_one.effect: hidden_one for hidden_one in reversed(EVERY)}.values())


def planned(seed: int) -> tuple[Plan, np.random.Generator]:
    """Return the plan of a seed, and the generator of its noise."""
    rng = np.random.default_rng(seed)
    return hidden.rounded(hidden.plan(rng, poses=POSES)), rng


@pytest.fixture(scope="module")
def look(
    dmu50: Machine, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Diagnosis]:
    """Simulate a measurement with hidden effects, read the table and diagnose it."""
    folder = tmp_path_factory.mktemp("hidden")

    def measured(
        effects: Sequence[Hidden],
        seed: int = 1,
        *,
        noise: str = "isotropic",
        without: Sequence[str] = (),
        outside: Callable[[Plan], np.ndarray] | None = None,
        plan: Plan | None = None,
        sigma_mm: float = SIGMA_MM,
        read: np.ndarray | None = None,
    ) -> Diagnosis:
        of, rng = planned(seed) if plan is None else (plan, np.random.default_rng(seed))
        if read is None:
            kind = "tracker" if "tracker" in noise else "isotropic"
            read = hidden.noisy(hidden.points(of, effects, outside=outside), rng, kind, sigma_mm)
        u = sigma_mm if noise == "isotropic" else None
        path = hidden.write(folder / "measured.csv", of, read, u_mm=u, without=without)
        instrument = LaserTracker() if noise == "tracker" else None
        return diagnose(Measurements.load(path, dmu50), dmu50, calibration, instrument=instrument)

    return measured


def pulls(cause: Cause, truth: Hidden) -> dict[str, float]:
    """Return (value − truth)/u of every parameter; angles are wrapped. A parameter without uncertainty equals the truth."""
    found = {}
    for q in cause.parameters:
        off = q.value - truth.numbers.get(q.name, 0.0)
        if q.name == "phase":
            off = np.mod(off + np.pi, 2.0 * np.pi) - np.pi
        if q.u == 0.0:
            assert abs(off) < 1e-9, (q, truth)
            continue
        found[q.name] = off / q.u
    assert {name for name, value in truth.numbers.items() if value} <= {q.name for q in cause.parameters}
    return found


def distance(result: Diagnosis, of: Plan, truth: Sequence[Hidden], noise: str = "isotropic") -> float:
    """Return χ² of the difference between the causes found and the hidden effects, the set-up free, whatever the names."""
    rows = result.data.lines - 2
    found = np.zeros((len(of.q), 3))
    found[rows] = np.nansum([cause.pattern_um for cause in result.causes], axis=0) * 1e-3
    off = np.zeros_like(found)
    off[rows] = (found - hidden.points(of, truth) + hidden.points(of))[rows]
    left = hidden.left_over(of, off[:, :, None], "tracker" if "tracker" in noise else "isotropic", SIGMA_MM)
    return float(np.sum(left**2))


def numbers(causes: Sequence[Cause]) -> int:
    """Return the number of parameters fitted for some causes, or that could have been fitted.

    Among nested curves that contain the truth, the longest is the furthest from it: the others are its projections.
    """
    return sum(CURVES.get(c.effect, sum(q.u > 0.0 for q in c.parameters)) for c in causes)


def the(result: Diagnosis, truth: Hidden) -> Cause:
    """Return the cause that is, or is confounded with, the hidden effect."""
    for cause in result.causes:
        if (cause.effect, cause.where) == truth.key or truth.key in cause.equivalent:
            return cause
    raise AssertionError(f"{truth.key} not among {[(c.effect, c.where, c.equivalent) for c in result.causes]}")


def check(
    result: Diagnosis, of: Plan, truth: Hidden, noise: str = "isotropic", chance: float = ONE_IN_370, by_chance: int = 0
) -> None:
    """Check the answer; ``by_chance``: causes beside the right one that noise may have made, none of them called certain."""
    cause = the(result, truth)
    beside = [other for other in result.causes if other is not cause]
    assert len(beside) <= by_chance and result.unexplained is None
    assert all(other.probability is None or other.probability < 0.9 for other in beside)
    assert result.verdict == ("ambiguous" if any(one.equivalent for one in result.causes) else "explained")
    assert cause.origin == ("instrument" if truth.effect in INSTRUMENT else "machine")
    if (cause.effect, cause.where) == truth.key:
        pulls(cause, truth)
        # The calibration that goes with it has the same order.
        orders = [effect.order for effect in cause.effects if isinstance(effect, Harmonic)]
        assert orders == [value for name, value in truth.numbers.items() if name == "order"]
    assert distance(result, of, [truth], noise) < stats.chi2.isf(chance, numbers(result.causes))
    assert cause.p_value < 0.01
    assert result.gain is not None and result.gain.rms_after_um < result.gain.rms_before_um
    if cause.origin == "machine":
        # No less where a rotation turns about the tool's own point.
        assert result.gain.tool_after_um <= result.gain.tool_before_um
    else:
        assert result.extended.source == result.calibration.source


def check_held_out(result: Diagnosis, truth: Hidden, instrument: LaserTracker | None) -> None:
    """Check that the cause reduces held-out residuals, unless it is confounded with another one in the other rounds.

    The bed is warmest in the first round and cools during the other two: from these alone a drift in time is equally likely, and its
    prediction of the first round differs. The effect of a warm-up on the first round is not predicted by the others at all.
    """
    assert result.gain is not None and result.gain.held_out is not None
    held = result.gain.held_out
    assert held.of == ("rounds" if truth.effect in IN_TIME else "poses")
    if held.after_um < held.before_um or truth.effect == "thermal_drift":
        return
    data = result.data
    parts = [
        diagnose(data.select(data.round != one), result.calibration.machine, result.calibration, instrument=instrument)
        for one in np.unique(data.round)
    ]
    assert any(part.verdict == "ambiguous" and the(part, truth).equivalent for part in parts)


@pytest.fixture(scope="module")
def found(look: Callable[..., Diagnosis]) -> Callable[[Hidden], Diagnosis]:
    """Return a function: effect of `EVERY` → diagnosis."""
    of = cache(lambda index: look([EVERY[index]], seed=100 + index))
    return lambda truth: of(EVERY.index(truth))


@pytest.mark.sample(3)  # of 23
@pytest.mark.parametrize("truth", SAMPLE, ids=lambda h: f"{h.effect} {h.where}")
def test_an_effect_of_every_kind(found: Callable[[Hidden], Diagnosis], truth: Hidden) -> None:
    result = found(truth)
    check(result, planned(100 + EVERY.index(truth))[0], truth)
    cause = the(result, truth)
    if (cause.effect, cause.where) == truth.key:
        # Three standard uncertainties, the number: 1 in 370 a parameter, on seeded draws.
        assert max(map(abs, pulls(cause, truth).values())) < 3.0
    if cause.origin == "machine":
        check_held_out(result, truth, None)


@pytest.mark.slow
def test_uncertainties_are_neither_too_small_nor_too_large(found: Callable[[Hidden], Diagnosis]) -> None:
    """RMS of all (value − truth)/u: of 33 it is one to within 0.12; a factor of two in u is far off."""
    rms = np.sqrt(np.mean(np.square(pulls_of([(found(truth), truth) for truth in SAMPLE]))))
    assert 0.7 < rms < 1.3


def pulls_of(pairs: Sequence[tuple[Diagnosis, Hidden]]) -> list[float]:
    """Return the pulls of all parameters of the right causes; of curves, only those as long as the hidden one.

    A longer curve is selected if the noise along its further terms is large, so their pulls are biased.
    """
    found: list[float] = []
    for result, truth in pairs:
        cause = the(result, truth)
        longer = truth.effect in CURVES and len(cause.parameters) > 1 + max(int(name[1:]) for name in truth.numbers)
        if (cause.effect, cause.where) == truth.key and not longer:
            found += pulls(cause, truth).values()
    return found


NOISES = ("isotropic", "repeats", "tracker", "tracker-repeats")


@pytest.fixture(scope="module")
def loud(look: Callable[..., Diagnosis]) -> Callable[[Hidden, str], Diagnosis]:
    """Return a function: effect of `EVERY` and noise → diagnosis; for a tracker the effect is `louder`."""
    of = cache(lambda index, noise: look([louder(EVERY[index], noise)], seed=200 + index, noise=noise))
    return lambda truth, noise: of(EVERY.index(truth), noise)


def louder(truth: Hidden, noise: str) -> Hidden:
    """Return the effect four times as large for a tracker (13 µm noise across the beam at 2 m); refraction three times (20 ppm)."""
    size = (3.0 if truth.effect == "refraction_scale" else 4.0) if noise.startswith("tracker") else 1.0
    same = ("order", "period", "phase", "time_constant")
    return replace(truth, numbers={k: v if k in same else size * v for k, v in truth.numbers.items()})


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("truth", EVERY, ids=lambda h: f"{h.effect} {h.where}")
def test_an_effect_of_every_kind_with_every_noise(
    loud: Callable[[Hidden, str], Diagnosis], truth: Hidden, noise: str
) -> None:
    result, hides = loud(truth, noise), louder(truth, noise)
    # One time in a hundred one of all cases is beyond (Šidák).
    chance = 1.0 - 0.99 ** (1.0 / (len(EVERY) * len(NOISES)))
    check(result, planned(200 + EVERY.index(truth))[0], hides, noise, chance, by_chance=1)
    if truth.effect not in INSTRUMENT:
        check_held_out(result, hides, LaserTracker() if noise == "tracker" else None)


@pytest.mark.slow
def test_causes_beside_the_right_one_are_rare(loud: Callable[[Hidden, str], Diagnosis]) -> None:
    """One in forty may have another cause by chance (`FALSE_ALARM_RATE` is 1 %, and a search that has found one goes on)."""
    several = [(truth.key, noise) for noise in NOISES for truth in EVERY if len(loud(truth, noise).causes) > 1]
    assert len(several) <= stats.binom.isf(0.01, len(EVERY) * len(NOISES), 1.0 / 40.0), several


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISES)
def test_uncertainties_with_every_noise(loud: Callable[[Hidden, str], Diagnosis], noise: str) -> None:
    """RMS of all (value − truth)/u, and the largest: beyond the limit one time in a hundred (Šidák)."""
    found = np.array(pulls_of([(loud(truth, noise), louder(truth, noise)) for truth in EVERY]))
    assert len(found) > 30
    assert 0.7 < np.sqrt(np.mean(found**2)) < 1.3
    assert np.abs(found).max() < stats.norm.isf((1.0 - 0.99 ** (1.0 / len(found))) / 2.0)


@pytest.mark.slow
def test_a_round_unlike_the_others_is_not_predicted(look: Callable[..., Diagnosis]) -> None:
    """A warm-up that ends within the first round: the others contain nothing of it, and do not predict that round.

    Three rounds are too few for an interval.
    """
    result = look([one("thermal_drift", "Z", amplitude=20.0, time_constant=600.0)], seed=12)
    assert result.causes[0].effect == "thermal_drift" and result.gain is not None
    assert result.gain.rms_after_um < result.gain.rms_before_um
    held = result.gain.held_out
    assert held is not None and (held.of, held.groups, held.ci95_um) == ("rounds", 3, None)
    assert held.after_um > 0.9 * held.before_um


@pytest.mark.sample(2)  # of 3
@pytest.mark.parametrize("noise", ["isotropic", "repeats", "tracker"])
def test_nothing_hidden_is_consistent(look: Callable[..., Diagnosis], noise: str) -> None:
    result = look([], seed=3, noise=noise)
    assert result.verdict == "consistent"
    assert result.causes == () and result.unexplained is None and result.gain is None
    # RMS over 4,500 readings: 1 % is its standard deviation.
    assert result.rms_um == pytest.approx(result.expected_rms_um, rel=0.04)


@pytest.mark.slow
@pytest.mark.parametrize(
    "pair",
    [
        (EVERY[0], EVERY[10]),
        (EVERY[1], EVERY[2]),
        (one("reversal", "X", size=4.0), one("reversal", "B", size=25.0)),
        (EVERY[8], EVERY[20]),
        # A period between two that are tried, so large that what it leaves there is more than the other effect.
        (one("pitch_error", "X", amplitude=15.0, period=11.3, phase=0.4), one("reversal", "Y", size=6.0)),
    ],
    ids=lambda p: " and ".join(f"{h.effect} {h.where}" for h in p),
)
def test_two_effects_are_both_found(look: Callable[..., Diagnosis], pair: tuple[Hidden, Hidden]) -> None:
    result, of = look(pair, seed=4), planned(4)[0]
    assert len(result.causes) == 2 and result.unexplained is None
    # Each effect has a cause of its own.
    assert battery.matched([truth.key for truth in pair], [{(c.effect, c.where), *c.equivalent} for c in result.causes])
    assert distance(result, of, pair) < stats.chi2.isf(ONE_IN_370, numbers(result.causes))
    moved = np.stack([hidden.points(of, [truth]) - hidden.points(of) for truth in pair], axis=2)
    seen = hidden.left_over(of, moved)
    for i, truth in enumerate(pair):
        cause = the(result, truth)
        if (cause.effect, cause.where) == truth.key:
            assert max(map(abs, pulls(cause, truth).values())) < 3.0
        own, other = seen[:, i], seen[:, 1 - i]
        whole = np.sum(np.sum(seen, axis=1) ** 2)
        # What it explains first, and what it adds to the other: the mean of both (Shapley value).
        alone, by_other = (float(some @ (own + other)) ** 2 / float(some @ some) for some in (own, other))
        wanted = 0.5 * (alone + whole - by_other)
        # Three standard deviations of noncentral χ² (Johnson, Kotz, Balakrishnan: 2 (dof + 2 λ)) of both.
        scatter = np.sqrt(4.0 / wanted + 2.0 * (result.dof + 2.0 * whole) / whole**2)
        assert abs(cause.share - wanted / whole) < 3.0 * scatter * wanted / whole
    assert sum(cause.share for cause in result.causes) <= 1.0 + 1e-9


def test_a_weak_effect_is_found_at_the_limit_of_the_data(look: Callable[..., Diagnosis]) -> None:
    # λ = 1,500·(0.75/3)² ≈ 90 before projection: a quarter of the noise of one reading.
    truth = one("reversal", "X", size=1.5)
    result = look([truth], seed=5)
    assert [(c.effect, c.where) for c in result.causes] == [truth.key]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "side"),
    [
        pytest.param(("B_deg", "C_deg"), "work", marks=pytest.mark.slow),
        (("X_mm", "Z_mm"), "tool"),
        pytest.param(("Y_mm", "time_s"), "tool", marks=pytest.mark.slow),
    ],
)
def test_an_effect_outside_the_catalogue_is_unexplained(
    look: Callable[..., Diagnosis], names: tuple[str, str], side: str
) -> None:
    def outside(of: Plan) -> np.ndarray:
        columns = {"time_s": of.time_s} | {f"{a}_{'mm' if a in 'XYZ' else 'deg'}": of.at(a) for a in hidden.AXES}
        u, v = ((columns[n] - columns[n].min()) / np.ptp(columns[n]) for n in names)
        pattern = np.sin(5.0 * u + 1.0) * np.cos(4.0 * v - 0.5)
        return 8e-3 * (pattern * (of.carrier == side))[:, None] * np.array([0.5, -0.6, 0.6])

    result = look([], seed=6, outside=outside)
    assert result.verdict == "unexplained"
    assert result.unexplained is not None and set(result.unexplained.depends_on) & set(names)


@pytest.mark.slow
def test_confounded_effects_are_reported(look: Callable[..., Diagnosis]) -> None:
    """An error in Z that grows with X and with Y: readings of one point do not identify the axis that causes it."""
    truth = one("cross_axis", "E_ZY by X", coefficient=60.0)
    result = look([truth])
    cause = the(result, truth)
    assert result.verdict == "ambiguous"
    assert truth.key in {(cause.effect, cause.where), *cause.equivalent}
    assert ("cross_axis", "E_ZX by Y") in {(cause.effect, cause.where), *cause.equivalent}
    # Under either name it is the same number, and does the same to the readings.
    (number,) = cause.parameters
    assert abs(number.value - 60.0) < 3.0 * number.u
    assert distance(result, planned(1)[0], [truth]) < stats.chi2.isf(ONE_IN_370, 1)


GROUPS = [
    # Two of Y and Z that are one product y·z along x, and X's turn about z, which has y for its lever: three names.
    (one("cross_axis", "E_XY by Z"), 60.0, ("cross_axis E_XZ by Y", "cross_axis E_CX by Z"), "cross_axis E_BX by Y"),
    (one("cross_axis", "E_XY by Z"), 36.0, ("cross_axis E_XZ by Y", "cross_axis E_CX by Z"), "cross_axis E_BX by Y"),
    (one("cross_axis", "E_ZY by X"), 30.0, ("cross_axis E_ZX by Y",), "cross_axis E_AX by Y"),
    (one("squareness", "E_B0Z"), 45.0, (), "cross_axis E_BX by Z"),
    # Sensors that warm alike, and time.
    (
        one("thermal_growth", "Z by bed"),
        55.0,
        ("thermal_growth Z by Z", "thermal_drift Z", "scale_drift Z"),
        "thermal_growth Z by Y",
    ),
]
UNIT = {"cross_axis": "coefficient", "thermal_growth": "coefficient", "squareness": "angle"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "size", "group", "outside"),
    [pytest.param(*case, marks=pytest.mark.slow if i in (2, 3) else ()) for i, case in enumerate(GROUPS)],
    ids=[f"{case[0].effect} {case[0].where} at {case[1]:g}" for case in GROUPS],
)
def test_effects_confounded_with_a_small_effect(
    dmu50: Machine,
    calibration: Calibration,
    tmp_path: Path,
    truth: Hidden,
    size: float,
    group: tuple[str, ...],
    outside: str,
) -> None:
    """Equivalent are, without noise, exactly the causes that lose less than 2 ln 100 of λ: λ (1 − ρ²), ρ by the truth machine."""
    of, _ = planned(31)
    named = [Hidden(*name.split(" ", 1)) for name in (*group, outside) if "drift" not in name]
    units = [replace(other, numbers={UNIT[other.effect]: 1.0}) for other in (truth, *named)]
    seen = hidden.left_over(of, np.stack([hidden.points(of, [other]) - hidden.points(of) for other in units], axis=2))
    whole = seen / np.linalg.norm(seen, axis=0)
    lost = size * (1.0 - (whole[:, 0] @ whole[:, 1:]) ** 2)
    # Separated at odds of 100:1; the larger correction for a larger family is a few tenths.
    assert np.all(lost[:-1] < 2.0 * np.log(100.0) - 1.0) and lost[-1] > 2.0 * np.log(100.0) + 1.0
    amount = float(np.sqrt(size) / np.linalg.norm(seen[:, 0]))
    read = hidden.points(of, [replace(truth, numbers={UNIT[truth.effect]: amount})])
    result = diagnose(
        Measurements.load(hidden.write(tmp_path / "m.csv", of, read, u_mm=SIGMA_MM), dmu50), dmu50, calibration
    )
    (cause,) = result.causes
    names = {f"{effect} {where}" for effect, where in ((cause.effect, cause.where), *cause.equivalent)}
    assert names == {f"{truth.effect} {truth.where}", *group}
    if (cause.effect, cause.where) == truth.key:
        (number,) = cause.parameters
        # Linear up to rotations by the calibration's errors; u of a single parameter is its size over √λ.
        assert number.value == pytest.approx(amount, rel=1e-3)
        assert number.u == pytest.approx(amount / np.sqrt(size), rel=1e-3)


def test_the_interval_of_the_gain_is_of_95_per_cent(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """Compare with a bootstrap over poses of the residuals: holding one pose out of hundreds changes the fit little."""
    rng = np.random.default_rng(6)
    of = hidden.rounded(hidden.plan(rng, rounds=1, poses=POSES))
    read = hidden.noisy(hidden.points(of, [one("reversal", "Y", size=12.0)]), rng, "isotropic", SIGMA_MM)
    result = diagnose(
        Measurements.load(hidden.write(tmp_path / "m.csv", of, read, u_mm=SIGMA_MM), dmu50), dmu50, calibration
    )
    assert result.gain is not None and len(result.causes) == 1
    held = result.gain.held_out
    assert held is not None and held.of == "poses" and held.ci95_um is not None
    _, pose = np.unique(result.data.positions, axis=0, return_inverse=True)
    sums = np.zeros((pose.max() + 1, 3))
    squares = [np.sum(one**2, axis=1) for one in (result.residual_um, result.after_um, np.ones((len(pose), 3)))]
    np.add.at(sums, pose.reshape(-1), np.stack(squares, axis=1))
    drawn = sums[rng.integers(0, len(sums), (4000, len(sums)))].sum(axis=1)
    low, high = np.quantile(np.sqrt(drawn[:, 0] / drawn[:, 2]) - np.sqrt(drawn[:, 1] / drawn[:, 2]), [0.025, 0.975])
    found = np.array(held.ci95_um)
    # 4,000 draws put such a quantile within 3 % of the width in 19 of 20 cases; an interval of 90 % is narrower by 8 % at each end.
    np.testing.assert_allclose(found, [low, high], atol=0.07 * (high - low))
    assert found[0] < held.before_um - held.after_um < found[1]


@pytest.mark.slow
def test_a_decoy_that_goes_with_the_cause_is_not_taken_for_it(look: Callable[..., Diagnosis]) -> None:
    """The bed's temperature correlates with time as the drift does: the drift is named, or reported as one of the two."""
    rng = np.random.default_rng(7)
    plan = hidden.plan(rng, poses=POSES)
    creep = 1.0 - np.exp(-plan.time_s / 2500.0)
    decoy = 20.0 + 2.0 * creep + 0.3 * np.sin(plan.time_s / 400.0)
    truth = one("thermal_drift", "Z", amplitude=9.0, time_constant=2500.0)
    result = look([truth], plan=hidden.rounded(replace(plan, warm={**plan.warm, "bed": decoy})))
    assert result.causes[0].effect == "thermal_drift" and result.causes[0].where == "Z"


def test_a_column_that_is_missing_makes_its_effects_not_evaluated(look: Callable[..., Diagnosis]) -> None:
    result = look([], without=["time_s", "approach_Y", *(f"T_{name}_degC" for name in ("X", "Y", "Z", "bed"))])
    missing = {(effect, where) for effect, where, _ in result.not_evaluated}
    assert {("reversal", "Y"), ("thermal_drift", "Z"), ("thermal_expansion", "X")} <= missing
    assert ("reversal", "X") not in missing
    assert result.verdict == "consistent"


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("follows", ["command", "report"])
def test_which_of_command_and_report_the_measurement_follows(look: Callable[..., Diagnosis], follows: str) -> None:
    """Reported positions of Y lag by 15 µm: they were read while it was moving, or Y really stopped there."""
    rng = np.random.default_rng(8)
    plan = hidden.rounded(hidden.plan(rng, poses=POSES))
    lag = np.zeros(plan.q.shape)
    lag[:, 1] = 5e-3 * rng.standard_normal(len(lag)) - 15e-3 * plan.approach[:, 1]
    plan = replace(plan, readback=np.round(plan.q + lag, 4))
    result = look([] if follows == "command" else [one("following_error", "Y")], plan=plan)
    assert result.verdict == "explained" and result.unexplained is None
    (cause,) = result.causes
    if follows == "command":
        assert (cause.effect, cause.where, cause.origin) == ("read_back", "Y", "instrument")
        assert "the readings follow the commands" in cause.evidence
        assert result.extended.source == result.calibration.source and result.gain is None
    else:
        assert (cause.effect, cause.where) == ("following_error", "Y")
        assert abs(cause.parameters[0].value - 1.0) < 3.0 * cause.parameters[0].u


@pytest.mark.slow
def test_a_reversal_of_reported_positions_is_ambiguous(look: Callable[..., Diagnosis]) -> None:
    """Only reported positions are in the table, taken before Y had settled: the apparent reversal may not exist."""
    rng = np.random.default_rng(8)
    plan = hidden.rounded(hidden.plan(rng, poses=POSES))
    lag = np.zeros(plan.q.shape)
    lag[:, 1] = 1e-4 * rng.standard_normal(len(lag)) - 8e-3 * plan.approach[:, 1]
    lag[(plan.q[:, 1] < 0.1) | (plan.q[:, 1] > 449.9)] = 0.0  # at the ends of travel Y is at its command
    reported = replace(plan, q=plan.q + lag)
    read = hidden.noisy(hidden.points(plan, []), rng, "isotropic", SIGMA_MM)
    result = look([], plan=reported, read=read)
    assert result.verdict == "ambiguous"
    (cause,) = result.causes
    assert (cause.effect, cause.where) in {("reversal", "Y"), ("reversal_curve", "Y")}
    assert ("read_back", "Y") in cause.equivalent and "readback_Y_mm" in cause.evidence
    # Commanded positions are whole increments: the reversal is certain.
    plainly = look([one("reversal", "Y", size=16.0)], plan=plan)
    assert plainly.verdict == "explained" and plainly.causes[0].equivalent == ()


@pytest.mark.slow
def test_an_unknown_approach_is_an_assumption(look: Callable[..., Diagnosis]) -> None:
    """Half of the readings do not state from which side Y came: the text says what is assumed of them; with all stated it does not."""
    plan, _ = planned(31)
    approach = plan.approach.copy()
    approach[::2, 1] = 0.0
    for of, said in ((plan, False), (replace(plan, approach=approach), True)):
        result = look([one("reversal", "Y", size=16.0)], plan=of)
        assert any(cause.effect in ("reversal", "reversal_curve") and cause.where == "Y" for cause in result.causes)
        assert any("where approach_Y is unknown" in notice for notice in result.data.notices) == said
        assert ("assumed: where approach_Y is unknown" in " ".join(result.to_text().split())) == said


def test_what_the_set_up_absorbs_is_unidentifiable(look: Callable[..., Diagnosis]) -> None:
    """A zero offset of a linear axis moves all targets alike, and gravity puts no load on C if the mass is on its axis."""
    found = look([])
    hidden = {("zero_offset", "X"), ("zero_offset", "Y"), ("zero_offset", "Z"), ("gravity_compliance", "C")}
    assert hidden <= set(found.unidentifiable) == set(found.looks_like)
    assert found.looks_like["gravity_compliance", "C"] == "no motion in the measurement shows it"
    for k in range(3):
        said = found.looks_like["zero_offset", "XYZ"[k]]
        assert f" {'xyz'[k]} " in said and ("station" in said or "target" in said)
    written = found.to_dict()["unidentifiable"]
    assert {(one["effect"], one["where"]): one["because"] for one in written} == dict(found.looks_like)


def test_the_battery_in_small() -> None:
    """A sample of `test_the_battery` with 200 draws per row: one miss is allowed, a factor of two in u is excluded."""
    alone = battery.summary("one60", battery.answers("one60", 10, 21, poses=60))
    assert alone["right or in group"] >= 0.9 and alone["right"] >= 0.7
    assert alone["intervals"] >= 15.0 and 0.7 < alone["rms of pulls"] < 1.3
    silent = battery.summary("nothing", battery.answers("nothing", 8, 22, poses=60))
    assert silent["any alarm"] <= 0.13
    strange = battery.summary("outside300", battery.answers("outside300", 5, 23, poses=60))
    assert strange["unexplained, right column"] >= 0.75


# 200 draws; each bound less two standard errors of the rate.
REACH = {
    ("one60", "right or in group"): 0.99 - 0.014,
    ("one60", "right where nothing is equivalent"): 0.98 - 0.02,
    ("one30", "right or in group"): 0.91 - 0.04,
    ("two60", "right or in group"): 0.95 - 0.03,
    ("three100", "right or in group"): 0.90 - 0.042,
    ("outside300", "unexplained, right column"): 0.90 - 0.042,
}


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["isotropic", "repeats", "tracker", "tracker-repeats", "uncertain"])
@pytest.mark.parametrize("row", battery.ROWS)
def test_the_battery(row: str, noise: str) -> None:
    kind = "isotropic" if noise == "uncertain" else noise
    summary = battery.summary(row, battery.answers(row, 200, 11, noise=kind, poses=100, uncertain=noise == "uncertain"))
    for (where, name), bound in REACH.items():
        if where == row:
            assert summary[name] >= bound, summary
    if row == "nothing":
        assert summary["any alarm"] <= 0.05 + 0.031, summary
    elif not row.startswith("outside"):
        assert summary["an effect too many"] <= 0.05 + 0.031, summary
        assert 0.7 < summary["rms of pulls"] < 1.3, summary
        # One draw of 200 with an alias of the period was seen; a second is allowed, and three of 300 intervals are a hundredth.
        assert summary["far pulls"] <= 0.01, summary
        # Some 400 intervals: ±2 %.
        assert 0.93 - 0.02 <= summary["coverage"] <= 0.97 + 0.02, summary


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("noise", ["isotropic", "tracker"])
@pytest.mark.parametrize("hides", [True, False])
def test_readings_without_uncertainties_and_repeats(
    dmu50: Machine, calibration: Calibration, tmp_path: Path, noise: str, hides: bool
) -> None:
    """One round, no uncertainties, no instrument: the noise is estimated from the residuals that no simple form of a cause explains."""
    rng = np.random.default_rng(5)
    plan = hidden.rounded(hidden.plan(rng, rounds=1, poses=POSES))
    truth = one("reversal", "Y", size=5.0)
    read = hidden.noisy(hidden.points(plan, [truth] if hides else []), rng, noise, SIGMA_MM)
    result = diagnose(
        Measurements.load(hidden.write(tmp_path / "m.csv", plan, read, u_mm=None), dmu50), dmu50, calibration
    )
    assert result.noise_source.startswith("the residuals of a fit of every cause")
    assert [(c.effect, c.where) for c in result.causes] == ([truth.key] if hides else [])
    assert result.unexplained is None


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("axis", ["Y", "B"])
def test_runs_of_one_axis_alone(dmu50: Machine, calibration: Calibration, tmp_path: Path, axis: str) -> None:
    """The rotation of the station about the only line of motion is not identifiable, and not needed."""
    rng = np.random.default_rng(5)
    plan = hidden.rounded(hidden.plan(rng, poses=POSES))
    still = [i for i, name in enumerate(hidden.AXES) if name != axis]
    rows = np.all(plan.q[:, still] == hidden.HOME[still], axis=1)
    truth = one("reversal", axis, size=5.0 if axis == "Y" else 40.0)
    read = hidden.noisy(hidden.points(plan, [truth]), rng, "isotropic", SIGMA_MM)
    data = Measurements.load(hidden.write(tmp_path / "m.csv", plan, read, u_mm=SIGMA_MM), dmu50).select(rows)
    result = diagnose(data, dmu50, calibration)
    assert [(c.effect, c.where) for c in result.causes] == [truth.key]
