"""Tests of displays in notebooks: valid markup, units, unknown values, illustrative values, no requests to the network."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from twin.compensation import Options, compensate
from twin.compensation.fewer_blocks import refit
from twin.compensation.programs.execute import execute_file
from twin.compensation.programs.words import Setup
from twin.compute.parallel import Workers
from twin.diagnosis import diagnose
from twin.display import graph, histogram, measured, rounded
from twin.display.markup import ACCENT, WARNING
from twin.display.numbers import p_value_text, ticks
from twin.identification import Identification, identify
from twin.machine.machine import Machine
from twin.measurement.checks import RowNote
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects.entries import effect_named
from twin.model.iso16907 import Scope
from twin.model.motion_curve import Curve
from twin.numerics.covariance import Covariance
from twin.planning import judge
from twin.reporting.scene.draw import Scene
from twin.samples import thesis_plan
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse
from twin.tool.population import draw_machines
from twin.tool.uncertainty import ToolUncertainty, UncertaintyMap

SCRIPT = "<script>alert('x')</script> & <b>bold</b>"
VOID = {"br", "hr", "img", "input", "meta"}
TOOL_MM = 120.0


class Checked(HTMLParser):
    """Parser that checks the nesting of tags and collects tags and text."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def shown(thing: Any) -> Checked:
    return Checked(thing._repr_html_())


@pytest.fixture(scope="module")
def drawn(dmu50: Machine) -> Calibration:
    return Calibration.default(dmu50)


@pytest.fixture(scope="module")
def readings(dmu50: Machine, drawn: Calibration) -> Measurements:
    plan = thesis_plan.plan(dmu50)
    data, _ = simulate(plan.select(plan.round == "1"), dmu50, drawn, LaserTracker(), np.random.default_rng(7))
    return data


@pytest.fixture(scope="module")
def found(dmu50: Machine, readings: Measurements) -> Identification:
    return identify(readings, dmu50)


@pytest.fixture(scope="module")
def everything(
    dmu50: Machine,
    drawn: Calibration,
    readings: Measurements,
    found: Identification,
    tmp_path_factory: pytest.TempPathFactory,
) -> Mapping[str, Any]:
    """Return one object of every kind that has a display."""
    arc = tmp_path_factory.mktemp("arc") / "arc.nc"
    angles = np.linspace(0.0, 1.5, 31)
    arc.write_text("".join(f"G1 F900 X{200 + 50 * np.cos(a):.3f} Y{200 + 50 * np.sin(a):.3f} Z-200.\n" for a in angles))
    real = Kinematics(dmu50, drawn, tool_length_mm=TOOL_MM)
    known = Kinematics(dmu50, found.calibration, tool_length_mm=TOOL_MM)
    q = np.array([[x, 200.0, -200.0, 30.0, 45.0] for x in np.linspace(0.0, 500.0, 9)])
    poses = real.forward(q)
    options = Options(tool_length_mm=TOOL_MM)
    tool = ToolUncertainty(known)
    reversal = effect_named("reversal", "Y", {"size": 5.1}, dmu50)
    return {
        "machine": dmu50,
        "axis": dmu50.axes[3],
        "calibration": drawn,
        "extended": replace(drawn, extra=(reversal,)),
        "zero": Calibration.zero(dmu50),
        "identified": found.calibration,
        "curve": drawn.curves["E_AX"],
        "identified curve": found.calibration.curves["E_XX"],
        "kinematics": real,
        "poses": poses,
        "solution": Inverse(real).solve(poses, q),
        "options": options,
        "setup": Setup(work_offset={"X": 250.0}),
        "scope": Scope.parse(["L-VOL", "FOR"]),
        "compensation": compensate("cone_frustum.nc", dmu50, drawn, options=options),
        "compensation known": compensate("cone_frustum.nc", dmu50, found.calibration, options=options),
        "execution": execute_file("cone_frustum.nc", dmu50, drawn, tool_length_mm=TOOL_MM),
        "refit": refit(arc, dmu50, drawn, options=Options(tool_length_mm=TOOL_MM, tolerance_mm=0.01)),
        "measurements": readings,
        "plan table": thesis_plan.plan(dmu50),
        "identification": found,
        "diagnosis": diagnose(readings, dmu50, drawn, instrument=LaserTracker()),
        "tool uncertainty": tool,
        "map": tool.over_volume(50),
        "pose uncertainty": tool.at(q),
        "unknown map": ToolUncertainty(real).over_volume(50),
        "population": draw_machines(known, trials=2000, poses=20, seed=1, workers=Workers(1)),
        "forecast": judge(thesis_plan.plan(dmu50), dmu50, tool_length_mm=TOOL_MM),
    }


