"""The base under an arm tilts as a joint turns or as the load changes; the arm is computed in plain numpy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.truth.few_axes import write_robot
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects.entries import effect_named

JOINTS, SIGMA_MM, POSES = 4, 0.01, 200
TARGETS = {"P": (40.0, 20.0, 90.0), "Q": (-30.0, 50.0, 60.0), "R": (10.0, -60.0, 120.0)}
STATION = np.array([1500.0, -900.0, 400.0])


def points(angles: np.ndarray, place: tuple[float, float, float]) -> np.ndarray:
    """Return (n, 3) the target in the base frame, mm, of an arm whose joints turn about z and y in turn, 0.3 m apart."""
    at = np.tile(np.array(place), (len(angles), 1))
    for joint in reversed(range(JOINTS)):
        about = np.array([0.0, 0.0, 1.0]) if joint % 2 == 0 else np.array([0.0, 1.0, 0.0])
        at = Rotation.from_rotvec(np.radians(angles[:, joint])[:, None] * about).apply(at) + np.array(
            [50.0, 0.0, 300.0]
        )
    return at


@pytest.fixture
def look(tmp_path: Path) -> Callable[..., Diagnosis]:
    """Simulate a tracker's readings of an arm whose base tilts, and diagnose them."""
    machine = Machine.load(str(write_robot(tmp_path, JOINTS, 170.0)))

    def looked(tilt_urad: Callable[[np.ndarray, np.ndarray], np.ndarray], seed: int) -> Diagnosis:
        rng = np.random.default_rng(seed)
        angles = np.round(rng.uniform(-150.0, 150.0, (POSES, JOINTS)), 3)
        load = rng.choice([0.0, 4.0, 9.0], POSES)
        tilt = Rotation.from_rotvec(1e-6 * tilt_urad(angles, load))
        header = ",".join(f"J{k + 1}_deg" for k in range(JOINTS))
        lines = [f"{header},target,carrier,x_mm,y_mm,z_mm,u_mm,load_kg"]
        for name, place in TARGETS.items():
            seen = tilt.apply(points(angles, place)) - STATION + SIGMA_MM * rng.standard_normal((POSES, 3))
            for q, p, kg in zip(angles, seen, load, strict=True):
                numbers = ",".join(f"{value:.6f}" for value in p)
                lines.append(f"{','.join(f'{a:g}' for a in q)},{name},tool,{numbers},{SIGMA_MM},{kg:g}")
        path = tmp_path / "arm.csv"
        path.write_text("\n".join(lines) + "\n")
        return diagnose(Measurements.load(path, machine), machine, Calibration.default(machine))

    return looked


def test_a_base_that_tilts_with_a_joint_is_named(look: Callable[..., Diagnosis]) -> None:
    def tilt(angles: np.ndarray, load: np.ndarray) -> np.ndarray:
        angle = np.radians(angles[:, 1])
        return np.stack([0.0 * angle, 40.0 * np.cos(angle) - 25.0 * np.sin(angle), 0.0 * angle], axis=1)

    result = look(tilt, 1)
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.equivalent) == ("base_tilt", "B by J2", ())
    assert result.verdict == "explained"
    found = {q.name: (q.value, q.u) for q in cause.parameters}
    assert abs(found["cos"][0] - 40.0) < 3.0 * found["cos"][1] and abs(found["sin"][0] + 25.0) < 3.0 * found["sin"][1]
    held = result.gain.held_out if result.gain else None
    assert held is not None and held.after_um < held.before_um


def test_a_base_that_tilts_with_the_load_is_named(look: Callable[..., Diagnosis], tmp_path: Path) -> None:
    result = look(lambda angles, load: np.stack([-6.0 * load, 0.0 * load, 0.0 * load], axis=1), 2)
    (cause,) = result.causes
    assert (cause.effect, cause.where) == ("base_tilt", "A by load")
    (size,) = cause.parameters
    assert abs(size.value + 6.0) < 3.0 * size.u


def test_nothing_is_named_without_it(look: Callable[..., Diagnosis]) -> None:
    assert look(lambda angles, load: np.zeros((len(angles), 3)), 3).verdict == "consistent"


def test_the_whole_arm_turns_about_the_origin_of_the_base(tmp_path: Path) -> None:
    """The error frame nearest the base is above its origin: the rotation moves it sideways, too."""
    machine = Machine.load(str(write_robot(tmp_path, JOINTS, 170.0)))
    effect = effect_named("base_tilt", "B by J2", {"cos": 10.0, "sin": 0.0}, machine)
    moved = effect.components({f"J{k + 1}": np.zeros(1) for k in range(JOINTS)})
    assert {i: float(np.round(value[0], 9)) for i, value in moved.items()} == {0: 3.0, 2: -0.5, 4: 10.0}
