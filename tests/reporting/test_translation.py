"""Tests of the translation of a report's appendix and pictures by sentences."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape, unescape
from importlib import resources

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.text import Text

from tests.reporting.test_report import IDENTIFIED, MINE, TOOL_MM
from twin._common.families import Language
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.reporting import machine_report
from twin.reporting.page import machine_html
from twin.reporting.result import MachineReport
from twin.reporting.translation import translator

MADE = datetime(2026, 1, 2, tzinfo=UTC)
ENGLISH = r"\b(the|of|and|is|not|error|axis|with|unknown|before|after|largest|over|from|at)\b"
QUOTED = (
    r"<(?:code|style|script|title).*?</(?:code|style|script|title)>|<[^>]*translate=no[^>]*>[^<]*|<[^>]*lang=en>[^<]*"
)
CATALOGUE = yaml.safe_load(resources.files("twin.reporting").joinpath("wording/de_sentences.yaml").read_text("utf-8"))


@dataclass(frozen=True)
class Pages:
    """One report in both languages, and the labels of the German pictures."""

    english: str
    german: str
    labels: tuple[str, ...]


@pytest.fixture(scope="module")
def pages(dmu50: Machine, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> list[Pages]:
    """Return the pages of the illustrative calibration, and of an identified one with effects."""
    folder = tmp_path_factory.mktemp("translated")
    (folder / "mine.yaml").write_text(MINE)
    (folder / "identified.json").write_text(json.dumps(IDENTIFIED))
    mine = Calibration.load(folder / "mine.yaml", dmu50)
    warm = Conditions({"Z": 24.0})
    with_fit = machine_report(
        dmu50, mine, made=MADE, tool_length_mm=TOOL_MM, conditions=warm, identified=folder / "identified.json"
    )
    return [in_both_languages(report) for report in (machine_report(dmu50, calibration, made=MADE), with_fit)]


def in_both_languages(report: MachineReport) -> Pages:
    english, labels, savefig = machine_html(report), list[str](), Figure.savefig

    def noted(figure: Figure, *arguments: object, **more: object) -> None:
        savefig(figure, *arguments, **more)  # type: ignore[arg-type]
        labels.extend(one.get_text() for one in figure.findobj(Text))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", noted)
        german = machine_html(report, language=Language.de)
    return Pages(english, german, tuple(labels))


def details(page: str, quotes: str = QUOTED) -> str:
    """Return the text of the appendix and its text alternatives, without quoted files and code."""
    body = page[page.rindex("<div lang=") :] if "<div lang=" in page else page
    body = re.sub(r"<iframe.*?</iframe>", " ", body, flags=re.S)
    alternatives = " ".join(re.findall(r'alt="([^"]*)"', body))
    return unescape(re.sub(r"<[^>]+>", " ", re.sub(quotes, " ", body, flags=re.S)) + alternatives)


def test_the_appendix_is_german(pages: list[Pages]) -> None:
    """No English word is left outside of quoted text, and every number of the English page is in the German one."""
    for one in pages:
        words = details(one.german)
        assert "Abweichungsbudget am Werkzeug" in words
        assert not re.findall(f".{{20}}{ENGLISH}.{{20}}", words)
        assert not [text for text in one.labels if re.search(ENGLISH, text) or re.search(r"\d\.\d", text)]
        texts = (details(one.english), words.translate(str.maketrans(",\N{NARROW NO-BREAK SPACE}", ".,")))
        found = [re.findall(r"\d+(?:[.,]\d+)*", text) for text in texts]
        dates = {"02", "2026", "02.01.2026", "95"}
        assert set(found[0]) - dates == set(found[1]) - dates


def test_what_has_no_translation_stays_english_and_is_counted(pages: list[Pages]) -> None:
    """The reason in the test's JSON file is in no catalogue."""
    page = pages[1].german
    assert "vorhandene Sätze der folgenden Abschnitte: 1." in page
    assert re.findall(r"<span lang=en>([^<]*)", page) == ["E_X0B: it &lt;moves&gt; with the reflectors"]
    assert "<!-- details" not in page and "<!-- number" not in page


