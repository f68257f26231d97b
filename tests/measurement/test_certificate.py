"""Certificates of artefacts: read, refused, and used as known places with their covariance."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import xmlschema
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.cli.commands import refused, status
from tests.measurement.artefacts import certificate, expanded, listed, real
from tests.measurement.probing import probing
from tests.measurement.test_probe import CONSTANTS
from tests.truth.machine import written
from twin._common.errors import InputError
from twin.identification import identify
from twin.identification.inputs import prepare, reading_noise
from twin.identification.network import Network
from twin.identification.solve import misfit, solve
from twin.identification.unidentified import constant_unknowns, scale_unit
from twin.machine.machine import Machine
from twin.measurement.certificate import Artefact
from twin.measurement.instruments import TouchProbe
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SCHEMA = Path(__file__).parents[1] / "reporting" / "dcc_schema"
BALLS = np.array(
    [[-120.0, -100.0, 30.0], [130.0, -90.0, 32.0], [120.0, 110.0, 28.0], [-110.0, 100.0, 30.0], [10.0, 5.0, 90.0]]
)
NAMES = [f"S{i + 1}" for i in range(len(BALLS))]
PAIRS = list(combinations(range(len(BALLS)), 2))
LABELS = [f"S{i + 1}-S{j + 1}" for i, j in PAIRS]
LENGTHS = np.array([np.linalg.norm(BALLS[i] - BALLS[j]) for i, j in PAIRS])
COMMON, OWN = 12.0, 0.4
"""Standard uncertainties: of the scale, µm/m, and of each value, µm."""
OF_LENGTHS = COMMON**2 * np.outer(LENGTHS, LENGTHS) * 1e-6 + OWN**2 * np.eye(len(LENGTHS))
OF_PLACES = COMMON**2 * np.outer(BALLS.ravel(), BALLS.ravel()) * 1e-6 + OWN**2 * np.eye(BALLS.size)
COORDINATES = [f"{name}.{letter}" for name in NAMES for letter in "xyz"]
SCALES = np.array([25.0, -40.0, 60.0])
"""Scale errors of X, Y and Z, µm/m."""
NOISE_UM = 1.0


def probed(machine: Machine, seed: int, repeats: int = 4, balls: np.ndarray = BALLS) -> Measurements:
    """Return the spheres probed at B = C = 0 by a machine with scale errors, written without `twin`."""
    rng = np.random.default_rng(seed)
    tip = np.array([0.0, 0.0, -120.0])
    # The tip is at a sphere: axis positions that the machine, with its scales, moves to tip = sphere (README: X 250, Y 225, Z -400).
    nominal = balls - tip + np.array([250.0, 225.0, -400.0])
    q = np.repeat(nominal / (1.0 + 1e-6 * SCALES), repeats, axis=0) + 1e-3 * rng.normal(
        0.0, NOISE_UM, (repeats * len(BALLS), 3)
    )
    n = len(q)
    return Measurements(
        source="probed.csv",
        lines=np.arange(n) + 2,
        positions=np.concatenate([q, np.zeros((n, 2))], axis=1),
        target=np.repeat(np.array(NAMES, dtype=object), repeats),
        carrier=np.full(n, "work", dtype=object),
        station=np.full(n, "probe", dtype=object),
        station_carrier=np.full(n, "tool", dtype=object),
        instrument=np.full(n, "probe", dtype=object),
        point_mm=np.zeros((n, 3)),
        u_mm=np.full((n, 3), 1e-3 * NOISE_UM),
    )


def saved(folder: Path, text: str) -> Path:
    (folder / "artefact.xml").write_text(text, encoding="utf-8")
    return folder / "artefact.xml"


def loaded(folder: Path, *quantities: str) -> Artefact:
    return Artefact.load(saved(folder, certificate(*quantities)), NAMES)


DISTANCES = listed(LABELS, LENGTHS, covariance_um2=OF_LENGTHS)
PLATE = listed(COORDINATES, BALLS.ravel(), covariance_um2=OF_PLACES)
ALPHA, U_ALPHA = 11.5, 1.5
"""Coefficient of thermal expansion, µm/(m·K), and its standard uncertainty."""
EXPANDS = real("coefficient of thermal expansion", f"{ALPHA}e-6", r"\kelvin\tothe{-1}", expanded(f"{2 * U_ALPHA}e-6"))


def test_the_certificates_of_these_tests_follow_the_schema() -> None:
    schema = xmlschema.XMLSchema(
        SCHEMA / "dcc.xsd",
        uri_mapper=lambda uri: str(SCHEMA / "SI_Format.xsd") if "SI_Format" in uri else uri,
        allow="local",
    )
    for text in (
        certificate(DISTANCES),
        certificate(PLATE),
        certificate(real("S1-S2", "0.25", r"\metre", expanded("1e-6"))),
        certificate(PLATE, EXPANDS),
    ):
        schema.validate(text)


def gum(data: Measurements, pairs: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return scales and squareness (µm/m, µrad) and their u, by least squares of readings and certificate without `twin`.

    The spheres have unknown places; ``pairs``: of certified distances; None: coordinates, whose rotation and translation are unknown.
    """
    q = data.positions[:, :3] - np.array([250.0, 225.0, -400.0])
    number = np.array([NAMES.index(name) for name in data.target])
    root_d = np.linalg.inv(np.linalg.cholesky(OF_LENGTHS))
    root_p = np.linalg.inv(np.linalg.cholesky(OF_PLACES))
    middle = np.array([250.0, 225.0, -200.0]) - np.array([250.0, 225.0, -400.0])

    def residual(x: np.ndarray) -> np.ndarray:
        s, places, pose = x[:6], x[6:21].reshape(-1, 3), x[21:]
        off = q - middle
        moved = q + 1e-6 * s[:3] * off
        # Y's line turns about z by E_C0Y, Z's about y by E_B0Z and about x by E_A0Z.
        moved = moved + 1e-6 * np.stack([-s[3] * q[:, 1] + s[4] * q[:, 2], -s[5] * q[:, 2], 0.0 * q[:, 0]], axis=1)
        rows = [((moved - places[number]) / (1e-3 * NOISE_UM)).ravel()]
        if pairs is not None:
            length = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
            rows.append(root_d @ (1e3 * (LENGTHS - length)))
        else:
            turned = Rotation.from_rotvec(pose[:3]).apply(BALLS) + pose[3:]
            # The certificate's covariance is in the artefact's own frame.
            back = Rotation.from_rotvec(pose[:3]).inv().apply(places - turned)
            rows.append(root_p @ (1e3 * back.ravel()))
        return np.concatenate(rows)

    start = np.concatenate([np.zeros(6), q[[list(number).index(i) for i in range(5)]].ravel(), np.zeros(6)])
    start[-1] = -120.0
    if pairs is not None:
        start = start[:21]
    scale = np.concatenate([np.full(6, 10.0), np.full(15, 1e-2), np.repeat([1e-4, 1e-2], 3)])[: len(start)]
    found = least_squares(residual, start, x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    whitened = found.jac * scale
    covariance = np.linalg.pinv(whitened.T @ whitened, rcond=1e-12) * np.outer(scale, scale)
    return found.x[:6], np.sqrt(np.diag(covariance)[:6])


def estimate(machine: Machine, data: Measurements, artefact: Artefact) -> tuple[np.ndarray, np.ndarray, float]:
    """Return scales and squareness, their u, and the degrees of freedom, by the solver of `identify` with these unknowns."""
    placed = prepare(machine, replace(data, artefacts=(artefact,)), TouchProbe())
    noise = reading_noise(machine, placed, "stated", named=True)
    unknowns = constant_unknowns(machine, ("X", "Y", "Z"))
    network = Network(machine, placed.data, placed.instruments, unknowns, covariance=noise.covariance)
    solution = solve(network, np.zeros(len(unknowns)), placed.setup, np.ones(len(data)))
    per = np.array([scale_unit(curve) for curve in unknowns.curves] + [1.0] * len(unknowns.constants))
    order = [0, 1, 2] + [
        unknowns.index[c] for name in ("E_C0Y", "E_B0Z", "E_A0Z") for c in unknowns.columns if c.entity == name
    ]
    u = np.sqrt(np.diag(solution.covariance())[: len(unknowns)])
    used = np.ones(len(data), dtype=bool)
    residual, certified = network.residual(solution.theta, solution.setup), network.certified(solution.setup)[:, -1]
    dof = misfit(residual, network.read, data, solution.determined, used, certified).dof
    return (solution.theta * per)[order], (u * per)[order], dof


@pytest.mark.parametrize("kind", ["distances", "coordinates"])
def test_the_estimate_is_that_of_least_squares_by_the_gum(dmu50: Machine, tmp_path: Path, kind: str) -> None:
    """Values to 1 % of their u and u to 1 %, against an estimate that shares no code with `twin`; the scale's u contains COMMON."""
    data = probed(dmu50, 1)
    artefact = loaded(tmp_path, DISTANCES if kind == "distances" else PLATE)
    value, u, dof = estimate(dmu50, data, artefact)
    expected, expected_u = gum(data, np.array(PAIRS) if kind == "distances" else None)
    assert np.allclose(u, expected_u, rtol=0.01)
    assert np.all(np.abs(value - expected) < 0.01 * expected_u)
    assert np.all(np.abs(value[:3] - SCALES) < 4.0 * u[:3])
    assert np.all(u[:3] > COMMON)
    # 60 readings and the values less the pose of the artefact; unknown: 6 constants and 15 places, of which the tip's place is free.
    assert dof == pytest.approx(60 + (10 if kind == "distances" else 15 - 6) - 6 - 15, abs=0.2)


def test_the_scale_is_within_its_uncertainty_for_artefacts_as_certified(dmu50: Machine, tmp_path: Path) -> None:
    """Mean square of (estimate - truth)/u over 40 artefacts drawn from the certificate's covariance, each probed once.

    For each of three scales, its central 99.9 % range (χ² of 40). Without the correlation it is above three for X and Y.
    """
    artefact, root = loaded(tmp_path, PLATE), np.linalg.cholesky(OF_PLACES)
    square = np.zeros(3)
    for seed in range(40):
        real_plate = BALLS + 1e-3 * (root @ np.random.default_rng(1000 + seed).normal(size=BALLS.size)).reshape(-1, 3)
        value, u, _ = estimate(dmu50, probed(dmu50, seed, balls=real_plate), artefact)
        square += ((value[:3] - SCALES) / u[:3]) ** 2 / 40
    low, high = chi2.ppf([0.0005, 0.9995], 40) / 40
    assert np.all((low < square) & (square < high)), square


def test_the_scale_is_within_its_uncertainty_for_artefacts_at_another_temperature(
    dmu50: Machine, tmp_path: Path
) -> None:
    """As above; the plates have coefficients drawn as certified, and are 0.2 K about 29 °C. As stated, X is 100 µm/m off."""
    certified, root = loaded(tmp_path, PLATE, EXPANDS), np.linalg.cholesky(OF_PLACES)
    artefact, square = certified.at(29.0), np.zeros(3)
    for seed in range(40):
        rng = np.random.default_rng(2000 + seed)
        real_plate = BALLS + 1e-3 * (root @ rng.normal(size=BALLS.size)).reshape(-1, 3)
        grown = 1.0 + 1e-6 * rng.normal(ALPHA, U_ALPHA) * rng.normal(9.0, 0.2)
        value, u, _ = estimate(dmu50, probed(dmu50, seed, balls=real_plate * grown), artefact)
        square += ((value[:3] - SCALES) / u[:3]) ** 2 / 40
    low, high = chi2.ppf([0.0005, 0.9995], 40) / 40
    assert np.all((low < square) & (square < high)), square
    assert np.all(u[:2] < 1.1 * np.hypot(COMMON, 9.0 * U_ALPHA))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        (r"\kelvin\tothe{-1}", 1e-6),
        (r"\per\kelvin", 1e-6),
        (r"\micro\metre\metre\tothe{-1}\kelvin\tothe{-1}", 1.0),
        (r"\micro\metre \per\metre \per\kelvin", 1.0),
    ],
)
def test_the_coefficient_of_expansion_is_read(tmp_path: Path, unit: str, factor: float) -> None:
    text = real("expansion", f"{ALPHA * factor:g}", unit, expanded(f"{2 * U_ALPHA * factor:g}"))
    artefact = loaded(tmp_path, DISTANCES, text)
    assert artefact.expansion == pytest.approx((ALPHA * 1e-6, U_ALPHA * 1e-6))
    warm = artefact.at(22.0)
    assert warm.value == pytest.approx(LENGTHS * 1e-3 * (1 + 2.0 * ALPHA * 1e-6), rel=1e-12)
    assert "those at 22 °C" in warm.brief and "as stated" in artefact.brief
    assert loaded(tmp_path, DISTANCES).expansion is None


