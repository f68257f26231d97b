"""Tests of `twin report`: numbers by independent computation, the page in a parser and in a browser, error messages."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
import sys
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.browser import title_of
from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin import cli
from twin._common.errors import InputError
from twin.display import UNKNOWN, figure
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.reporting.compensation import compare_points
from twin.reporting.page import machine_html
from twin.reporting.result import MachineReport, machine_report
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty

MADE = datetime(2026, 1, 2, 3, 4, tzinfo=UTC)
TOOL_MM = 100.0
SQUARE_URAD, BACKLASH_UM, PERIOD_MM = 60.0, 6.0, 10.0
MINE = f"""
schema: twin.calibration/1
machine: DMU 50 eVolution
source: by hand
curves:
  E_XX: {{unit: um, domain: [0, 500], basis: power, coefficients: [3.0, 9.0, -4.0],
         covariance: [[1.0, 0.2, 0], [0.2, 2.0, 0], [0, 0, 0.5]]}}
  E_CX: {{unit: urad, domain: [0, 500], basis: power, coefficients: [0, 40.0], covariance: [[4.0, 0], [0, 9.0]]}}
  E_ZC: {{unit: um, domain: [0, 360], basis: fourier, coefficients: [0, 5.0, 2.0]}}
squareness: {{E_C0Y: {SQUARE_URAD}}}
effects:
  - {{effect: reversal, where: Y, parameters: {{size: {BACKLASH_UM}}}}}
  - {{effect: pitch_error, where: X, parameters: {{amplitude: 2.0, period: {PERIOD_MM}, phase: 0.3}}}}
  - {{effect: thermal_expansion, where: Z, parameters: {{coefficient: 11.0}}}}
"""
IDENTIFIED: dict[str, Any] = {
    "schema": "twin.identification/1",
    "machine": "DMU 50 eVolution",
    "data": "table.csv",
    "points": {"used": 321, "set_aside": 1},
    "uncertainty": "stated",
    "errors": [{"name": "E_C0Y", "unit": "urad", "value": SQUARE_URAD, "u": 1.0}],
    "not_identifiable": [{"name": "E_X0B", "reason": "it <moves> with the reflectors"}],
    "misfit": {"rms_um": 2.5, "reduced_chi2": 1.75, "dof": 900.0, "p_value": 1e-9, "lack_of_fit_p_value": 1e-7},
    "set_aside": [{"line": 17, "reason": "an outlier"}],
    "notices": ["the file says: simulated by a script"],
    "converged": True,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("machine report")
    (made / "mine.yaml").write_text(MINE)
    (made / "identified.json").write_text(json.dumps(IDENTIFIED))
    return made


@pytest.fixture(scope="module")
def mine(dmu50: Machine, folder: Path) -> Calibration:
    return Calibration.load(folder / "mine.yaml", dmu50)


@pytest.fixture(scope="module")
def report(dmu50: Machine, mine: Calibration, folder: Path) -> MachineReport:
    warm = Conditions({"Z": 24.0})
    return machine_report(
        dmu50, mine, made=MADE, tool_length_mm=TOOL_MM, conditions=warm, identified=folder / "identified.json"
    )


@pytest.fixture(scope="module")
def contents(report: MachineReport) -> dict[str, Any]:
    return dict(json.loads(json.dumps(report.to_dict(), allow_nan=False)))


@pytest.fixture(scope="module")
def page(report: MachineReport) -> str:
    return machine_html(report)


@pytest.fixture(scope="module")
def drawn(dmu50: Machine, calibration: Calibration) -> MachineReport:
    """Return the report of the illustrative calibration, which has no covariance."""
    return machine_report(dmu50, calibration, made=MADE)


class Reader(HTMLParser):
    """Parser that collects tags, table cells and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[list[str]] = []
        self.text = ""
        self._skip = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._skip = tag in ("style", "script")
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self._skip = False
        if tag == "table":
            self.rows.append([])

    def handle_data(self, data: str) -> None:
        if self._skip:
            return
        self.text += data
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data


