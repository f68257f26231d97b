"""Tests of the first page of a report: decision rule, wording, accessibility, length in print, PDF."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from html import unescape
from html.parser import HTMLParser
from itertools import pairwise
from math import isnan, nan
from pathlib import Path

import numpy as np
import pytest

from tests.browser import run_chromium
from tests.cli.commands import refused
from twin import cli
from twin._common.distributions import decide, is_accepted
from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.files import write_json
from twin.display.sheet import Job
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.numerics.covariance import Covariance
from twin.reporting.front import TOOL, FrontPage, earlier_report, front_page
from twin.reporting.page import machine_html, sheet_of
from twin.reporting.result import machine_report

MINE = """
schema: twin.calibration/1
machine: DMU 50 eVolution
source: by hand
curves:
  E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [0.0, 12.5], covariance: [[1.0, 0], [0, 1.0]]}
squareness: {E_C0Y: 60.0}

"""
TOLERANCES = {"E_XX": 5.0, "E_YY": 3.0, "tool": 1000.0}
COLOURS = (
    "#1b1b1b #e3f1fb",
    "#1b1b1b #fbe4d4",
    "#1b1b1b #f0f0f0",
    "#ffffff #1b1b1b",
    "#444444 #ffffff",
    "#555555 #f0f0f0",
)


@pytest.fixture(scope="module")
def pages(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    path = tmp_path_factory.mktemp("front") / "mine.yaml"
    path.write_text(MINE)
    report = machine_report(dmu50, Calibration.load(path, dmu50), made=datetime(2026, 1, 2, tzinfo=UTC))
    front = front_page(report, dict.fromkeys(dmu50.motion_names, 4.0) | TOLERANCES)
    verdicts = {item.name: item.verdict for item in front.judged}
    assert [verdicts[name] for name in TOLERANCES] == ["fail", "undecided", "undecided"]
    assert {item.name for item in front.not_accepted} >= {"E_XX", "E_YY"} and front.items[0] not in front.not_accepted
    assert front.verdict == "fail"
    job = Job(operator="A <b>")
    return {one.value: machine_html(report, front, sheet_of(report, job, one)) for one in Language}


def first(page: str) -> str:
    """Return the text of the first page and of the tables in its language."""
    (body,) = re.findall(r"<section class=front.*?</section>(?=\s*<div class=details)", page, re.S)
    return unescape(re.sub(r"<[^>]+>", " ", body))


@pytest.mark.parametrize(
    ("value", "half", "tolerance", "verdict"),
    [
        (8.0, 2.0, 10.0, "pass"),
        (8.0, 2.1, 10.0, "undecided"),
        (12.0, 2.0, 10.0, "undecided"),
        (12.1, 2.0, 10.0, "fail"),
        (1.0, nan, 10.0, "undecided"),
        (nan, 1.0, 10.0, "undecided"),
    ],
)
def test_decision_rule(value: float, half: float, tolerance: float, verdict: str) -> None:
    """ISO 14253-1: conformance up to tolerance − U, non-conformance beyond tolerance + U."""
    assert decide(value, half, tolerance) == verdict


@pytest.mark.parametrize(
    ("value", "half", "accepted"), [(8, 2, 1), (9, 2, 1), (12, 3, 0), (13, 2, 0), (11, nan, 0), (nan, nan, 0)]
)
def test_exit_status_follows_from_value_and_verdict(value: float, half: float, accepted: int) -> None:
    """A value beyond the tolerance of 10 or an unknown one is not accepted, whatever its U."""
    assert is_accepted(decide(value, half, 10.0), value, 10.0) is bool(accepted)


def judged(dmu50: Machine, folder: Path, text: str, **tolerances: float) -> FrontPage:
    path = folder / "c.yaml"
    path.write_text(text)
    report = machine_report(dmu50, Calibration.load(path, dmu50), made=datetime(2026, 1, 2, tzinfo=UTC))
    return front_page(report, tolerances=tolerances)


def test_error_after_compensation_is_that_of_the_appendix(dmu50: Machine, tmp_path: Path) -> None:
    """Every figure of the tool point on the first page is one of the section on compensation, and contains U.

    E_XX is known with u = 1 µm for the mean and the slope: compensated, only rounding and that uncertainty remain, so that the largest
    error is of the order of some standard uncertainties.
    """
    front = judged(dmu50, tmp_path, MINE.replace("squareness: {E_C0Y: 60.0}", ""), tool_after=50.0)
    report = machine_report(dmu50, Calibration.load(tmp_path / "c.yaml", dmu50), made=datetime(2026, 1, 2, tzinfo=UTC))
    levels = report.compensation.expected_before, report.compensation.judged
    for item, level in zip(front.items[: len(TOOL)], levels, strict=True):
        assert level is not None
        assert (item.value, item.rms, item.quantile_95) == (level.max_um, level.rms_um, level.quantile(0.95))
    before, after = front.items[: len(TOOL)]
    assert after.rms is not None and after.quantile_95 is not None
    assert after.rms < after.quantile_95 and 0.8 < after.value < before.value and 0.5 < after.half < 4.0
    machines = report.to_dict()["compensation"]["machines"]
    largest = machines["compensated_largest"]
    assert largest["low_um"] < after.value == largest["mean_um"] < largest["high_um"]
    assert report.to_dict()["compensation"]["compensated"]["max_um"] == after.value


def test_one_figure_before_compensation(dmu50: Machine, tmp_path: Path) -> None:
    """Headline, tables, kinematics and programs start at the expected error of the first page, which is not that of the model.

    Judge: with a standard uncertainty of 20 µm of the mean of E_XX, the variance of the tool point is 400 µm² larger at every pose.
    """
    text = (
        MINE.replace("covariance: [[1.0, 0], [0, 1.0]]", "covariance: [[400.0, 0], [0, 0]]")
        + "location: {E_A0C: 90.0}\n"
    )
    (tmp_path / "c.yaml").write_text(text)
    report = machine_report(dmu50, Calibration.load(tmp_path / "c.yaml", dmu50), made=datetime(2026, 1, 2, tzinfo=UTC))
    model, shown = report.compensation.before.rms_um, report.compensation.start.rms_um
    assert shown == pytest.approx(np.hypot(model, 20.0), rel=0.05) and shown > model + 2.0
    assert front_page(report).items[0].rms == shown
    texts = " ".join([report.advice.headline, *(step.text for step in report.advice.steps)])
    figures = re.findall(
        r"point is ([\d.]+) µm|tool: ([\d.]+) µm without|mode: ([\d.]+) µm before|from ([\d.]+) µm", texts
    )
    found = ["".join(one) for one in figures]
    assert len(found) >= 3 and {*found} == {f"{shown:.3g}"}


def test_a_failure_beyond_an_incomplete_uncertainty_is_a_failure(dmu50: Machine, tmp_path: Path) -> None:
    """U is a lower bound as errors are absent: value − U > tolerance fails with the reason beside it, nothing passes."""
    front = judged(dmu50, tmp_path, MINE, tool=2.0, E_XX=2.0)
    assert front.items[0].name == "tool" and front.items[0].value - front.items[0].half > 2.0
    assert (front.items[0].verdict, front.items[0].reason) == ("fail", "incomplete")
    assert judged(dmu50, tmp_path, MINE, tool=1e4).items[0].verdict == "undecided"


@pytest.mark.sample(2)  # of 4
@pytest.mark.parametrize(
    ("tolerances", "status", "words"),
    [
        (("E_XX=2",), 3, "not met: FAIL E_XX"),
        (("E_XX=50",), 0, "PASS"),
        (("E_ZZ=50",), 3, "not met: UNDECIDED E_ZZ: unknown"),
        (("E_XX=50", "tool=2"), 3, "not met: FAIL tool"),
    ],
)
def test_command_says_the_verdict_and_leaves_by_it(
    without_pictures: None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    tolerances: tuple[str, ...],
    status: int,
    words: str,
) -> None:
    calibration = tmp_path / "c.yaml"
    calibration.write_text(MINE)
    with pytest.raises(SystemExit) as ended:
        cli.main(["report", "-c", str(calibration), "-o", str(tmp_path / "r.html"), "--tolerance", *tolerances])
    shown, _ = capsys.readouterr()
    assert ended.value.code == status and words in shown and "tolerances (ISO 14253-1)" in shown


def test_both_languages_have_the_same_numbers_and_no_foreign_words(pages: dict[str, str]) -> None:
    english, german = first(pages["en"]), first(pages["de"])
    dates = r"02 January 2026|02\.01\.2026"
    numbers = [re.findall(r"\d+(?:[.,]\d+)?", re.sub(dates, "", text)) for text in (english, german)]
    assert sorted(numbers[0]) == sorted(number.replace(",", ".") for number in numbers[1])
    assert not re.search(r"\b(the|of|and|is|not|error|axis|with|unknown|before|after|pass|fail)\b", german)
    assert "nicht bestanden" in german and "Positionierabweichung X" in german


def test_accessible(pages: dict[str, str]) -> None:
    """Every figure has a text alternative, every header a scope, headings skip no level, and the language is named."""
    problems: list[str] = []
    levels: list[int] = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            given = dict(attrs)
            if (tag == "img" and not given.get("alt")) or (tag == "th" and not given.get("scope")):
                problems.append(f"{tag} {str(given)[:80]}")
            if tag == "html":
                assert given["lang"] == "de"
            if re.fullmatch(r"h\d", tag):
                levels.append(int(tag[1]))

    Reader().feed(pages["de"])
    assert problems == []
    assert levels[0] == 1 and all(b <= a + 1 for a, b in pairwise(levels))
    assert "A &lt;b&gt;" in pages["de"]


def test_an_empty_calibration_is_unknown() -> None:
    """Without errors the error of the tool point is unknown, before and after compensation, and nothing passes."""
    trunnion = Machine.load("trunnion_ac.yaml")
    report = machine_report(trunnion, Calibration.default(trunnion), made=datetime(2026, 1, 2, tzinfo=UTC))
    front = front_page(report, tolerances={"tool": 1e6, "tool_after": 1e6})
    assert [(isnan(item.value), item.verdict) for item in front.items] == [(True, "undecided")] * 2


@pytest.mark.parametrize("pair", COLOURS)
def test_contrast(pair: str, pages: dict[str, str]) -> None:
    """Contrast of text by WCAG 2.1, at least 4.5."""

    def luminance(colour: str) -> float:
        parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    style = (
        pages["de"]
        .replace("#fff}", "#ffffff}")
        .replace("#fff;", "#ffffff;")
        .replace("#444}", "#444444}")
        .replace("#555;", "#555555;")
    )
    assert all(colour in style for colour in pair.split()), "the page uses these colours"
    dark, light = sorted(map(luminance, pair.split()))
    assert (light + 0.05) / (dark + 0.05) >= 4.5


@pytest.mark.parametrize("language", ["en", "de"])
def test_the_first_page_is_one_sheet(pages: dict[str, str], language: str, tmp_path: Path) -> None:
    """Printed without the appendix, the first page is one page of A4."""
    page = pages[language]
    start, end = page.index("<div class=details"), page.index("</body>")
    path, pdf = tmp_path / "front.html", tmp_path / "front.pdf"
    path.write_text(page[:start].replace("break-after:page", "") + page[end:], encoding="utf-8")
    run_chromium(path.as_uri(), f"--print-to-pdf={pdf}", "--no-pdf-header-footer")
    assert len(re.findall(rb"/Type\s*/Page\b", pdf.read_bytes())) == 1


def test_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    out, logo, job = tmp_path / "r.html", tmp_path / "logo.png", tmp_path / "job.yaml"
    logo.write_text("no picture")
    job.write_text("schema: twin.job/1\noperater: A\n")
    assert "a PNG or an SVG picture" in refused(capsys, "report", "-o", out, "--logo", logo)
    assert "operator" in refused(capsys, "report", "-o", out, "--job", job)
    assert "report_number" in refused(capsys, "report", "-o", out, "--job", tmp_path / "none.yaml")
    assert "unknown item" in refused(capsys, "report", "-o", out, "--tolerance", "E_QQ=3")
    monkeypatch.setenv("TWIN_BROWSER", str(tmp_path / "absent"))
    assert "TWIN_BROWSER" in refused(capsys, "report", "-o", out, "--pdf", tmp_path / "r.pdf")
    monkeypatch.delenv("TWIN_BROWSER")
    monkeypatch.setattr("twin.display.sheet.shutil.which", lambda name: None)
    assert "Chromium" in refused(capsys, "report", "-o", out, "--pdf", tmp_path / "r.pdf")
    assert not out.exists() and not (tmp_path / "r.pdf").exists()


def test_the_control_s_own_names_and_differences(dmu50: Machine, tmp_path: Path) -> None:
    """The second axis of SINUMERIK's transformation turns with a tilted first one by the sine of the tilt, known with its u.

    On the DMU 50 a tilt of B about x turns the axis (0, 1, −1)/√2 by 165 µrad: its components change by 165/√2 · 1e-6.
    """
    covariance = Covariance(("E_A0B", "E_X0C"), np.diag([25.0, 4.0]))
    located = {"E_A0B": 165.0, "E_X0C": 12.0}
    calibration = replace(Calibration.zero(dmu50), location=located, joint=covariance)
    made = datetime(2026, 1, 2, tzinfo=UTC)
    report = machine_report(dmu50, calibration, made=made, kinematics="siemens-trafo5")
    held = report.kinematics_of_control
    assert held is not None
    change = {held.form.label(name, dmu50): should - held.present[name] for name, should in held.values.items()}
    assert {"MD24550[1]", "MD24560[0]", "MD24500[2]", "MD24570[1]", "MD24572[0]"} <= {*change}
    for name in ("MD24570[1]", "MD24570[2]"):
        assert abs(change[name]) == pytest.approx(165e-6 / 2**0.5, rel=0.01)
    assert held.u["AXIS1[1]"] == pytest.approx(5e-6 / 2**0.5, rel=0.01)
    steps = [step.title for step in report.advice.steps]
    assert "Enter the location of the rotary axes in the control's kinematics" in steps
    # The control already holds the new values: nothing remains to be entered.
    file = tmp_path / held.form.file
    file.write_text(held.text)
    again = machine_report(
        dmu50, calibration, made=made, kinematics="siemens-trafo5", present=file
    ).kinematics_of_control
    assert again is not None
    assert max(abs(value - again.present[name]) for name, value in again.values.items()) < 2e-6
    file.write_text(held.text.replace("BASE_TOOL_1[0]=250", "BASE_TOOL_1[0]=270"))
    with pytest.raises(InputError, match="counted from other points"):
        machine_report(dmu50, calibration, made=made, kinematics="siemens-trafo5", present=file)


def test_history_is_of_the_same_machine(dmu50: Machine, tmp_path: Path) -> None:
    path, earlier = tmp_path / "c.yaml", tmp_path / "r.json"
    path.write_text(MINE)
    report = machine_report(dmu50, Calibration.load(path, dmu50), made=datetime(2026, 1, 2, tzinfo=UTC))
    first = front_page(report)
    write_json(earlier, report.to_dict() | {"first_page": first.to_dict()})
    point = earlier_report(earlier, dmu50)
    front = front_page(report, history=[replace(point, made=datetime(2025, 1, 2, tzinfo=UTC), value=90.0)])
    assert [one.value for one in front.history] == [90.0, first.items[0].value] and point.value == first.items[0].value
    assert "<svg class=trend" in machine_html(report, front) and "<svg class=trend" not in machine_html(report, first)
    with pytest.raises(InputError, match="another machine"):
        earlier_report(earlier, Machine.load("trunnion_ac"))
    earlier.write_text("[]")
    with pytest.raises(InputError, match="not an earlier report"):
        earlier_report(earlier, dmu50)


def test_every_page_that_is_handed_over_has_the_same_sheet(
    without_pictures: None, dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Number, facts and sources stand on the pages of `evaluate` and `compare` as on that of `report`; the terminal follows --lang."""
    job, older, newer, table = (tmp_path / name for name in ("job.yaml", "a.yaml", "b.yaml", "m.csv"))
    job.write_text("schema: twin.job/1\nreport_number: 2026-117/1\noperator: A. Weber\n")
    older.write_text(MINE)
    newer.write_text(MINE.replace("60.0", "90.0"))
    rows = [f"{x},225,-200,0,0,K,tool,{x},0,0,{way},{n}" for n in (1, 2) for way in (1, -1) for x in (0, 100, 200, 300)]
    table.write_text(
        "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,approach_X,round\n" + "\n".join(rows) + "\n"
    )
    more = ["--job", str(job), "--lang", "de", "--html"]
    for words, said in (
        (["evaluate", str(table), "--instrument", "tracker"], "Normprüfungen"),
        (["compare", str(older), str(newer)], "geschrieben:"),
    ):
        out = tmp_path / f"{words[0]}.html"
        with pytest.raises(SystemExit):
            cli.main([*words, *more, str(out)])
        page = out.read_text()
        assert said in capsys.readouterr().out
        assert "Protokoll Nr. 2026-117/1" in page and "A. Weber" in page and "Unterschrift" in page
        digest = sha256(Path(words[1]).read_bytes()).hexdigest()
        assert digest in page and 'content:"2026-117/1"' in page and "<html lang=de>" in page
    job.write_text('schema: twin.job/1\nreport_number: a"b\n')
    assert "report_number" in refused(capsys, "evaluate", table, "--job", job, "--html", tmp_path / "x.html")
