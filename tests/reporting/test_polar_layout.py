"""Tests of the fixed layout of polar pictures: every text is inside the picture, and none covers another."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.reporting.contributions import Motion, motions
from twin.reporting.identified import PositionEstimates
from twin.reporting.plots import plot_motion
from twin.tool.forward import Kinematics


@pytest.fixture(scope="module")
def motion(dmu50: Machine, calibration: Calibration) -> Motion:
    return next(one for one in motions(Kinematics(dmu50, calibration)) if one.name == "E_XC")


@pytest.mark.parametrize("readings", [False, True])
@pytest.mark.parametrize(
    ("low", "high"), [(0, 360), (0, 180), (-5, 110), (-120, 120), (-110, 5), (-150, -30), (90, 270)]
)
def test_texts_are_inside_and_apart(motion: Motion, low: float, high: float, readings: bool) -> None:
    q = np.linspace(low, high, 181)
    value = 1.0 + 3.0 * np.sin(q / 40.0)
    shown = replace(motion, position=q, value=value, half=np.full(181, np.nan), ways=None, corrected=None)
    stops: list[PositionEstimates] = []
    if readings:
        shown = replace(shown, half=np.full(181, 0.7), ways=(value + 0.3, value - 0.3), corrected=0.2 * value)
        at, half = q[::40], np.full(5, 0.5)
        stops = [PositionEstimates(motion.name, side, at, value[::40], half) for side in (1, -1)]
    figure = plot_motion(shown, stops)
    figure.canvas.draw()
    plot = figure.axes[0]
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    labels = [one for one in plot.texts if one.get_text().endswith("°")]
    assert len(labels) >= 4
    legend = figure.legends[0].get_window_extent(renderer)
    boxes = [*(one.get_window_extent(renderer) for one in labels), legend]
    title = plot.get_title(loc="left")
    assert title.startswith(motion.name)
    for box in boxes:
        assert 0.0 <= box.x0 and box.x1 <= figure.bbox.x1 and 0.0 <= box.y0 and box.y1 <= figure.bbox.y1
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
