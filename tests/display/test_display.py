"""Tests of displays in notebooks: valid markup, units, unknown values, illustrative values, no requests to the network."""

from __future__ import annotations

import html
import inspect
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import fields, replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from tests.measurement.formats.cases import CASES
from tests.measurement.importing import shop_files
from tests.monitoring.folder import write_folder
from tests.thermal import machine_room
from tests.thermal.chains import short_chains
from tests.truth.machine import TruthMachine
from twin.compensation import Options, compensate
from twin.compensation.fewer_blocks import refit
from twin.compensation.programs.execute import Execution
from twin.compute.parallel import Workers
from twin.diagnosis import diagnose
from twin.display import measured, rounded
from twin.display.markup import ACCENT, WARNING
from twin.display.numbers import p_value_text
from twin.display.results import LONGEST, DisplayedResult, Result
from twin.identification import Identification, identify
from twin.machine.machine import Machine
from twin.measurement.columns import RowNote
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import Placement, simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects.entries import effect_named
from twin.model.motion_curve import Curve
from twin.numerics.covariance import Covariance
from twin.part.forecast import PartForecast
from twin.planning import judge
from twin.reporting.scene.draw import Scene
from twin.samples import thesis_plan
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse
from twin.tool.population import draw_machines
from twin.tool.uncertainty import ToolUncertainty, UncertaintyMap