def error_of(contents: dict[str, Any], name: str) -> dict[str, Any]:
    return next(dict(one) for one in contents["budget"]["errors"] if one["name"] == name)


def test_squareness_at_the_tool_is_angle_times_travel(contents: dict[str, Any], report: MachineReport) -> None:
    """E_XY −= y·E_C0Y is the error at the tool at any position of the rotary axes."""
    y = report.budget.positions[:, 1]
    found = error_of(contents, "E_C0Y")
    assert found["rms_um"] == pytest.approx(1e-3 * SQUARE_URAD * np.sqrt(np.mean(y**2)), rel=1e-6)
    assert found["max_um"] == pytest.approx(1e-3 * SQUARE_URAD * y.max(), rel=1e-6)
    assert found["U_rms_um"] is None and found["peak_half_95"] is None
    (one,) = contents["constants"]
    assert one["over_travel_um"] == pytest.approx(SQUARE_URAD * 0.45)


def test_uncertainty_of_one_error_at_the_tool(contents: dict[str, Any], report: MachineReport) -> None:
    """U of a positioning error alone is 1.96 standard uncertainties of its polynomial."""
    u = 2.0 * report.budget.positions[:, 0] / 500.0 - 1.0
    f = np.stack([np.ones_like(u), u, u**2])
    covariance = np.array([[1.0, 0.2, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 0.5]])
    variance = np.einsum("kn,kl,ln->n", f, covariance, f)
    # The radius is within 4e-5 of the quantile (twin.tool.uncertainty); rotations by other errors do not change a length.
    assert error_of(contents, "E_XX")["U_rms_um"] == pytest.approx(COVERAGE_FACTOR * np.sqrt(variance.mean()), rel=2e-4)
    assert error_of(contents, "E_XX")["peak_half_95"] == pytest.approx(
        COVERAGE_FACTOR * np.sqrt(max(_variance(1.0), _variance(-1.0)))
    )


def _variance(u: float) -> float:
    """Return the variance of E_XX of `MINE` at one end of X."""
    f, covariance = np.array([1.0, u, 1.0]), np.array([[1.0, 0.2, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 0.5]])
    return float(f @ covariance @ f)


def test_total_equals_machine_with_all_errors(
    contents: dict[str, Any], report: MachineReport, mine: Calibration
) -> None:
    real = Kinematics(mine.machine, mine, tool_length_mm=TOOL_MM, conditions=Conditions({"Z": 24.0}))
    none = Kinematics(mine.machine, Calibration.zero(mine.machine), tool_length_mm=TOOL_MM)
    q, sides = report.budget.positions, report.budget.sides
    off = np.linalg.norm(real.forward(q, sides).point_mm - none.forward(q).point_mm, axis=1) * 1e3
    assert contents["budget"]["total"]["rms_um"] == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-12)
    assert contents["compensation"]["before"]["max_um"] == pytest.approx(off.max(), rel=1e-12)
    at = np.array(contents["field"]["positions"])
    error = (real.forward(at).point_mm - none.forward(at).point_mm) * 1e3
    np.testing.assert_allclose(contents["field"]["error_um"], error, atol=1e-9)
    uncertainty = ToolUncertainty(real).at(at).expanded_um
    np.testing.assert_allclose(contents["field"]["U_um"], uncertainty, rtol=1e-12)


def test_planes_have_the_errors_of_their_positions(contents: dict[str, Any], report: MachineReport) -> None:
    real, none = report.kinematics, Kinematics(report.machine, Calibration.zero(report.machine), tool_length_mm=TOOL_MM)
    assert len(contents["field"]["slices"]) == 9
    for plane in contents["field"]["slices"]:
        i, k = 3, 7
        where = plane["fixed"] | {plane["horizontal"]: plane["across"][i], plane["vertical"]: plane["up"][k]}
        q = [[where.get(name, 0.0) for name in report.machine.names]]
        off = np.linalg.norm(real.forward(q).point_mm - none.forward(q).point_mm) * 1e3
        assert plane["error_um"][k][i] == pytest.approx(off, rel=1e-9)


