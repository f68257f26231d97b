"""The output of `twin diagnose`: page, pictures and text.

Shapes are checked against the truth machine (`tests.truth.hidden`), which shares no code with `twin`; the page by a parser and a
browser.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from tests.browser import title_of
from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin._common.errors import InputError
from twin._common.provenance import ILLUSTRATIVE, SIMULATED, UNKNOWN_UNCERTAINTY
from twin.diagnosis import Diagnosis, diagnose
from twin.diagnosis.answer import WIDTH
from twin.diagnosis.candidates import SPECIFICATIONS, catalogue
from twin.diagnosis.page import diagnosis_html
from twin.diagnosis.plots import (
    cause_panels,
    plot_cause,
    plot_ranking,
    plot_residuals,
    plot_unexplained,
    residual_panels,
)
from twin.diagnosis.result import Unexplained
from twin.diagnosis.text import cause_title, chance, measured, odds, separating_points
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3
REVERSAL_UM = 12.0
SHIFT = {"shift_x": 9.0, "shift_y": -7.0, "shift_z": 4.0, "turn_x": 0.0, "turn_y": 0.0, "turn_z": 0.0}
HEADINGS = [
    "Expected residuals",
    "Residuals",
    "Causes tested",
    "Evidence",
    "Alternatives",
    "Gain with the causes in the model",
    "What to measure next",
    "Notes",
]
HIDDEN = {
    "reversal": [Hidden("reversal", "Y", {"size": REVERSAL_UM})],
    "two alike": [Hidden("cross_axis", "E_ZY by X", {"coefficient": 90.0})],
    "nothing": [],
    "re-aligned": [Hidden("frame_shift", "round 2", SHIFT)],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def found(dmu50: Machine, calibration: Calibration, folder: Path) -> Mapping[str, Diagnosis]:
    results = {}
    for name, effects in HIDDEN.items():
        rng = np.random.default_rng(1)
        plan = hidden.rounded(hidden.plan(rng, poses=30, stops=5, rounds=2))
        read = hidden.noisy(hidden.points(plan, effects), rng, "isotropic", SIGMA_MM)
        path = hidden.write(folder / f"{name}.csv", plan, read, u_mm=SIGMA_MM)
        results[name] = diagnose(Measurements.load(path, dmu50), dmu50, calibration)
    left = Unexplained(0.3, ("X_mm", "Z_mm"), "tool", "a pattern of no known effect", 2.0)
    results["part of it"] = replace(results["reversal"], verdict="unexplained", unexplained=left)
    return results


@pytest.fixture(scope="module")
def pages(found: Mapping[str, Diagnosis]) -> Mapping[str, str]:
    return {name: diagnosis_html(one) for name, one in found.items()}


class Reader(HTMLParser):
    """Parser of a page: tags with their attributes, text of the first screen, and headings."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.screen, self.headings = "", [""]
        self._depth, self._heading, self._symbol = 0, False, False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        if tag == "div":
            self._depth = self._depth + 1 if self._depth or attributes.get("class") == "verdict" else 0
        self._heading = tag == "h2"
        self._symbol = tag == "span" and attributes.get("class") == "symbol"

    def handle_endtag(self, tag: str) -> None:
        if tag == "div" and self._depth:
            self._depth -= 1
        if tag == "h2":
            self._heading = False
            self.headings.append("")
        if tag == "span":
            self._symbol = False

    def handle_data(self, data: str) -> None:
        if self._depth and not self._symbol:
            self.screen += data + " "
        if self._heading:
            self.headings[-1] += data


def test_the_page_is_one_file(pages: Mapping[str, str]) -> None:
    for page in pages.values():
        read = Reader(page)
        names = {tag for tag, _ in read.tags}
        assert not names & {"script", "link", "iframe", "object", "embed"}
        sources = [
            value
            for _, attributes in read.tags
            for name, value in attributes.items()
            if name in ("src", "href", "srcset")
        ]
        assert sources and all(str(value).startswith("data:image/svg+xml;base64,") for value in sources)
        plain_part = re.sub(r"base64,[A-Za-z0-9+/=]*", "", page)
        assert "http:" not in plain_part and "url(" not in plain_part and "@import" not in plain_part
        assert all(attributes.get("alt") for tag, attributes in read.tags if tag == "img")