def test_markup_is_valid_and_loads_nothing(everything: Mapping[str, Any]) -> None:
    for name, thing in everything.items():
        text = thing._repr_html_()
        tags = set(Checked(text).tags)
        assert not tags & {"script", "style", "link", "img", "iframe", "html", "body"}, name
        assert "http:" not in text and "url(" not in text, name


def test_colours_are_legible_on_light_and_dark(everything: Mapping[str, Any]) -> None:
    """Colours are legible on light and dark: text colour, semi-transparent grey and two accents."""
    allowed = {"currentColor", "none", "inherit", ACCENT, WARNING, "rgba(128,128,128,.4)", "rgba(128,128,128,.18)"}
    allowed |= {"#009e73", "#e69f00", "#0072b2"}  # the edges of a diagnosis next to text
    for name, thing in everything.items():
        text = thing._repr_html_()
        named = re.findall(r"(?:fill|stroke)='([^']+)'", text) + re.findall(r"(?:background|[^-]color):([^;']+)", text)
        named += re.findall(r"(?:#[0-9a-f]{3,6}\b(?=[;'])|rgba?\([^)]*\))", text)
        assert set(named) <= allowed, name


UNITS = {
    "machine": ["mm", "°"],
    "axis": ["°"],
    "calibration": ["µm", "µrad", "mm", "°"],
    "extended": ["size 5.1 µm"],
    "identified": ["µm", "µrad", "mm", "°"],
    "curve": ["µrad", "mm"],
    "identified curve": ["µm", "mm"],
    "kinematics": ["mm and degrees", "120 mm"],
    "poses": ["x (mm)", "y (mm)", "z (mm)"],
    "solution": ["µm", "µrad", "mm and degrees"],
    "options": ["mm", "µm", "°"],
    "setup": ["mm", "°"],
    "compensation": ["RMS, µm", "axis RMS, µrad", "mm"],
    "execution": ["µm", "µrad"],
    "refit": ["µm"],
    "measurements": ["mm", "°"],
    "identification": ["µm", "µrad", "mm", "°"],
    "map": ["µm", "mm, °"],
    "pose uncertainty": ["µm"],
    "population": ["µm"],
    "forecast": ["µm", "µrad", "mm"],
}


@pytest.mark.parametrize("name", UNITS)
def test_units_are_named(name: str, everything: Mapping[str, Any]) -> None:
    text = shown(everything[name]).text
    assert [unit for unit in UNITS[name] if unit not in text] == []


HEADERS = {
    "poses": [["x (mm)", "y (mm)", "z (mm)", "i", "j", "k"]],
    "compensation": [
        ["error at the tool over 2,175 poses", "RMS, µm", "largest, µm", "line", "axis RMS, µrad", ""],
        ["ISO/TR 16907 class, alone", "RMS before, µm", "largest, µm", "", ""],
    ],
    "refit": [["of 10 µm", "share, µm", "used, µm", ""]],
    "population": [["machines", "error at the tool, µm", "mean", "95 % of the machines", "maximum"]],
}
"""Units in the headers of every display's tables."""


@pytest.mark.parametrize("name", UNITS)
def test_units_of_columns_are_those_of_their_numbers(name: str, everything: Mapping[str, Any]) -> None:
    rows = re.findall(r"<tr[^>]*>((?:(?!</tr>).)*<th.*?)</tr>", everything[name]._repr_html_(), re.S)
    cells = [[re.sub("<[^>]+>", "", cell) for cell in re.findall(r"<th[^>]*>(.*?)</th>", row, re.S)] for row in rows]
    with_units = [row for row in cells if any(re.search(r"[\s(](µm|µrad|mm|m|°)\)?$", cell) for cell in row)]
    assert with_units == HEADERS.get(name, [])