def test_a_temperature_is_taken_from_the_table_or_refused_without_a_coefficient(
    dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, table, out = turned(dmu50, tmp_path, 2), tmp_path / "probed.csv", tmp_path / "mine.yaml"
    replace(data, temperature_degC={"artefact": np.full(len(data), 23.0)}).save(table, dmu50)
    arguments = "identify", table, "-o", out, "--only", "E_*0*", "--certificate"
    path = saved(tmp_path, certificate(PLATE))
    assert "was at 23 °C and its certificate states no coefficient" in refused(capsys, *arguments, path)
    assert not out.exists()
    assert status(*arguments, path, "--artefact-temperature", "20") == 0
    path = saved(tmp_path, certificate(PLATE, EXPANDS))
    capsys.readouterr()
    assert status(*arguments, path, "--json", tmp_path / "a.json") == 0
    assert "its values are those at 23 °C" in capsys.readouterr().out.replace("\n", " ")
    assert json.loads((tmp_path / "a.json").read_text())["certificates"][0]["temperature_degC"] == 23.0
    assert "not plausible" in refused(capsys, *arguments, path, "--artefact-temperature", "293")
    assert "needs --certificate" in refused(capsys, *arguments[:-1], "--artefact-temperature", "21")


@pytest.mark.parametrize(
    "text",
    [
        real("of another thing", "1.15e-3", r"\kelvin\tothe{-1}", expanded("1e-6")),
        real("nominal", "1.15e-5", r"\kelvin\tothe{-1}", ""),
        real("exact", "1.15e-5", r"\kelvin\tothe{-1}", expanded("0")),
        f"{EXPANDS}</dcc:quantity><dcc:quantity>{EXPANDS.replace('11.5', '9')}",
    ],
)
def test_a_coefficient_that_is_not_sure_is_not_used(tmp_path: Path, text: str) -> None:
    artefact = loaded(tmp_path, PLATE, text)
    assert artefact.at(20.0) is artefact
    with pytest.raises(InputError, match=r"was at 25 °C and its certificate states no coefficient"):
        artefact.at(25.0)


def turned(machine: Machine, folder: Path, seed: int) -> Measurements:
    """Return the spheres probed at random positions of B and C on a machine with scale errors, noise of 1 µm."""
    model = folder / "truth.yaml"
    axes = (("E_XX", (0, 500)), ("E_YY", (0, 450)), ("E_ZZ", (-400, 0)))
    curves = {
        name: {
            "unit": "um",
            "domain": list(of),
            "basis": "power",
            "coefficients": [0.0, float(s) * (of[1] - of[0]) / 2e3],
        }
        for (name, of), s in zip(axes, SCALES, strict=True)
    }
    written(model, {"curves": curves, **{name: dict(of) for name, of in CONSTANTS.items()}})
    plan = probing(machine, BALLS.tolist(), 24, 5)
    plan = replace(plan, target=np.array([f"S{name[-1]}" for name in plan.target], dtype=object))
    truth = Calibration.load(model, machine)
    return simulate(plan, machine, truth, TouchProbe(), np.random.default_rng(seed))[0]


def test_identify_takes_the_scale_from_the_certificate(
    dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, out = tmp_path / "probed.csv", tmp_path / "mine.yaml"
    turned(dmu50, tmp_path, 2).save(table, dmu50)
    arguments = "identify", table, "-o", out, "--only", "E_*0*", "E_XX", "E_YY", "E_ZZ"
    assert status(*arguments) == 0
    assert "not: the common scale of X, Y and Z" in capsys.readouterr().out
    assert status(*arguments, "--certificate", saved(tmp_path, certificate(PLATE)), "--json", tmp_path / "a.json") == 0
    text = capsys.readouterr().out
    assert (
        "the common scale" not in text and "certificate BP-7/2026 (ball plate): coordinates of 5 targets known" in text
    )
    found = Calibration.load(out, dmu50)
    assert "with certificate BP-7/2026" in found.source
    assert json.loads((tmp_path / "a.json").read_text())["certificates"][0]["kind"] == "coordinates"
    for name, scale in zip(("E_XX", "E_YY", "E_ZZ"), SCALES, strict=True):
        curve = found.curves[name]
        assert curve.basis == "power" and curve.covariance is not None
        # From end to end: u is -1 and 1, and even powers cancel.
        ends = 2.0 * (np.arange(len(curve.coefficients)) % 2) / np.ptp(curve.domain) * 1e3
        u = np.sqrt(ends @ curve.covariance @ ends)
        assert abs(ends @ curve.coefficients - scale) < 3.5 * u and u > COMMON


def test_no_correlation_stated_is_never_too_confident(dmu50: Machine, tmp_path: Path) -> None:
    """The u of every constant is at least that with the covariance that was left out, and no use of distances is lost."""
    data, u_um = probed(dmu50, 3), np.sqrt(np.diag(OF_LENGTHS))
    silent = loaded(tmp_path, listed(LABELS, LENGTHS, u_um=u_um))
    _, u, _ = estimate(dmu50, data, silent)
    _, with_covariance, _ = estimate(dmu50, data, loaded(tmp_path, DISTANCES))
    assert np.all(u > 0.999 * with_covariance) and np.all(u[:2] < 4.0 * COMMON)
    assert silent.enlarged == len(LABELS) and "states no correlation" in silent.brief
    bound = silent.covariance * 1e12 - OF_LENGTHS
    assert np.linalg.eigvalsh(bound)[0] > -1e-9


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_contrasts_do_not_depend_on_where_the_artefact_stands(seed: int) -> None:
    """Turned and moved coordinates are the same certificate: residuals of exact places are zero, and chi² of others is unchanged."""
    rng = np.random.default_rng(seed)
    artefact = Artefact(
        "a", "1", "plate", tuple(NAMES), np.zeros((0, 2), dtype=int), BALLS * 1e-3, OF_PLACES * 1e-12, 1
    )
    turn = Rotation.random(random_state=seed)
    shift = rng.normal(0.0, 1.0, 3)
    assert np.abs(artefact.rows(turn.apply(BALLS * 1e-3) + shift).residual).max() < 1e-6
    off = BALLS * 1e-3 + rng.normal(0.0, 2e-6, BALLS.shape)
    here, there = (artefact.rows(place).residual for place in (off, turn.apply(off) + shift))
    assert len(here) == 9 and here @ here == pytest.approx(there @ there, rel=1e-4)


def test_a_step_gauge_probed_in_one_direction_gives_the_scale(dmu50: Machine, tmp_path: Path) -> None:
    """Faces of a gauge along X, of which only x is read: its known lengths, with a common scale uncertainty, give E_XX."""
    faces = np.arange(0.0, 401.0, 40.0)
    names = [f"G{k}" for k in range(len(faces))]
    rng = np.random.default_rng(4)
    q = np.repeat((faces + 40.0) / (1.0 + 30e-6), 4) + 1e-3 * rng.normal(0.0, 0.5, 4 * len(faces))
    n = len(q)
    point = np.full((n, 3), np.nan)
    point[:, 0] = 0.0
    data = Measurements(
        source="gauge.csv",
        lines=np.arange(n) + 2,
        positions=np.stack([q.round(4), *(np.full(n, v) for v in (225.0, -200.0, 0.0, 0.0))], axis=1),
        target=np.repeat(np.array(names, dtype=object), 4),
        carrier=np.full(n, "work", dtype=object),
        station=np.full(n, "probe", dtype=object),
        station_carrier=np.full(n, "tool", dtype=object),
        point_mm=point,
        u_mm=np.where(np.isfinite(point), 0.5e-3, np.nan),
    )
    lengths = faces[1:]
    covariance = 2.0**2 * np.outer(lengths, lengths) * 1e-6 + 0.2**2 * np.eye(len(lengths))
    text = certificate(listed([f"G0-{name}" for name in names[1:]], lengths, covariance_um2=covariance))
    artefact = Artefact.load(saved(tmp_path, text), names)
    found = identify(data, dmu50, instrument=TouchProbe(), artefacts=[artefact], wanted=lambda name: name == "E_XX")
    curve = found.calibration.curves["E_XX"]
    assert curve.covariance is not None
    u, orders = (2.0 * (faces[[0, -1]] + 40.0) - 500.0) / 500.0, np.arange(len(curve.coefficients))[:, None]
    by = np.diff(u**orders, axis=1)[:, 0] / 0.4
    slope, u_slope = by @ curve.coefficients, np.sqrt(by @ curve.covariance @ by)
    assert abs(slope - 30.0) < 2.5 * u_slope and 2.0 < u_slope < 3.0


@pytest.mark.parametrize(
    ("uncertainty", "u"),
    [
        (expanded("3e-6", "1.5"), 2e-6),
        (
            "<si:measurementUncertaintyUnivariate><si:expandedMU><si:valueExpandedMU>3e-6</si:valueExpandedMU>"
            "<si:coverageFactor>1.5</si:coverageFactor></si:expandedMU></si:measurementUncertaintyUnivariate>",
            2e-6,
        ),
        (
            "<si:measurementUncertaintyUnivariate><si:standardMU><si:valueStandardMU>2e-6</si:valueStandardMU></si:standardMU>"
            "</si:measurementUncertaintyUnivariate>",
            2e-6,
        ),
        (
            "<si:coverageInterval><si:standardUnc>2e-6</si:standardUnc><si:intervalMin>0.1</si:intervalMin>"
            "<si:intervalMax>0.3</si:intervalMax><si:coverageProbability>0.95</si:coverageProbability></si:coverageInterval>",
            2e-6,
        ),
    ],
)
def test_each_form_of_an_uncertainty_is_read(tmp_path: Path, uncertainty: str, u: float) -> None:
    found = loaded(tmp_path, real("S1-S2", "250", r"\milli\metre", uncertainty.replace("e-6", "e-3")))
    assert found.value == pytest.approx([0.25]) and found.covariance == pytest.approx(np.array([[u**2]]), rel=1e-12)


def test_spheres_that_were_not_measured_are_integrated_out(tmp_path: Path) -> None:
    text = saved(tmp_path, certificate(PLATE))
    found = Artefact.load(text, [*NAMES[:2], NAMES[4], "other"])
    rows = [0, 1, 2, 3, 4, 5, 12, 13, 14]
    assert found.targets == ("S1", "S2", "S5") and np.allclose(found.covariance * 1e12, OF_PLACES[np.ix_(rows, rows)])
    again = Artefact.load(text, NAMES).among(["S5", "S1", "S2"])
    assert again is not None and np.array_equal(again.covariance, found.covariance) and again.targets == found.targets


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_certificate_is_refused_or_usable(tmp_path: Path, data: st.DataObject) -> None:
    """Tags and numbers removed, doubled or replaced: an error with the file's name, or a positive covariance of finite values."""
    matrix = OF_LENGTHS[:3, :3]
    parts = re.split(r"(<[^>]*>|\s+)", certificate(listed(LABELS[:3], LENGTHS[:3], covariance_um2=matrix)))
    written_parts = [i for i, part in enumerate(parts) if part.strip()]
    for i in data.draw(st.lists(st.sampled_from(written_parts), min_size=1, max_size=3)):
        parts[i] = data.draw(
            st.sampled_from(
                ["", parts[i] * 2, "0", "-1e3", "1e300", "nan", "S1-S2", "<si:real/>", "\\metre", "9" * 400]
            )
        )
    try:
        found = Artefact.load(saved(tmp_path, "".join(parts)), NAMES)
    except InputError as error:
        assert error.file is not None
        return
    assert np.isfinite(found.value).all() and np.linalg.eigvalsh(found.covariance)[0] > 0.0
    assert np.isfinite(found.rows(BALLS[: len(found.targets)] * 1e-3).residual).all()


PART = listed(["S1-S2", "S2-S3"], LENGTHS[[0, 4]], u_um=np.array([0.5, 0.5]))
WRONG_MATRIX = np.array([[1.0, 2.0], [2.0, 1.0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PART, "not XML"),
        ("<a/>", "1: element a: not a digital calibration certificate"),
        (
            certificate(PART).replace('"3.1.2"', '"2.4.0"'),
            "2: element digitalCalibrationCertificate: another version of the schema: '2.4.0'",
        ),
        (
            certificate(PART).replace("<dcc:uniqueIdentifier>BP-7/2026</dcc:uniqueIdentifier>", ""),
            "6: element coreData: uniqueIdentifier is missing",
        ),
        (
            re.sub("<dcc:respPersons>.*</dcc:respPersons>", "", certificate(PART)),
            "3: element administrativeData: respPersons is missing",
        ),
        (
            certificate(PART).replace("\\milli\\metre", "mm"),
            ": element unitXMLList: the unit is no length of D-SI: 'mm'",
        ),
        (certificate(PART).replace("\\milli\\metre", "\\radian"), "the unit is no length of D-SI: '\\\\radian'"),
        (certificate(PART).replace("\\milli\\metre", "\\milli\\metre \\metre \\metre"), "3 units for 2 values"),
        (certificate(listed(["S1-S2"], LENGTHS[:1])), "26: element realListXMLList: states no uncertainty"),
        (certificate(real("S1-S2", "0.25", r"\metre", "")), "26: element real: states no uncertainty"),
        (certificate(real("S1-S2", "0.25", r"\metre", expanded("0"))), "S1-S2 has no uncertainty"),
        (
            certificate(real("S1-S2", "0,25", r"\metre", expanded("1e-6"))),
            "element value: not a number of D-SI: '0,25'",
        ),
        (
            certificate(real("S1-S2", "0.25", r"\metre", expanded("-1e-6"))),
            "element uncertainty: the number is too small: '-1e-6'",
        ),
        (
            certificate(real("S1-S2", "0.25", r"\metre", expanded("1e-6", "0.5"))),
            "element coverageFactor: the number is too small: '0.5'",
        ),
        (
            certificate(real("S1-S2", "0.25", r"\metre", expanded("1e-6").replace("coverageFactor", "k"))),
            "element expandedUnc: coverageFactor is missing",
        ),
        (certificate(real("S1-S2", "-0.25", r"\metre", expanded("1e-6"))), "the distance S1-S2 is not positive"),
        (certificate(real("A-B", "0.25", r"\metre", expanded("1e-6"))), "no result names two of the table's targets"),
        (
            certificate(
                real("S1-S2", "0.25", r"\metre", expanded("1e-6")), real("S2-S1", "0.26", r"\metre", expanded("1e-6"))
            ),
            "29: S2-S1 is stated twice: 250.000000 mm in line 26",
        ),
        (certificate(listed(["S1-S2", "S2-S3"], LENGTHS[:1], u_um=np.ones(1))), "1 value for 2 labels"),
        (
            certificate(listed(["S1-S2", "S2-S3"], LENGTHS[:2], covariance_um2=WRONG_MATRIX)),
            "element covarianceMatrix: the matrix is no covariance",
        ),
        (certificate(listed(["S1-S2", "S2-S3"], LENGTHS[:2], covariance_um2=np.ones((2, 2)))), "singular"),
        (
            certificate(listed(["S1-S2", "S2-S3"], LENGTHS[:2], covariance_um2=np.eye(3))),
            "element uncertaintyXMLList: 3 numbers for 2 values",
        ),
        (
            certificate(listed(["S1-S2", "S2-S3"], LENGTHS[:2], u_um=np.ones(2), covariance_um2=np.eye(3))),
            "expected 2 columns of 2 entries",
        ),
        (
            certificate(listed(["S1-S2", "S2-S3"], LENGTHS[:2], u_um=np.array([1.0, 2.0]), covariance_um2=np.eye(2))),
            "the uncertainty of S2-S3 contradicts the covariance matrix",
        ),
        (
            certificate(listed(["S1-S2", "S2-S3"], LENGTHS[:2], covariance_um2=np.array([[1.0, 0.1], [0.2, 1.0]]))),
            "not symmetric",
        ),
        (
            certificate(listed(["S1-S2", "S2-S3", "S1-S3"], np.array([100.0, 100.0, 201.0]), u_um=np.ones(3))),
            "S1-S3 is 1.000000 mm longer than the way over the third sphere",
        ),
        (certificate(listed(COORDINATES[:5], BALLS.ravel()[:5], u_um=np.ones(5))), "sphere S2 has no z"),
        (
            certificate(PLATE, real("S1-S2", "0.2503", r"\metre", expanded("1e-6"))),
            "the distance S1-S2 contradicts the coordinates: 250.300000 and 250.207914 mm",
        ),
    ],
)
def test_a_certificate_that_cannot_be_used_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        Artefact.load(saved(tmp_path, text), NAMES)
    assert message in str(caught.value) and "artefact.xml:" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("\\milli\\metre", "mm"), "the unit is no length of D-SI: 'mm'"),
        (
            lambda text: text.replace("S1.", "S9.").replace("S2.", "S1.").replace("S9.", "S2."),
            "the readings contradict certificate BP-7/2026",
        ),
        (lambda text: text.replace("\\milli\\metre<", "\\centi\\metre<"), "contradicts the covariance matrix"),
    ],
)
def test_a_refused_certificate_writes_nothing(
    dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Callable[[str], str], message: str
) -> None:
    table, out = tmp_path / "probed.csv", tmp_path / "mine.yaml"
    turned(dmu50, tmp_path, 2).save(table, dmu50)
    path = saved(tmp_path, change(certificate(PLATE)))
    assert message in refused(capsys, "identify", table, "-o", out, "--only", "E_*0*", "--certificate", path)
    assert not out.exists()


def test_an_artefact_at_another_temperature_is_reported(
    dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A plate that has expanded unevenly by 30 µm: the readings contradict it, exit status 3."""
    table, out = tmp_path / "probed.csv", tmp_path / "mine.yaml"
    turned(dmu50, tmp_path, 2).save(table, dmu50)
    bent = BALLS.copy()
    bent[0, 2] += 0.03
    path = saved(tmp_path, certificate(listed(COORDINATES, bent.ravel(), covariance_um2=OF_PLACES)))
    assert status("identify", table, "-o", out, "--only", "E_*0*", "--certificate", path) == 3
    assert "THE READINGS CONTRADICT CERTIFICATE BP-7/2026" in capsys.readouterr().out.replace("\n", " ")