DRAWN_FILE = Path(__file__).resolve().parents[2] / "urdf" / "dmu50.calibration.yaml"
LASER = next(iter(CASES.values()))
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
    """Return results that a notebook displays."""
    checks = write_folder(tmp_path_factory.mktemp("watch") / "checks", TruthMachine(DRAWN_FILE), 3, seed=3)
    options = Options(tool_length_mm=TOOL_MM)
    reversal = effect_named("reversal", "Y", {"size": 5.1}, dmu50)
    return {
        "machine": dmu50,
        "calibration": drawn,
        "extended": replace(drawn, extra=(reversal,)),
        "zero": Calibration.zero(dmu50),
        "identified": found.calibration,
        "compensation": compensate("cone_frustum.nc", dmu50, drawn, options=options),
        "compensation known": compensate("cone_frustum.nc", dmu50, found.calibration, options=options),
        "measurements": readings,
        "plan table": thesis_plan.plan(dmu50),
        "identification": found,
        "diagnosis": diagnose(readings, dmu50, drawn, instrument=LaserTracker()),
        "plan": twin.plan(dmu50, minutes=30.0, tool_length_mm=TOOL_MM),
        "changes": twin.compare(drawn, found.calibration),
        "watch": twin.watch(checks, dmu50, drawn),
        "evaluation": twin.evaluate(readings, dmu50),
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
    for name, thing in everything.items():
        text = thing._repr_html_()
        named = re.findall(r"(?:fill|stroke)='([^']+)'", text) + re.findall(r"(?:background|[^-]color):([^;']+)", text)
        named += re.findall(r"(?:#[0-9a-f]{3,6}\b(?=[;'])|rgba?\([^)]*\))", text)
        assert set(named) <= allowed, name


UNITS = {
    "machine": ["mm", "°"],
    "calibration": ["µm", "µrad", "mm", "°"],
    "extended": ["size 5.1 µm"],
    "identified": ["µm", "µrad", "mm", "°"],
    "compensation": ["RMS, µm", "axis RMS, µrad", "mm"],
    "measurements": ["mm", "°"],
    "identification": ["µm", "µrad", "mm", "°"],
    "diagnosis": ["µm"],
    "plan": ["µm", "µrad", "mm"],
    "changes": ["µm RMS"],
    "watch": ["µm", "µrad"],
    "evaluation": ["µm"],
}


@pytest.mark.parametrize("name", UNITS)
def test_units_are_named(name: str, everything: Mapping[str, Any]) -> None:
    text = shown(everything[name]).text
    assert [unit for unit in UNITS[name] if unit not in text] == []


HEADERS = {
    "compensation": [
        ["error at the tool over 2,175 poses", "RMS, µm", "largest, µm", "line", "axis RMS, µrad", ""],
        ["ISO/TR 16907 class, alone", "RMS before, µm", "largest, µm", "", ""],
    ],
}
"""Units in the headers of every display's tables."""


@pytest.mark.parametrize("name", UNITS)
def test_units_of_columns_are_those_of_their_numbers(name: str, everything: Mapping[str, Any]) -> None:
    rows = re.findall(r"<tr[^>]*>((?:(?!</tr>).)*<th.*?)</tr>", everything[name]._repr_html_(), re.S)
    cells = [[re.sub("<[^>]+>", "", cell) for cell in re.findall(r"<th[^>]*>(.*?)</th>", row, re.S)] for row in rows]
    with_units = [row for row in cells if any(re.search(r"[\s(](µm|µrad|mm|m|°)\)?$", cell) for cell in row)]
    assert with_units == HEADERS.get(name, [])


DRAWN = ["calibration", "extended", "compensation", "diagnosis", "changes"]


def test_illustrative_values_are_marked(everything: Mapping[str, Any]) -> None:
    for name in DRAWN:
        assert "ILLUSTRATIVE" in shown(everything[name]).text, name
    for name in ("zero", "identified", "compensation known", "machine"):
        assert "ILLUSTRATIVE" not in shown(everything[name]).text, name
    assert "E_AX*" in shown(everything["calibration"]).text and "E_XX*" not in shown(everything["calibration"]).text


def test_unknown_is_never_zero(everything: Mapping[str, Any]) -> None:
    for name in ("calibration", "extended", "compensation", "identification", "plan", "changes"):
        assert "unknown" in shown(everything[name]).text, name
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


def test_text_is_escaped(
    dmu50: Machine, drawn: Calibration, readings: Measurements, everything: Mapping[str, Any]
) -> None:
    bad = replace(drawn, source=SCRIPT, curves=MappingProxyType({"E_AX": replace(drawn.curves["E_AX"], source=SCRIPT)}))
    report = replace(everything["compensation"].report, program=SCRIPT, machine=SCRIPT)
    table = replace(readings, source=SCRIPT, notices=(SCRIPT,), set_aside=(RowNote(3, SCRIPT),))
    for thing in (bad, report, table, replace(everything["changes"], second=SCRIPT)):
        text = thing._repr_html_()
        assert "<script" not in text and "<b>bold" not in text
        assert "<script>alert" in Checked(text).text


def test_a_scene_is_displayed_in_a_frame(executed: Execution) -> None:
    page = "<!doctype html><html><body onload=\"a('b')\"><script>1 < 2 && 3</script></body></html>"
    text = Scene(page, executed)._repr_html_()
    assert set(Checked(text).tags) == {"div", "iframe", "b", "span"}
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
    for thing in (
        everything["measurements"].select(np.zeros(0, dtype=int)),
        Calibration.zero(dmu50),
        replace(found, unidentified=(), set_aside=(RowNote(7, "no number"),), converged=False),
    ):
        assert shown(thing).text


def test_an_estimate_that_did_not_converge_is_marked(found: Identification) -> None:
    page = shown(replace(found, converged=False))
    assert "DID NOT CONVERGE" in page.text and WARNING in replace(found, converged=False)._repr_html_()


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


@pytest.mark.slow
def test_no_library_is_needed() -> None:
    """Displays do not import matplotlib, which is optional."""
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "from twin import Calibration, Machine\n"
        "machine = Machine.load('dmu50'); calibration = Calibration.default(machine)\n"
        "sys.exit(not all('<' in x._repr_html_() for x in (machine, calibration)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.fixture(scope="module")
def executed(dmu50: Machine, drawn: Calibration) -> Execution:
    return twin.execute_file("cone_frustum.nc", dmu50, drawn, tool_length_mm=TOOL_MM)


def returned() -> Mapping[str, type]:
    """Return the classes that functions and methods of the public API return, by name."""
    found: dict[str, type] = {}
    for one in (getattr(twin, name) for name in twin.__all__):
        methods = (
            [getattr(value, "__func__", value) for name, value in vars(one).items() if name[0] != "_"]
            if isinstance(one, type)
            else [one]
        )
        for function in filter(inspect.isfunction, methods):
            words = re.findall(r"\w+", str(function.__annotations__.get("return", "")))
            classes = [function.__globals__.get(word) for word in words]
            found |= {c.__name__: c for c in classes if isinstance(c, type) and c.__module__.startswith("twin.")}
    return found


COMPUTING = {
    *("Contrasts", "Dialect", "Display", "Effect", "ErrorMotion"),
    *("InputError", "Kinematics", "Scope", "WrittenValue"),
}
"""Classes that the API returns and that are no results: they compute, or are parts or settings."""
DISPLAYED = {
    *(
        "Calibration",
        "Changes",
        "Compensation",
        "Diagnosis",
        "EvaluationResult",
        "Identification",
        "Machine",
        "Measurements",
    ),
    *("Plan", "Report", "Scene", "Watch"),
}


@pytest.fixture(scope="module")
def results(
    dmu50: Machine,
    drawn: Calibration,
    readings: Measurements,
    found: Identification,
    everything: Mapping[str, Any],
    executed: Execution,
    tmp_path_factory: pytest.TempPathFactory,
) -> Mapping[str, Any]:
    """Return a result of every class of `returned`, by its name; lists and paths are long."""
    folder = tmp_path_factory.mktemp("a folder with a long name " * 8)
    offsets, tools, log, shop = (folder / name for name in ("offsets.csv", "tools.csv", "log.csv", "shop.csv"))
    offsets.write_text("offset,X_mm,Y_mm,Z_mm\n" + "".join(f"P{i},1,2,3\n" for i in range(1, 90)))
    tools.write_text("tool,name,length_mm\n" + "".join(f"{i},MILL_D{i},80\n" for i in range(1, 90)))
    log.write_text("time_s,T_X_degC,spindle_rpm\n0,20,0\n60,21,8000\n")
    shop.write_bytes(shop_files.cmm_report())
    arc = folder / "arc.nc"
    angles = np.linspace(0.0, 1.5, 31)
    arc.write_text("".join(f"G1 F900 X{200 + 50 * np.cos(a):.3f} Y{200 + 50 * np.sin(a):.3f} Z-200.\n" for a in angles))
    options = Options(tool_length_mm=TOOL_MM, tolerance_mm=0.01)
    real, known = (Kinematics(dmu50, one, tool_length_mm=TOOL_MM) for one in (drawn, found.calibration))
    q = np.array([[x, 200.0, -200.0, 30.0, 45.0] for x in np.linspace(0.0, 500.0, 9)])
    tool, plan, laser = ToolUncertainty(known), thesis_plan.plan(dmu50), folder / LASER.FILE
    laser.write_text(LASER.GOOD, encoding="utf-8", newline="")
    record = twin.ThermalRecord.load(machine_room.write(machine_room.simulate(1), folder / "record.csv"))
    with short_chains():
        thermal = twin.fit_thermal(record)
    (outcome,) = twin.compensate_files([arc], folder / "out", dmu50, drawn, options=options, workers=Workers(1))
    made = [
        *everything.values(),
        everything["compensation"].report,
        drawn.curves["E_AX"],
        *(executed, Scene("<html>" * 100_000, executed), outcome, refit(arc, dmu50, drawn, options=options)),
        *(real.forward(q), real.sensitivities(q), Inverse(real).solve(real.forward(q), q)),
        *(tool.at(q), tool.over_volume(50), draw_machines(known, trials=2000, poses=20, seed=1, workers=Workers(1))),
        *(
            twin.load_offsets(offsets),
            twin.load_tools(tools),
            twin.MachineLog.load(log),
            twin.import_table(shop, dmu50),
        ),
        *(twin.read_program(arc)[0], twin.convert(laser, Machine.load(LASER.MACHINE), LASER.GIVEN)),
        *(
            twin.Kit.default(dmu50),
            Placement.draw(plan, np.random.default_rng(1)),
            judge(plan, dmu50, tool_length_mm=TOOL_MM),
        ),
        twin.measuring_sequence(dmu50, "probe", minutes=10.0),
        twin.drift_plan(dmu50, "environment", "probe", sizes=twin.InstrumentSizes(TOOL_MM)),
        twin.identify_as_thesis(simulate(plan, dmu50, drawn, LaserTracker(), np.random.default_rng(7))[0], dmu50),
        *(twin.calibrated_urdf(drawn), record, thermal),
        twin.report(dmu50, Calibration.zero(dmu50), made=datetime(2026, 1, 2, tzinfo=UTC)),
        twin.check_program(arc, dmu50, options=options),
        twin.Artefact("a.xml", "1", "bar", ("S1", "S2"), np.array([[0, 1]]), np.array([0.3]), np.array([[1e-12]]), 1),
        twin.plan_confirmation(
            drawn,
            twin.written_values(dmu50, drawn, compensated=True)[1],
            probe=True,
            sizes=twin.InstrumentSizes(TOOL_MM),
        ),
        twin.confirm(readings, readings, dmu50),
        PartForecast("plate", "plate.nc", "DMU 50", (), {}, "", "", 1000, (), ()),
    ]
    return {type(one).__name__: one for one in made}


@pytest.mark.parametrize("name", sorted(set(returned()) - COMPUTING))
def test_every_result_is_one_short_line(name: str, results: Mapping[str, Any]) -> None:
    """Text of one line from one place, and HTML from one renderer."""
    one = results[name]
    for text in (str(one), repr(one)):
        assert 20 < len(text) < 300 and "\n" not in text and "array(" not in text, text
    assert type(one).__str__ is Result.__str__ and type(one).__repr__ is Result.__repr__
    assert getattr(type(one), "_repr_html_", None) is (DisplayedResult._repr_html_ if name in DISPLAYED else None)


def test_empty_and_unknown_results_have_a_line(dmu50: Machine, drawn: Calibration, executed: Execution) -> None:
    real, none = Kinematics(dmu50, drawn), np.zeros((0, 5))
    tool, poses = ToolUncertainty(real), real.forward(none)
    empty = UncertaintyMap(dmu50.names, none, tool.at(none))
    nothing = {
        one.name: getattr(executed, one.name)[:0] for one in fields(executed) if one.name not in ("left_out", "unknown")
    }
    lines = [str(one) for one in (poses, Inverse(real).solve(poses, none), empty, replace(executed, **nothing))]
    assert lines == [
        "no poses",
        "commands for 0 poses",
        "U of the tool point at 0 poses",
        "no point within the axis ranges",
    ]
    assert str(tool.over_volume(50)) == "U of the tool point at 50 poses: unknown"


def test_a_long_line_is_cut(found: Identification, readings: Measurements) -> None:
    long = str(replace(readings, source="a/long/path/" * 40))
    assert (
        len(long) == LONGEST
        and long.startswith("210 readings of 6 targets from 1 station, a/long/path/")
        and long[-1] == "…"
    )


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