DRAWN = ["calibration", "extended", "curve", "kinematics", "compensation", "refit", "diagnosis"]


def test_illustrative_values_are_marked(everything: Mapping[str, Any]) -> None:
    for name in DRAWN:
        assert "ILLUSTRATIVE" in shown(everything[name]).text, name
    for name in ("zero", "identified", "identified curve", "compensation known", "map"):
        assert "ILLUSTRATIVE" not in shown(everything[name]).text, name
    assert "E_AX*" in shown(everything["calibration"]).text and "E_XX*" not in shown(everything["calibration"]).text


def test_unknown_is_never_zero(everything: Mapping[str, Any]) -> None:
    for name in (
        "calibration",
        "extended",
        "curve",
        "compensation",
        "refit",
        "unknown map",
        "identification",
        "forecast",
    ):
        assert "unknown" in shown(everything[name]).text, name
    unknown = shown(everything["unknown map"])
    assert "µm" not in unknown.text and "svg" not in unknown.tags  # no number, and no picture
    assert "± 0" not in shown(everything["calibration"]).text
    assert shown(everything["calibration"]).tags.count("polygon") == 0  # no band
    assert shown(everything["identified"]).tags.count("polygon") == 30
    assert "not stated" in shown(everything["measurements"]).text


def test_partly_known_uncertainty(dmu50: Machine, drawn: Calibration) -> None:
    """A curve with a covariance has the interval √(fᵀΣf), computed by hand; the others stay unknown."""
    covariance = np.diag([4.0, 9.0])
    curve = Curve("E_XX", "um", (0.0, 500.0), "power", (0.0, 10.0), covariance)
    mixed = replace(drawn, curves=MappingProxyType({"E_XX": curve, "E_YY": drawn.curves["E_YY"]}))
    page = shown(mixed)
    assert page.tags.count("polygon") == 1
    half = 1.96 * np.sqrt(4.0 + 9.0)  # widest at the ends, u = ±1
    assert re.search(rf"10\.0 ± {half:.1f} µm", page.text.replace("−", ""))
    peak = np.abs(drawn.curves["E_YY"](np.linspace(0.0, 450.0, 401))).max()
    assert re.search(rf"{peak:.1f} µm, ± unknown".replace(".", r"\."), page.text)
    over = UncertaintyMap(dmu50.names, np.zeros((1, 5)), ToolUncertainty(Kinematics(dmu50, mixed)).at(np.zeros((1, 5))))
    assert "at least" in shown(over).text and "E_YY" in shown(over).text


def test_text_is_escaped(
    dmu50: Machine, drawn: Calibration, readings: Measurements, everything: Mapping[str, Any]
) -> None:
    bad = replace(drawn, source=SCRIPT, curves=MappingProxyType({"E_AX": replace(drawn.curves["E_AX"], source=SCRIPT)}))
    report = replace(everything["compensation"].report, program=SCRIPT, machine=SCRIPT)
    table = replace(readings, source=SCRIPT, notices=(SCRIPT,), set_aside=(RowNote(3, SCRIPT),))
    refitted = replace(everything["refit"].report, machine=SCRIPT)
    warm = Kinematics(dmu50, replace(bad, extra=()), conditions=Conditions({SCRIPT: 21.0}))
    for thing in (bad, bad.curves["E_AX"], report, table, refitted, warm):
        text = thing._repr_html_()
        assert "<script" not in text and "<b>bold" not in text
        assert "<script>alert" in Checked(text).text
    assert "script" not in Checked(graph(np.arange(3.0), np.ones(3), None, SCRIPT, SCRIPT).text).tags


def test_a_scene_is_displayed_in_a_frame() -> None:
    page = "<!doctype html><html><body onload=\"a('b')\"><script>1 < 2 && 3</script></body></html>"
    text = Scene(page, None)._repr_html_()  # type: ignore[arg-type]
    assert set(Checked(text).tags) == {"div", "iframe"}
    (source,) = re.findall(r'srcdoc="([^"]*)"', text)
    assert html.unescape(source) == page


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("dmu50", "workpiece – C – B – base – X – Y – Z – tool"),
        ("trunnion_ac", "workpiece – C – A – Y – base – X – Z – tool"),  # from the head of its URDF
    ],
)
def test_the_chain_is_in_order(name: str, order: str) -> None:
    assert order in shown(Machine.load(name)).text