def test_curves_include_added_effects(report: MachineReport) -> None:
    by_name = {motion.name: motion for motion in report.motions}
    assert set(by_name) == {"E_XX", "E_YY", "E_ZZ", "E_CX", "E_ZC"}
    along = by_name["E_XX"]
    u = 2.0 * along.position / 500.0 - 1.0
    expected = 3.0 + 9.0 * u - 4.0 * u**2 + 2.0 * np.sin(2.0 * np.pi * along.position / PERIOD_MM + 0.3)
    np.testing.assert_allclose(along.value, expected, atol=1e-9)
    assert np.diff(along.position).max() <= PERIOD_MM / 12.0
    # One parameter has no uncertainty, so the band is unknown.
    assert np.all(np.isnan(along.half)) and along.added == ("pitch_error:X",)
    ways = by_name["E_YY"].ways
    assert ways is not None
    np.testing.assert_allclose(ways[0] - ways[1], BACKLASH_UM)
    np.testing.assert_allclose(by_name["E_ZZ"].value, 11.0 * 4.0 * by_name["E_ZZ"].position * 1e-3, atol=1e-12)
    np.testing.assert_allclose(by_name["E_CX"].half.max(), COVERAGE_FACTOR * np.sqrt(13.0), rtol=1e-9)


def test_compensated_error_is_rounding_plus_uncertainty(contents: dict[str, Any], report: MachineReport) -> None:
    after = contents["compensation"]
    exact = after["compensated_if_exactly_true"]
    # Three words, each with a uniform error within ±0.5 µm: the median of 2,000 poses within 3 %, two standard errors.
    assert exact["quantiles_um"]["0.99"] <= 0.5 * np.sqrt(3.0) + 1e-3
    rounded = np.linalg.norm(np.random.default_rng(1).uniform(-0.5, 0.5, (100_000, 3)), axis=1)
    assert exact["quantiles_um"]["0.5"] == pytest.approx(np.median(rounded), rel=0.03)
    real, q, sides = report.kinematics, report.budget.positions, report.budget.sides
    covariance = ToolUncertainty(real).at(q, sides).covariance[:, :3, :3]
    expected = after["compensated_if_exactly_true"]["rms_um"] ** 2 + np.trace(covariance, axis1=1, axis2=2).mean()
    # 16,000 draws of three numbers: mean square within 2 %, three standard errors.
    assert after["compensated"]["rms_um"] ** 2 == pytest.approx(expected, rel=0.02)
    assert after["compensated_complete"] is False


def test_page_has_the_numbers_of_the_json(page: str, contents: dict[str, Any]) -> None:
    rows = Reader(page).rows
    for one in contents["budget"]["errors"]:
        (row,) = [row for row in rows if len(row) == 7 and row[1] == one["name"]]
        assert row[4:6] == [figure(one["rms_um"]), figure(one["max_um"])]
        assert row[6].strip() == (UNKNOWN if one["U_rms_um"] is None else figure(one["U_rms_um"]))
    text = Reader(page).text.replace("\u00a0", " ")
    for step in contents["summary"]["steps"]:
        assert step["title"] in text
    assert (
        "reduced chi² 1.750" in text
        and "E_X0B: it <moves> with the reflectors" in text
        and "line 17: an outlier" in text
    )
    assert "SIMULATED READINGS" in text and "ILLUSTRATIVE" not in text
    assert "E_YX" in " ".join(contents["gaps"]["absent_counted_as_zero"]) and "E_YX" in text
    for one in contents["sources"]["files"]:
        assert one["sha256"] in text