def test_the_sections_are_in_order(pages: Mapping[str, str]) -> None:
    assert Reader(pages["reversal"]).headings[:-1] == HEADINGS
    left = Reader(pages["part of it"]).headings[:-1]
    assert left[:5] == HEADINGS[:5] and left[5] == "Unexplained residuals"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("reversal", ["The machine has an error", "Backlash of Y", "µm", "At the tool", "Service", "Caution"]),
        ("two alike", ["cannot decide which", "changes with", "Or instead", "Either can be used", "Order no repair"]),
        ("nothing", ["no error found", "present calibration", "that these readings can show"]),
        (
            "re-aligned",
            ["The measurement was disturbed", "re-aligned from round 2", "Do not compensate or repair the machine"],
        ),
        ("part of it", ["do not explain all", "30 %", "X and Z", "is not enough"]),
    ],
)
def test_the_first_screen_has_no_jargon(pages: Mapping[str, str], name: str, words: list[str]) -> None:
    screen = Reader(pages[name]).screen.replace("\u00a0", " ")
    assert [word for word in words if word not in screen] == []
    # No symbols without words, no jargon.
    assert re.findall(r"E_[A-Z0]|standard uncertaint|chi²|\bp =|_[a-z]", screen) == []
    assert len(screen.split()) < 160


def test_nothing_is_to_be_compensated_where_it_is_the_instrument(pages: Mapping[str, str]) -> None:
    assert "--extended" not in re.sub(r"<h2>What to measure.*", "", pages["re-aligned"], flags=re.S)
    assert "--extended better.yaml" in pages["reversal"]
    assert "--extended better.yaml" not in pages["part of it"]


def test_simulated_data_are_marked(
    found: Mapping[str, Diagnosis], pages: Mapping[str, str], folder: Path, dmu50: Machine
) -> None:
    assert "ILLUSTRATIVE" in pages["nothing"] and "SIMULATED" not in pages["nothing"]
    text = (folder / "nothing.csv").read_text()
    (folder / "marked.csv").write_text("# simulated by a program, seed 3\n" + text)
    data = Measurements.load(folder / "marked.csv", dmu50)
    assert data.notices == ("the file says: simulated by a program, seed 3",)
    assert "SIMULATED READINGS" in diagnosis_html(replace(found["nothing"], data=data))


def test_a_calibration_extended_from_simulated_readings_is_marked(
    found: Mapping[str, Diagnosis], folder: Path, dmu50: Machine, calibration: Calibration
) -> None:
    """The calibration that `--extended` writes keeps the warning of its readings; the diagnosis says it in text and JSON."""
    (folder / "lost.csv").write_text("# simulated by a program\n" + (folder / "reversal.csv").read_text())
    drawn = diagnose(Measurements.load(folder / "lost.csv", dmu50), dmu50, calibration)
    drawn.extended.save(folder / "extended.yaml")
    assert SIMULATED in Calibration.load(folder / "extended.yaml", dmu50).warnings
    assert SIMULATED.title in drawn.to_text()
    assert [one["name"] for one in drawn.to_dict()["warnings"]] == [
        one.name for one in (ILLUSTRATIVE, SIMULATED, UNKNOWN_UNCERTAINTY)
    ]
    # The marked readings differ from the unmarked ones by the mark only.
    measured = found["reversal"]
    assert not measured.extended.simulated and SIMULATED.title not in measured.to_text()
    assert [one.to_dict() for one in drawn.causes] == [one.to_dict() for one in measured.causes]


def test_the_same_diagnosis_is_the_same_page(found: Mapping[str, Diagnosis], pages: Mapping[str, str]) -> None:
    assert diagnosis_html(found["re-aligned"]) == pages["re-aligned"]


def test_names_are_escaped(found: Mapping[str, Diagnosis]) -> None:
    spiked = replace(found["nothing"], data=replace(found["nothing"].data, source="a<b>&.csv", notices=("<i>",)))
    page = diagnosis_html(spiked)
    assert "a&lt;b&gt;&amp;.csv" in page and "&lt;i&gt;" in page and "<i>" not in page


def test_every_axis_has_its_unit(found: Mapping[str, Diagnosis]) -> None:
    figures = [plot_unexplained(found["part of it"])]
    for one in found.values():
        figures += [plot_residuals(one), plot_residuals(one, after=True), plot_ranking(one)]
        figures += [plot_cause(one, k) for k in range(len(one.causes))]
    for figure in figures:
        assert figure is not None and figure.axes
        for axes in figure.axes:
            labels = [axes.get_xlabel(), axes.get_ylabel()]
            assert any(labels)
            for label in labels:
                assert not label or re.search(r"[^ ] \[[^\]]+\]$", label), label
                assert " / " not in label and "_deg" not in label and "_mm" not in label


