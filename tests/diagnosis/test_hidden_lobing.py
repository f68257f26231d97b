"""Lobing of a touch probe, hidden in centres of a sphere computed here from the nominal lever of a head-head machine."""

from __future__ import annotations

import numpy as np
import pytest

from tests.real import probe_sphere
from twin.diagnosis import diagnose
from twin.identification.inputs import prepare
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

NOISE_UM = 1.0


def centres(amplitude_um: float, phase: float, seed: int, poses: int = 80) -> Measurements:
    """Return positions at which a probe with three lobes finds the centre of a sphere from four directions and the pole."""
    rng = np.random.default_rng(seed)
    c, b = rng.uniform(-180.0, 180.0, poses), rng.uniform(-60.0, 60.0, poses)
    lever = np.array([probe_sphere.lever(*turn) for turn in zip(c, b, strict=True)])

    def pre_travel(direction: np.ndarray) -> np.ndarray:
        """Pre-travel, µm, in a direction about the stylus in the frame of the machine, degrees."""
        return amplitude_um * np.cos(3.0 * np.radians(direction - c) - phase)

    off = np.stack(
        [
            0.5 * (pre_travel(np.array(0.0)) - pre_travel(np.array(180.0))),
            0.5 * (pre_travel(np.array(90.0)) - pre_travel(np.array(270.0))),
            np.zeros(poses),
        ],
        axis=1,
    )
    read = np.array([900.0, 700.0, -900.0]) + 1e-3 * (off + rng.normal(0.0, NOISE_UM, (poses, 3)))
    return Measurements(
        source="simulated",
        lines=np.arange(poses) + 2,
        positions=np.concatenate([read - lever, c[:, None], b[:, None]], axis=1),
        target=np.full(poses, "sphere", dtype=object),
        carrier=np.full(poses, "work", dtype=object),
        station=np.full(poses, "1", dtype=object),
        station_carrier=np.full(poses, "tool", dtype=object),
        point_mm=np.zeros((poses, 3)),
        u_mm=np.full((poses, 3), 1e-3 * NOISE_UM),
    )


@pytest.fixture(scope="module")
def machine() -> Machine:
    return Machine.load(probe_sphere.MACHINE)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lobing_is_named_with_its_size(machine: Machine, seed: int) -> None:
    """The amplitude within three standard uncertainties; held-out poses are predicted better; nothing enters the calibration."""
    found = diagnose(centres(4.0, 0.7 * seed, seed), machine)
    assert [(cause.effect, cause.where, cause.origin) for cause in found.causes] == [
        ("probe_lobing", "probe 1", "instrument")
    ]
    cos, sin = found.causes[0].parameters
    assert np.hypot(cos.value, sin.value) == pytest.approx(4.0, abs=3.0 * np.hypot(cos.u, sin.u))
    assert found.extended == found.calibration or not found.extended.effects


def test_without_lobing_none_is_found(machine: Machine) -> None:
    verdicts = [diagnose(centres(0.0, 0.0, seed), machine).verdict for seed in range(10, 16)]
    assert verdicts.count("consistent") >= 5


def test_effects_of_light_are_not_tested_for_a_probe(machine: Machine) -> None:
    found = diagnose(centres(0.0, 0.0, 20), machine)
    tested = {effect for effect, _ in found.looks_like}
    assert not tested & {"refraction_scale", "affine_scale", "station_drift", "time_skew"}
    assert prepare(machine, centres(0.0, 0.0, 20), None).instruments.name == "probe"