def test_every_header_has_the_unit_of_its_numbers(page: str) -> None:
    """Headers with a unit give the unit of their cells, whose values `test_page_has_the_numbers_of_the_json` checks."""
    heads = [html.unescape(re.sub("<[^>]+>", "|", head)) for head in re.findall(r"<thead>.*?</thead>", page, re.S)]
    with_units = [[cell for cell in head.split("|") if "[" in cell] for head in heads if "[" in head]
    at_tool = ["at the tool, RMS [µm]", "largest [µm]", "U [µm]"]
    tables = ["RMS by the model [µm]", "RMS with uncertainty [µm]", "largest by the model [µm]"]
    assert with_units == [at_tool, at_tool, ["RMS [µm]"], tables, at_tool[:1]]


def test_identification_of_another_calibration_and_lack_of_fit(contents: dict[str, Any]) -> None:
    """The identification has one number of this calibration, and a lack of fit."""
    others = contents["identification"]["other_numbers_than_the_calibration"]
    assert others == ["E_XX", "E_CX", "E_ZC"]
    titles = [step["title"] for step in contents["summary"]["steps"]]
    assert (
        "The identification belongs to another calibration" in titles and "Find the cause of the lack of fit" in titles
    )
    assert any("identified.json and the calibration differ" in text for text in contents["unmet"])


def unpacked(page: str) -> str:
    """Return the page in the frame of a report, which unpacks itself in the browser."""
    packed = re.search(r'atob\("([^"]*)"\)', html.unescape(page))
    assert packed is not None
    return gzip.decompress(base64.b64decode(packed[1])).decode()


def test_the_page_fetches_nothing(page: str) -> None:
    """Neither the page nor its frame contains an address to load, and both forbid loading."""
    frames = [str(tag["srcdoc"]) for name, tag in Reader(page).tags if name == "iframe"]
    assert len(frames) == 1
    viewer = unpacked(page)
    for text in (page, *frames, viewer):
        tags = Reader(text).tags
        for _, tag in tags:
            for key in ("src", "href", "data", "srcset", "action", "poster"):
                assert (tag.get(key) or "data:").startswith("data:")
        policy = [
            tag["content"]
            for name, tag in tags
            if name == "meta" and tag.get("http-equiv") == "Content-Security-Policy"
        ]
        assert len(policy) == 1 and str(policy[0]).startswith("default-src 'none'")
    assert not re.search(r"@import|url\(\s*['\"]?http", page)
    assert viewer.count("<script>") == 2
    assert len(page) < 2_000_000


def test_unknown_is_never_zero(drawn: MachineReport, calibration: Calibration) -> None:
    contents = drawn.to_dict()
    assert all(one["U_rms_um"] is None and one["peak_half_95"] is None for one in contents["budget"]["errors"])
    assert contents["budget"]["total"]["U_rms_um"] is None and contents["compensation"]["compensated"] is None
    assert set(contents["field"]["U_um"]) == {None} and contents["compensation"]["machines"] is None
    assert {half for one in contents["motions"] for half in one["half_95"]} == {None}
    assert set(contents["gaps"]["without_uncertainty"]) == {
        *calibration.curves,
        *calibration.squareness,
        *calibration.location,
    }
    assert contents["calibration"]["illustrative"] == [c.name for c in calibration.curves.values() if c.illustrative]
    said = [step["text"] for step in contents["summary"]["steps"]]
    assert any("U at the tool is unknown" in text for text in said)
    assert any("The expected error is unknown" in text for text in said)
    assert any(step["kind"] == "never" and "ILLUSTRATIVE" in step["text"] for step in contents["summary"]["steps"])
    # At tool length zero, tilts about the tool centre have no effect; the report states this.
    assert any("At tool length 0 mm" in text and "E_AZ" in text for text in said)


def test_calibration_without_errors(dmu50: Machine) -> None:
    """A calibration without errors is not reported as an accurate machine."""
    one = machine_report(dmu50, Calibration.zero(dmu50), made=MADE)
    assert one.advice.rating == "unknown" and "contains no errors" in one.advice.headline
    assert len(one.gaps.absent) == len((*dmu50.motion_names, *dmu50.squareness_names, *dmu50.location_names))
    text = machine_html(one)
    assert "contains no errors" in text and "<iframe" not in text