def test_a_reversal_is_plotted_as_two_lines(found: Mapping[str, Diagnosis]) -> None:
    """Plus and minus half the reversal, to three standard errors of the mean of about 80 readings from one direction."""
    one = found["reversal"]
    (panel,) = cause_panels(one, one.causes[0])
    assert panel.y.endswith("[µm]") and [series.name for series in panel.series] == ["moving +", "moving −"]
    for series, side in zip(panel.series, (0.5, -0.5), strict=True):
        mean = np.average(series.y, weights=series.weight)
        assert (
            abs(mean - side * REVERSAL_UM)
            < 3.0 * 1e3 * SIGMA_MM / np.sqrt(len(series.y)) + 3.0 * one.causes[0].parameters[0].u
        )
        np.testing.assert_array_equal(np.sign(series.predicted), np.sign(side))


def test_shifts_are_plotted_in_the_directions_of_the_machine(found: Mapping[str, Diagnosis]) -> None:
    """The instrument's frame is turned by 1.6 rad about z in the truth machine; its shifts are plotted in the machine's x, y, z."""
    one = found["re-aligned"]
    (panel,) = cause_panels(one, one.causes[0])
    angle = hidden.STATIONS["1"][1][2]
    x, y, z = (SHIFT[f"shift_{a}"] for a in "xyz")
    truth = {
        "in x": np.cos(angle) * x - np.sin(angle) * y,
        "in y": np.sin(angle) * x + np.cos(angle) * y,
        "in z": z,
    }
    assert {series.name for series in panel.series} == set(truth)
    for series in panel.series:
        # 220 readings per round at 3 µm, and an unknown rotation: half a µm is 2.5 standard errors of the mean alone.
        assert np.mean(series.y[series.x == 1.0]) == pytest.approx(truth[series.name], abs=1.0)
        assert np.mean(series.y[series.x == 0.0]) == pytest.approx(0.0, abs=1.0)


def test_the_residuals_are_plotted_against_the_column_that_shows_them(found: Mapping[str, Diagnosis]) -> None:
    one = found["reversal"]
    first = residual_panels(one)[0]
    assert first.x.startswith("approach direction of Y") and "tool side" in first.title
    by_name = {series.name: series for series in first.series}
    gap = {
        name: abs(np.mean(series.y[series.x > 0]) - np.mean(series.y[series.x < 0])) for name, series in by_name.items()
    }
    assert gap["in y"] > 0.5 * REVERSAL_UM and max(gap["in x"], gap["in z"]) < 0.1 * REVERSAL_UM
    after = residual_panels(one, after=True)[0]
    assert after.limit == first.limit
    assert np.abs(np.mean(after.series[1].y[after.series[1].x > 0])) < 0.5


def test_tracker_readings_are_weighted_by_direction(dmu50: Machine, calibration: Calibration, folder: Path) -> None:
    """Noise is 13 µm across the beam and half a µm along it: a plot with equal weights would be twenty times as noisy."""
    rng = np.random.default_rng(2)
    plan = hidden.rounded(hidden.plan(rng, poses=30, stops=5, rounds=2))
    read = hidden.noisy(hidden.points(plan, HIDDEN["reversal"]), rng, "tracker")
    data = Measurements.load(hidden.write(folder / "tracker.csv", plan, read, u_mm=None), dmu50)
    one = diagnose(data, dmu50, calibration, instrument=LaserTracker())
    (panel,) = cause_panels(one, one.causes[0])
    for series, side in zip(panel.series, (0.5, -0.5), strict=True):
        assert abs(np.average(series.y, weights=series.weight) - side * REVERSAL_UM) < 0.3


def test_rivals_are_less_likely_than_the_cause(found: Mapping[str, Diagnosis]) -> None:
    """Rivals explain less and are far less likely; a confounded cause is not a rival."""
    (cause,) = found["reversal"].causes
    assert cause.rivals and all(rival.share < cause.share and rival.log_odds > np.log(100.0) for rival in cause.rivals)
    (alike,) = found["two alike"].causes
    assert alike.equivalent and not {(rival.effect, rival.where) for rival in alike.rivals} & set(alike.equivalent)


def test_no_such_cause(found: Mapping[str, Diagnosis]) -> None:
    with pytest.raises(InputError, match="no such cause"):
        plot_cause(found["reversal"], 1)


