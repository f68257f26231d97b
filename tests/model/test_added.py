"""An effect and an instrument are added to a copy of the package, one file and one line each, and are complete everywhere."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.truth import hidden

Run = Callable[..., str]
PACKAGE = Path(twin.__file__).parent
SIGMA_MM = 2e-3
PERIOD_MM = 60.0
COSINE_UM, SINE_UM = 4.0, -3.0
EFFECT = '''
"""Straightness error that repeats with the screws of a guide rail."""

from math import pi

from twin.model.effects.base import Effect, Frame, split_name
from twin.model.effects.specification import NOTHING, REST, Advice, Drawing, Forms, Specification
from twin.numerics.functions import cos, sin

PITCH_MM = 60.0


class RailScrews(Effect):
    """e = a·cos(2πq/p) + b·sin(2πq/p), p the pitch of the screws."""

    def __init__(self, where, period, cosine, sine):
        self.name = f"rail_screws:{where}"
        self.period, self.cosine, self.sine = period, cosine, sine
        self.component, _, self.axis = split_name(where)
        self.frame = Frame(self.axis, "motion")

    @property
    def parameters(self):
        return self._number("cos", "um", self.cosine), self._number("sin", "um", self.sine)

    @property
    def numbers(self):
        return {"period": self.period, **super().numbers}

    def components(self, positions):
        return {i: self.cosine * c[i] + self.sine * s[i] for c, s in [self.derivatives(positions)] for i in c}

    def derivatives(self, positions):
        angle = positions[self.axis] * (2.0 * pi / self.period)
        return {self.component: cos(angle)}, {self.component: sin(angle)}


def places(machine):
    linear = [axis.name for axis in machine.axes if axis.linear]
    return tuple(f"E_{way}{axis}" for axis in linear for way in "XYZ" if way != axis)


def forms(machine, where, state, payloads):
    return Forms(
        (("cos", "um"), ("sin", "um")),
        lambda values, fixed: (RailScrews(where, fixed["period"], float(values[0]), float(values[1])),),
        lambda fixed: (RailScrews(where, fixed["period"], 1.0, 0.0), RailScrews(where, fixed["period"], 0.0, 1.0)),
        ({"period": PITCH_MM},),
    )


RAIL_SCREWS = Specification(
    name="rail_screws",
    kind="machine",
    title=lambda where: f"ripple of the rail in {where}",
    family="ripples of rails",
    advice=Advice("Service: torque of the screws of the rail of {axis}.", REST, NOTHING),
    evidence=lambda fit: f"{fit.where} repeats with the screws of the rail",
    parameters=("period", "cos", "sin"),
    fixed={"period": "mm"},
    limits={"um": 100.0},
    places=places,
    make=lambda machine, where, numbers, payloads: RailScrews(where, numbers["period"], numbers["cos"], numbers["sin"]),
    forms=forms,
    drawing=Drawing(period=lambda numbers: numbers["period"]),
)
'''
INSTRUMENT = '''
"""A camera that sees the three coordinates of a target."""

from dataclasses import dataclass

from twin.measurement.instruments.base import SIDES, InstrumentSpecification, IsotropicNoise

CAMERA = InstrumentSpecification(
    name="camera",
    title="photogrammetric camera",
    columns=("x_mm", "y_mm", "z_mm"),
    reads="point",
    free_start=False,
    rides_on=SIDES,
    effects=("frame_shift", "target_shift"),
    source="assumed: 2 µm",
    beam=False,
)


@dataclass(frozen=True)
class Camera(IsotropicNoise):
    """A camera."""

    sigma_um: float = 2.0
    specification: InstrumentSpecification = CAMERA
'''


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a function that runs the copy with both added, and returns what it prints."""
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(PACKAGE, folder / "twin", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "urdf").symlink_to(PACKAGE.parent / "urdf")
    (folder / "twin" / "model" / "effects" / "rail_screws.py").write_text(EFFECT)
    (folder / "twin" / "measurement" / "instruments" / "camera.py").write_text(INSTRUMENT)
    names = folder / "twin" / "_common" / "families.py"
    text = names.read_text()
    for table, line in (
        ("EFFECTS", '"rail_screws": "rail_screws:RAIL_SCREWS"'),
        ("INSTRUMENTS", '"camera": "camera:Camera"'),
    ):
        text, count = re.subn(rf"^({table}: Final = {{)$", rf"\1\n    {line},", text, flags=re.MULTILINE)
        assert count == 1
    names.write_text(text)

    def ran(*arguments: object) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "twin.cli", *map(str, arguments)],
            capture_output=True,
            text=True,
            cwd=folder,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return ran