def test_a_calibration_worse_than_none_is_not_recommended(dmu50: Machine, tmp_path: Path) -> None:
    """An error of 5 µm that is known to 100 µm: compensating with it would enlarge the expected error."""
    curve = "{unit: um, domain: [0, 500], basis: power, coefficients: [0, 5.0], covariance: [[0, 0], [0, 1.0e+4]]}"
    path = tmp_path / "c.yaml"
    path.write_text(
        f"schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\ncurves: {{E_XX: {curve}}}\n"
    )
    one = machine_report(dmu50, Calibration.load(path, dmu50), made=MADE)
    assert not any(step.kind == "do" for step in one.advice.steps)
    assert any(step.kind == "never" and "uncertainty is too large" in step.text for step in one.advice.steps)


def test_another_machine(folder: Path) -> None:
    """An A axis, with the z of its frame along x, is named by its motion on a machine unknown to the code."""
    machine = Machine.load("trunnion_ac")
    path = folder / "ac.yaml"
    path.write_text(
        "schema: twin.calibration/1\nmachine: trunnion AC\nsource: by hand\ncurves:\n"
        "  E_AA: {unit: urad, domain: [-120, 30], basis: power, coefficients: [10, 20], covariance: [[1, 0], [0, 1]]}\n"
        "squareness: {E_A0Z: -40.0}\n"
    )
    one = machine_report(machine, Calibration.load(path, machine), made=MADE)
    by_name = {error.name: error for error in one.budget.errors}
    assert by_name["E_AA"].iso_class == "R-POS" and by_name["E_AA"].words == "Angular positioning of A"
    square = one.constants[0]
    assert (square.axis, square.to) == ("Z", "Y")


def test_estimates_show_backlash_missing_in_the_calibration(
    dmu50: Machine, calibration: Calibration, folder: Path
) -> None:
    """Backlash hidden in readings of the truth machine, which shares no code, appears between both directions of approach."""
    rng = np.random.default_rng(3)
    plan = hidden.rounded(hidden.plan(rng, poses=10, stops=5, rounds=1))
    # So large that some readings are outliers, which are shown nevertheless.
    backlash = 14.0
    read = hidden.noisy(hidden.points(plan, [Hidden("reversal", "Y", {"size": backlash})]), rng, "isotropic", 1e-3)
    path = hidden.write(folder / "measured.csv", plan, read, u_mm=1e-3)
    found = compare_points(Measurements.load(path, dmu50), dmu50, calibration, path)
    below, above = found.stops["E_YY"]
    assert (below.side, above.side) == (1, -1)
    gap = np.mean(below.value - calibration.curves["E_YY"](below.position)) - np.mean(
        above.value - calibration.curves["E_YY"](above.position)
    )
    # The fit of stations and targets absorbs a part; each estimate is a mean of about twenty readings of 1 µm noise.
    assert gap == pytest.approx(backlash, abs=0.15 * backlash)
    assert found.points == len(read) and found.far > 0
    assert 1.0 < found.rms_after_um < 0.3 * found.rms_before_um


@given(st.floats(min_value=-1e6, max_value=1e6))
def test_figures_are_within_their_last_digit(value: float) -> None:
    """A figure has three digits and at most two decimals and is within half of its last digit; NaN is `UNKNOWN`."""
    text = figure(value).replace("−", "-")
    last = 10.0 ** -len(text.partition(".")[2])
    assert abs(float(text) - value) <= 0.5 * last * (1.0 + 1e-9)
    assert figure(float("nan"), "µm") == UNKNOWN


