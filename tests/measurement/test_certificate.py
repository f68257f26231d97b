"""Certificates of artefacts: read, refused, and used as known places with their covariance."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import xmlschema
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tests.cli.commands import refused, status
from tests.measurement.artefacts import certificate, expanded, listed, real
from twin._common.errors import InputError
from twin.identification import identify
from twin.identification.inputs import prepare, reading_noise
from twin.identification.network import Network
from twin.identification.solve import misfit, solve
from twin.identification.unidentified import constant_unknowns, scale_unit
from twin.machine.machine import Machine
from twin.measurement.certificate import Artefact
from twin.measurement.instruments import TouchProbe
from twin.measurement.table import Measurements

SCHEMA = Path(__file__).parents[1] / "reporting" / "dcc_schema"
BALLS = np.array([[-120.0, -100.0, 30.0], [130.0, -90.0, 32.0], [120.0, 110.0, 28.0], [-110.0, 100.0, 30.0], [10.0, 5.0, 90.0]])
NAMES = [f"S{i + 1}" for i in range(len(BALLS))]
PAIRS = list(combinations(range(len(BALLS)), 2))
LABELS = [f"S{i + 1}-S{j + 1}" for i, j in PAIRS]
LENGTHS = np.array([np.linalg.norm(BALLS[i] - BALLS[j]) for i, j in PAIRS])
COMMON, OWN = 3.0, 0.4
"""Standard uncertainties: of the scale, µm/m, and of each value, µm."""
OF_LENGTHS = COMMON**2 * np.outer(LENGTHS, LENGTHS) * 1e-6 + OWN**2 * np.eye(len(LENGTHS))
OF_PLACES = COMMON**2 * np.outer(BALLS.ravel(), BALLS.ravel()) * 1e-6 + OWN**2 * np.eye(BALLS.size)
COORDINATES = [f"{name}.{letter}" for name in NAMES for letter in "xyz"]
SCALES = np.array([25.0, -40.0, 60.0])
"""Scale errors of X, Y and Z, µm/m."""
NOISE_UM = 1.0


def probed(machine: Machine, seed: int, repeats: int = 4) -> Measurements:
    """Return the spheres probed at B = C = 0 by a machine with scale errors, written without `twin`."""
    rng = np.random.default_rng(seed)
    tip = np.array([0.0, 0.0, -120.0])
    # The tip is at a sphere: axis positions that the machine, with its scales, moves to tip = sphere (README: X 250, Y 225, Z -400).
    nominal = BALLS - tip + np.array([250.0, 225.0, -400.0])
    q = np.repeat(nominal / (1.0 + 1e-6 * SCALES), repeats, axis=0) + 1e-3 * rng.normal(0.0, NOISE_UM, (repeats * len(BALLS), 3))
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


def written(folder: Path, text: str) -> Path:
    (folder / "artefact.xml").write_text(text, encoding="utf-8")
    return folder / "artefact.xml"


def loaded(folder: Path, *quantities: str) -> Artefact:
    return Artefact.load(written(folder, certificate(*quantities)), NAMES)


DISTANCES = listed(LABELS, LENGTHS, covariance_um2=OF_LENGTHS)
PLATE = listed(COORDINATES, BALLS.ravel(), covariance_um2=OF_PLACES)


def test_the_certificates_of_these_tests_follow_the_schema() -> None:
    schema = xmlschema.XMLSchema(
        SCHEMA / "dcc.xsd", uri_mapper=lambda uri: str(SCHEMA / "SI_Format.xsd") if "SI_Format" in uri else uri, allow="local"
    )
    for text in (certificate(DISTANCES), certificate(PLATE), certificate(real("S1-S2", "0.25", r"\metre", expanded("1e-6")))):
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
    order = [0, 1, 2] + [unknowns.index[c] for name in ("E_C0Y", "E_B0Z", "E_A0Z") for c in unknowns.columns if c.entity == name]
    u = np.sqrt(np.diag(solution.covariance())[: len(unknowns)])
    used = np.ones(len(data), dtype=bool)
    dof = misfit(network.residual(solution.theta, solution.setup), network, solution, used).dof
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