def test_empty_objects_have_a_display(dmu50: Machine, everything: Mapping[str, Any], found: Identification) -> None:
    none = np.zeros((0, 5))
    real = everything["kinematics"]
    poses = real.forward(none)
    for thing in (
        poses,
        Inverse(real).solve(poses, none),
        everything["tool uncertainty"].at(none),
        UncertaintyMap(dmu50.names, none, everything["tool uncertainty"].at(none)),
        everything["measurements"].select(np.zeros(0, dtype=int)),
        Options(),
        Kinematics(dmu50, Calibration.zero(dmu50)),
        replace(found, unidentified=(), set_aside=(RowNote(7, "no number"),), converged=False),
    ):
        assert shown(thing).text


def test_an_estimate_that_did_not_converge_is_marked(found: Identification) -> None:
    page = shown(replace(found, converged=False))
    assert "DID NOT CONVERGE" in page.text and WARNING in replace(found, converged=False)._repr_html_()


def test_unmet_requirements_are_highlighted(dmu50: Machine, drawn: Calibration, everything: Mapping[str, Any]) -> None:
    real = everything["kinematics"]
    at = np.array([[250.0, 225.0, -200.0, 0.0, 0.0]])
    far = replace(real.forward(at), point_mm=np.array([[5000.0, 0.0, 0.0]]))
    missed = Inverse(real).solve(far, at)
    assert WARNING in missed._repr_html_() and "out of range" in shown(missed).text
    assert WARNING not in everything["solution"]._repr_html_()


def test_identified_numbers_are_the_identification_s(everything: Mapping[str, Any], found: Identification) -> None:
    """Compare peak and widest interval of every error with `Identification.rows`, which computes them independently."""
    text = shown(everything["identification"]).text
    for row in found.rows():
        name, unit = row["name"], "µm" if row["unit"] == "um" else "µrad"
        (size, half) = re.findall(rf"{name}[^±]*?(−?[\d.]+) ± ([\d.]+) {unit}", text)[0]
        expected, u = (row["peak"], row["u_max"]) if "peak" in row else (abs(row["value"]), row["u"])
        step = 10.0 ** -len(half.partition(".")[2])
        # 121 positions of a strip against 201 of a row: small differences of a peak, and rounding to the last digit.
        assert abs(float(size.replace("−", "")) - expected) <= 0.01 * expected + step
        assert float(half) == pytest.approx(1.96 * u, abs=0.02 * u + step)


def test_a_measured_number_by_hand() -> None:
    assert measured(9.2871, 0.26, "um") == "9.29 ± 0.51 µm"  # 1.96 · 0.26 = 0.5096
    assert measured(-123.4, 21.0, "urad") == "−123 ± 41 µrad"
    assert measured(-0.04, 1.0, "um") == "0.0 ± 2.0 µm"  # no minus sign before zero
    assert measured(22.0, float("nan"), "urad") == "22 µrad, ± unknown"
    assert rounded(0.5, 0.0) == ("0.500", "0.000")


@settings(max_examples=200)
@given(st.floats(-1e4, 1e4), st.floats(1e-2, 1e3))
def test_rounding_keeps_two_digits_of_the_uncertainty(value: float, expanded: float) -> None:
    size, half = rounded(value, expanded)
    step = 10.0 ** -len(half.partition(".")[2])
    assert abs(float(size) - value) <= 0.5 * step + 1e-9 and abs(float(half) - expanded) <= 0.5 * step + 1e-9
    digits = half.replace(".", "").strip("0")
    assert len(digits) <= 2 or float(half) >= 100.0  # a large number has no decimals
    assert step >= 0.001


@settings(max_examples=200)
@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e5))
def test_ticks_are_inside_even_and_few(low: float, width: float) -> None:
    found = np.array(ticks(low, low + width))
    assert 1 <= len(found) <= 5
    assert np.all(found >= low - 1e-6 * width) and np.all(found <= low + (1 + 1e-6) * width)
    if len(found) > 2:
        assert np.ptp(np.diff(found)) <= 1e-6 * width