def run(*arguments: object) -> int:
    try:
        cli.main([str(argument) for argument in arguments])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_omitted_effect_gives_exit_status_3(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a temperature the effect is omitted and listed, and the exit status is 3."""
    page, json_path = folder / "cold.html", folder / "cold.json"
    # Rendering is slow and tested elsewhere.
    monkeypatch.setattr("twin.reporting.page.machine_html", lambda found, *_: found.advice.headline)
    assert run("report", "-o", page, "-c", folder / "mine.yaml", "--json", json_path) == 3
    assert "not met: thermal_expansion:Z omitted" in capsys.readouterr().out
    written = json.loads(json_path.read_text())
    assert written["gaps"]["left_out"] == {"T_Z_degC": ["thermal_expansion:Z"]}
    assert any(step["title"] == "thermal_expansion:Z omitted" for step in written["summary"]["steps"])
    assert page.read_text() == written["summary"]["headline"]


def test_bad_input(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    out = folder / "no.html"
    other = folder / "other.json"
    other.write_text(json.dumps(IDENTIFIED | {"machine": "another"}))
    broken = folder / "broken.json"
    broken.write_text("{")
    mine = folder / "mine.yaml"
    for arguments, said in (
        (("-o", mine, "-c", mine), "output file is also an input"),
        (("-o", out, "-c", mine, "--identified", other), "the identification belongs to another machine"),
        (("-o", out, "-c", mine, "--identified", broken), "not JSON"),
        (("-o", out, "-c", mine, "--identified", folder / "none.json"), "cannot be read"),
        (("-o", out, "-c", mine, "--temperature", "Q=20"), "neither an axis nor a sensor"),
        (("-o", folder / "none" / "no.html"), "cannot be written"),
    ):
        assert run("report", *arguments) == 2
        assert said in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # an import of it then raises ImportError
    assert run("report", "-o", out, "-c", mine) == 2
    assert "pip install" in capsys.readouterr().err
    assert not out.exists() and mine.read_text() == MINE


def test_a_seed_is_not_negative(folder: Path) -> None:
    assert run("report", "-o", folder / "no.html", "--seed", "-1") == 2


@pytest.mark.slow
@pytest.mark.parametrize("width", [pytest.param(1280, marks=pytest.mark.slow), 420])
def test_page_fits_the_screen(page: str, folder: Path, width: int) -> None:
    """In a browser, the page is not wider than the screen and the field is drawn in its frame."""
    expression = (
        "(f => [document.documentElement.scrollWidth, innerWidth, !!(f.viewer && f.viewer.scene_tree"
        ".find(['meshcat', 'machine', 'arrows']).object.children), f.document.querySelectorAll('.name').length]"
        ".join(' '))(document.querySelector('iframe').contentWindow)"
    )
    needed, available, arrows, names = title_of(page, folder / f"page {width}.html", expression, width=width).split()
    assert int(needed) <= int(available)
    assert arrows == "true" and names == "3"


def test_invalid_identification_file(folder: Path, mine: Calibration) -> None:
    from twin.reporting.identified import Identified

    path = folder / "wrong.json"
    path.write_text(json.dumps({key: value for key, value in IDENTIFIED.items() if key != "misfit"}))
    with pytest.raises(InputError, match="misfit"):
        Identified.load(path, mine)


def test_summary_lists_the_control_tables(dmu50: Machine, folder: Path) -> None:
    """For errors measured with the control's tables active, the summary lists the tables and states that the errors remain."""
    path = folder / "control.yaml"
    table = f"{{file: cec.mpf, format: siemens, classes: [L-POS], sha256: {'ab' * 32}}}"
    path.write_text(f"{MINE}control:\n  errors_are: remaining\n  tables: [{table}]\n")
    one = machine_report(dmu50, Calibration.load(path, dmu50), made=MADE)
    (step,) = [step for step in one.advice.steps if "control's tables active" in step.title]
    assert step.kind == "do" and "cec.mpf: L-POS" in step.text and "remain in addition" in step.text
    assert one.to_dict()["control"]["errors_are"] == "remaining"
    assert [source.sha256 for source in one.sources.files if "control" in source.role] == ["ab" * 32]
