"""The page of an identification: complete, self-contained, with where its numbers are from."""

from __future__ import annotations

import re

import numpy as np
import pytest

import twin
from tests.model.errors import random_calibration
from twin.identification.plots import identification_html
from twin.machine.machine import Machine


@pytest.mark.slow
def test_the_page_holds_every_error_and_asks_for_nothing(dmu50: Machine) -> None:
    errors = random_calibration(dmu50, np.random.default_rng(4), size=20.0)
    table, _ = twin.simulate(
        twin.thesis_plan.plan(dmu50), dmu50, errors, twin.instruments.LaserTracker(), np.random.default_rng(3)
    )
    found = twin.identify(table, dmu50)
    page = identification_html(found)
    assert "SIMULATED READINGS" in page
    for name in (*found.calibration.curves, *found.calibration.squareness, *found.calibration.location):
        assert re.sub(r"_(\w+)", r"<sub>\1</sub>", name) in page or name in page, name
    images = re.findall(r"<img\b[^>]*>", page)
    assert len(images) == 2 + len(dmu50.axes)
    assert all('alt="' in image for image in images)
    assert not re.search(r"(?:src|href)=[\"']?https?:", page)
    assert "Content-Security-Policy" in page


def test_constants_alone_have_a_page(dmu50: Machine) -> None:
    errors = random_calibration(dmu50, np.random.default_rng(4), size=20.0)
    table, _ = twin.simulate(
        twin.thesis_plan.plan(dmu50), dmu50, errors, twin.instruments.LaserTracker(), np.random.default_rng(3)
    )
    found = twin.identify(table, dmu50, wanted=lambda name: name[3] == "0")
    page = identification_html(found)
    assert not found.calibration.curves
    assert "Error motions</h2>" not in page
    assert page.count("<img") >= 1