def plotted(text: str) -> tuple[np.ndarray, Mapping[str, tuple[float, float]]]:
    """Return the points of the curve in the units of the plot, converted by its printed ticks."""
    (line,) = re.findall(r"<polyline points='([^']*)'", text)
    points = np.array([[float(v) for v in pair.split(",")] for pair in line.split()])
    labels = re.findall(r"<text x='([\d.]+)' y='([\d.]+)' text-anchor='(\w+)'[^>]*>(−?[\d.]+)<", text)
    across = [(float(x), float(v.replace("−", "-"))) for x, _, anchor, v in labels if anchor == "middle"]
    up = [(float(y) - 4.0, float(v.replace("−", "-"))) for _, y, anchor, v in labels if anchor == "end"]
    scales = {name: np.polyfit(*np.array(pairs).T, 1) for name, pairs in (("x", across), ("y", up))}
    values = np.column_stack([np.polyval(scales["x"], points[:, 0]), np.polyval(scales["y"], points[:, 1])])
    return values, scales


def test_a_curve_is_where_its_ticks_say(drawn: Calibration) -> None:
    curve = drawn.curves["E_ZX"]
    values, _ = plotted(curve._repr_html_())
    # Printed to 0.1 pixel on about 300 by 140: 0.1 %.
    assert values[:, 0] == pytest.approx(np.linspace(0.0, 500.0, len(values)), abs=1.0)
    assert values[:, 1] == pytest.approx(curve(np.clip(values[:, 0], 0.0, 500.0)), abs=0.15)


def test_a_histogram_counts_all() -> None:
    values = np.random.default_rng(3).uniform(1.0, 9.0, 500)
    text = histogram(values, "U (µm)").text
    heights = np.array([float(h) for h in re.findall(r"<rect[^>]*height='([\d.]+)'", text)])
    counts, _ = np.histogram(values, bins=20, range=(0.0, values.max()))
    assert heights / heights.max() == pytest.approx(
        counts / counts.max(), abs=0.002
    )  # heights are printed to 0.1 of 138
    assert histogram(np.full(3, np.nan), "U (µm)").text == ""


@pytest.mark.slow
def test_no_library_is_needed() -> None:
    """Displays do not import matplotlib, which is optional."""
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "from twin import Calibration, Machine\n"
        "machine = Machine.load('dmu50'); calibration = Calibration.default(machine)\n"
        "sys.exit(not all('<' in x._repr_html_() for x in (machine, calibration, *calibration.curves.values())))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_every_exported_result_has_a_display() -> None:
    """Every result class that `twin` exports has a display; computing classes, errors and enumerations have none."""
    silent = {
        "Compensator",
        "Conditions",
        "InputError",
        "InstrumentSizes",
        "Inverse",
        "Kit",
        "Placement",
        "Status",
        "ThermalRecord",
        "ThesisMethod",
        "WatchSettings",
        "Workers",
    }
    classes = {name for name in twin.__all__ if isinstance(getattr(twin, name), type)}
    assert {name for name in classes if not hasattr(getattr(twin, name), "_repr_html_")} <= silent


def test_a_joint_covariance_is_used(dmu50: Machine) -> None:
    """With one covariance of two errors, the squareness shows its own interval."""
    joint = Covariance(("E_C0Y", "E_X0C"), np.diag([25.0, 4.0]))
    one = replace(
        Calibration.zero(dmu50),
        squareness=MappingProxyType({"E_C0Y": 22.0}),
        location=MappingProxyType({"E_X0C": 4.0}),
        joint=joint,
    )
    text = shown(one).text
    assert "E_C0Y 22.0 ± 9.8 µrad" in text and "E_X0C 4.0 ± 3.9 µm" in text


def test_a_p_value_too_small_for_a_number_is_a_bound() -> None:
    assert [p_value_text(p) for p in (0.012345, 1.0, 1e-98, 1e-100)] == ["p = 0.012", "p = 1", "p = 1e-98", "p < 1e-99"]