def ripple(of: hidden.Plan) -> np.ndarray:
    """Return (n, 3) mm: X carries the tool along the base, so that its straightness error shifts the targets of that side alone."""
    angle = 2.0 * np.pi * of.at("X") / PERIOD_MM
    shift = np.zeros((len(of.q), 3))
    shift[:, 2] = 1e-3 * (of.carrier == "tool") * (COSINE_UM * np.cos(angle) + SINE_UM * np.sin(angle))
    return shift


def test_an_added_effect_is_found_with_its_fixed_number(run: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    of = hidden.rounded(hidden.plan(rng, poses=60, rounds=1))
    read = hidden.noisy(hidden.points(of, outside=ripple), rng, "isotropic", SIGMA_MM)
    table = hidden.write(tmp_path / "measured.csv", of, read, u_mm=SIGMA_MM)
    files = {suffix: tmp_path / f"found.{suffix}" for suffix in ("json", "html", "yaml")}
    calibration = hidden.CALIBRATION
    text = run(
        "diagnose",
        table,
        "-c",
        calibration,
        "--json",
        files["json"],
        "--html",
        files["html"],
        "--extended",
        files["yaml"],
    )
    (cause,) = json.loads(files["json"].read_text())["causes"]
    assert (cause["effect"], cause["where"]) == ("rail_screws", "E_ZX")
    period, cosine, sine = cause["parameters"]
    assert period == {"name": "period", "value": PERIOD_MM, "unit": "mm", "u": 0.0}
    for number, truth in ((cosine, COSINE_UM), (sine, SINE_UM)):
        assert abs(number["value"] - truth) < 4.0 * number["u"]
    page = unescape(re.sub(r"<[^>]+>", " ", files["html"].read_text()))
    for shown in (" ".join(text.split()), " ".join(page.split())):
        assert "Ripple of the rail in E_ZX" in shown
        assert "period 60 mm" in shown
        assert "screws of the rail of X" in shown
    again = run("info", "-c", files["yaml"])
    assert "rail_screws" in again or "Ripple of the rail" in again


def test_an_added_effect_is_in_the_manual_and_in_plans(run: Run, tmp_path: Path) -> None:
    assert "twin doc effects" in run("doc")
    pages = tmp_path / "pages.json"
    run("doc", "--json", pages)
    assert (
        "| `rail_screws` | ripples of rails | cos, sin | period mm | ±100 µm |"
        in json.loads(pages.read_text())["pages"]["effects"]
    )


def test_an_added_instrument_is_complete(run: Run, tmp_path: Path) -> None:
    pages = tmp_path / "pages.json"
    run("doc", "--json", pages)
    row = "| `camera` | photogrammetric camera | x_mm, y_mm, z_mm | base, tool, work | assumed: 2 µm |"
    assert row in json.loads(pages.read_text())["pages"]["instruments"]
    assert "camera" in run("simulate", "--help")
    table, found, page = tmp_path / "m.csv", tmp_path / "d.json", tmp_path / "d.html"
    run("simulate", "thesis_plan.csv", "-o", table, "--instrument", "camera", "--seed", "3")
    text = run("diagnose", table, "--instrument", "camera", "--json", found, "--html", page)
    assert "camera" in text
    assert "camera" in json.loads(found.read_text())["noise_source"]
    assert "camera" in page.read_text()