@pytest.mark.parametrize("name", [*HIDDEN, "part of it"])
def test_text_is_wrapped_and_short(found: Mapping[str, Diagnosis], name: str) -> None:
    one = found[name]
    many = tuple(("harmonic", f"E_X{letter}") for letter in "BC") * 10
    if one.causes:
        one = replace(one, causes=(replace(one.causes[0], equivalent=many),))
    text = replace(one, unidentifiable=many).to_text()
    assert max(len(line) for line in text.splitlines()) <= WIDTH
    assert text.startswith(f"{one.verdict.upper()}. ") and "\u00a0" not in text
    assert "and 13 more" in text and text.count("E_XB") < 30
    assert not re.search(r"\d\n\s+(µm|%)", text)
    if one.causes:
        # The name in words, then the symbol.
        assert (
            f"{cause_title(one.causes[0].effect, one.causes[0].where)} ({one.causes[0].effect} {one.causes[0].where}"
            in text
        )


def test_a_notebook_shows_verdict_and_causes(found: Mapping[str, Diagnosis]) -> None:
    shown = found["two alike"].display().html().text
    assert "ambiguous" in shown and "cross_axis" in shown and "changes with" in shown
    assert str(found["two alike"]).startswith("ambiguous: RMS residual ") and "cross_axis" in str(found["two alike"])


def test_the_json_is_the_contracts(found: Mapping[str, Diagnosis]) -> None:
    """Contract §4, without the arrays for the pictures."""
    result = json.loads(json.dumps(found["reversal"].to_dict()))
    contract = "schema verdict residual causes unexplained unidentifiable gain next_measurement".split()
    ours = ["not_evaluated", "trends", "noise_source", "set_aside", "notices", "warnings"]
    assert set(result) == {*contract, *ours}
    keys = "effect where origin parameters p_value share equivalent evidence probability bounded".split()
    assert set(result["causes"][0]) == {*keys, "promised", "credible", "assumes"}
    assert set(result["gain"]["held_out"]) == {"of", "groups", "rms_before_um", "rms_after_um", "ci95_um"}


def test_every_cause_has_words(dmu50: Machine, calibration: Calibration, found: Mapping[str, Diagnosis]) -> None:
    data = found["nothing"].data
    everything = catalogue(dmu50, data, calibration).candidates
    assert {one.effect for one in everything} <= set(SPECIFICATIONS)
    for one in everything:
        words = cause_title(one.effect, one.where)
        assert words[0].isupper() or words.startswith("E_")
        assert "_" not in re.sub(r"\bE_[XYZABC]\w+", "", words), words


def test_numbers_carry_as_many_digits_as_are_known() -> None:
    """GUM 7.2.6: two digits of the uncertainty, and the value to the same place."""
    assert measured(9.2873, 0.2604, "µm") == "9.29 ± 0.51 µm"
    assert measured(-1234.5, 55.0, "µrad") == "−1234 ± 108 µrad"
    assert measured(0.0, 0.5, "µm") == "0.00 ± 0.98 µm"
    assert measured(-0.001, 0.5, "µm") == "0.00 ± 0.98 µm"
    assert measured(3.0, 0.0, "1") == "3"
    assert [chance(p) for p in (1e-300, 2e-4, 0.12)] == ["under 1 in a million", "1 in 5,000", "12 %"]
    assert odds(np.log(4321.0)) == "about 4,300 times less likely" and odds(800.0).startswith("more than a million")


def test_points_are_grouped_by_the_causes_they_separate() -> None:
    """Two predictions 10 µm apart with 4 µm noise: χ² 6.25 per reading, four readings for 25."""
    point = {
        "separates": ["reversal Y", "pitch_error X"],
        "pose": {"X": 1.5, "B": 20.0},
        "approach": {"X": 1, "B": -1},
        "target": "K",
        "station": "1",
        "expected_chi2": 6.25,
    }
    (one,) = separating_points([point], 4.0)
    assert one.rows == (("X1.5 B20", "X+ B−", "K", "1", "10 µm"),) and "about 4 readings" in one.verdict
    (none,) = separating_points([{**point, "expected_chi2": 1e-8}], 4.0)
    assert none.rows == () and "0.0004 µm" in none.verdict and "Either can be used" in none.verdict
    (instrument,) = separating_points(
        [{"separates": ["reversal Y", "frame_shift round 2"], "decided_by": "repeat it"}], 4.0
    )
    assert instrument.verdict == "Repeat it."


@pytest.mark.slow
def test_the_page_fits_a_narrow_screen(pages: Mapping[str, str], folder: Path) -> None:
    """In a browser window of 420 pixels the page does not overflow."""
    expression = "document.documentElement.scrollWidth + ' of ' + innerWidth"
    needed, available = title_of(pages["two alike"], folder / "page.html", expression, width=420).split(" of ")
    assert int(needed) <= int(available)
