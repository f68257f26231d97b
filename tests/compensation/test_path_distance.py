"""Distance of measured positions from a path that crosses itself, against every part of it in plain numpy."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from twin.compensation.verification import _Course
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics


def test_the_nearest_part_is_found_where_the_path_crosses_itself(dmu50: Machine) -> None:
    """Long blocks beside runs of short ones: the nearest vertex often belongs to a part that is not the nearest."""
    rng = np.random.default_rng(3)
    kinematics = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=120.0)
    corner = np.array([250.0, 225.0, -200.0, 0.0, 0.0])
    rough = corner + np.vstack([[0.0] * 5, np.pad(rng.uniform(-0.3, 0.3, (40, 3)), ((0, 0), (0, 2)))])
    short = rough[-1] + np.cumsum(np.pad(rng.normal(0.0, 0.004, (300, 3)), ((0, 0), (0, 2))), axis=0)
    path = np.vstack([rough, short])
    tips = SimpleNamespace(machine=dmu50, at=lambda positions, lengths: kinematics.forward(positions).point_mm)
    course = _Course(tips, path, np.full(len(path), 120.0))
    positions = path[rng.integers(0, len(path), 400)] + np.pad(rng.normal(0.0, 0.02, (400, 3)), ((0, 0), (0, 2)))
    points = tips.at(positions, None)
    vertices = course._points
    start, along = vertices[:-1], np.diff(vertices, axis=0)
    share = np.einsum("nmi,mi->nm", points[:, None] - start, along) / np.maximum((along**2).sum(axis=1), 1e-30)
    foot = start + np.clip(share, 0.0, 1.0)[:, :, None] * along
    every = 1e3 * np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)
    assert np.allclose(course.off(tips, SimpleNamespace(positions=positions, lengths=None)), every, atol=1e-6)