@pytest.mark.parametrize("sentence", CATALOGUE["sentences"])
def test_both_sentences_have_the_same_places(sentence: str) -> None:
    places = [sorted(re.findall(r"\{(\w+)\}", text)) for text in (sentence, CATALOGUE["sentences"][sentence])]
    assert places[0] == places[1]


@pytest.mark.parametrize(
    ("english", "german"),
    [
        ("at least 1,234.5 µm", "mindestens 1\N{NARROW NO-BREAK SPACE}234,5 µm"),
        ("E_XX, E_YY and 34 more", "E_XX, E_YY und 34 weitere"),
        ("Y out of square to X (E_C0Y)", "Rechtwinkligkeit Y zu X (E_C0Y)"),
        ("axis of C tilted about y (1 ± 2 µrad) and Z out of square to Y (3 ± 4 µrad)",
         "Achslage C: Neigung um y (1 ± 2 µrad) und Rechtwinkligkeit Z zu Y (3 ± 4 µrad)"),
        ("Use this calibration. Measure more first.", "Diese Kalibrierung verwenden. Zuerst mehr messen."),
        ("python 3.11.7, twin 0.1.0 (ab12cd)", "python 3.11.7, twin 0.1.0 (ab12cd)"),
        ("/tmp/a 1.5/c.yaml", "/tmp/a 1.5/c.yaml"),
        ("60.0 µrad\n(± unknown)", "60,0 µrad\n(± unbekannt)"),
        ("the file says: seed 3.5, with noise", "die Datei gibt an: seed 3.5, with noise"),
    ],
)  # fmt: skip
def test_sentences(english: str, german: str) -> None:
    assert translator(Language.de).text(english) == german


def test_a_sentence_is_never_translated_in_part() -> None:
    to = translator(Language.de)
    for text in (
        "Largest uncertainties: the blue one.",
        "Line: calibration. Purple things are 1.5 µm long.",
        "A, b c and C",
    ):
        assert to.text(text) == text
    assert len(to.missing) == 3
    page = "<p>Line: calibration. Purple things are 1.5&nbsp;µm long.</p><p>a &lt; <b>b</b> &amp; c</p>"
    assert to.page(page) == (
        "<p>Linie: Kalibrierung. <span lang=en>Purple things are 1.5&nbsp;µm long.</span></p>"
        "<p><span lang=en>a &lt;</span> <b><span lang=en>b</span></b> <span lang=en>&amp; c</span></p>"
    )


@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=60))
def test_any_text_survives(text: str) -> None:
    """Text from a file, such as the name of a target, is never damaged, only marked."""
    found = translator(Language.de).page(f"<p translate=no>{escape(text)}</p>")
    quoted = unescape(f"<p translate=no>{escape(text)}</p>")
    assert unescape(found).replace("\N{NO-BREAK SPACE}", " ") == quoted.replace("\N{NO-BREAK SPACE}", " ")
    translator(Language.de).page(f"<p>{escape(text)}</p>")


def test_effects_on_the_first_page_are_german(pages: list[Pages]) -> None:
    front, _, _ = pages[1].german.partition("<h1 class=appendix")
    assert "Wärmedehnung des Maßstabs Z" in front and "Thermal expansion" not in front


def test_the_3d_field_is_german(pages: list[Pages]) -> None:
    page = pages[0].german
    assert "Abweichung in µm · Pfeile × " in page
    assert 'iframe title="Abweichungsfeld in 3D: Ziehen dreht"' in page


def test_the_page_is_as_before_in_english(pages: list[Pages]) -> None:
    page = pages[1].english
    assert "<html lang=en>" in page and "lang=de" not in page and "<!--" not in page
