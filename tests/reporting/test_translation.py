"""Tests of the German page of a report and of its catalogue."""

from __future__ import annotations

import ast
import io
import json
import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from html import unescape
from pathlib import Path
from typing import Final

import pytest
from jinja2 import nodes
from matplotlib.figure import Figure
from matplotlib.text import Text

import twin
from tests.cli.commands import status
from tests.reporting.test_report import IDENTIFIED, MINE, TOOL_MM, unpacked
from twin._common.families import Language
from twin._common.messages import PLACE
from twin.cli.commands import COMMANDS, load
from twin.diagnosis.candidates import SPECIFICATIONS
from twin.display.markup import templates
from twin.display.sheet import catalogue
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.reporting.page import machine_html, sheet_of
from twin.reporting.result import MachineReport, machine_report

GERMAN = catalogue(Language.de)
MADE = datetime(2026, 1, 2, tzinfo=UTC)
ENGLISH = r"\b(the|of|and|is|not|error|axis|with|unknown|before|after|largest|over|from|at)\b"
QUOTED = (
    r"<(?:code|style|script|title).*?</(?:code|style|script|title)>|<[^>]*translate=no[^>]*>[^<]*|<[^>]*lang=en>[^<]*"
)


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
    labels, savefig = list[str](), Figure.savefig

    def noted(figure: Figure, *arguments: object, **more: object) -> None:
        savefig(figure, *arguments, **more)  # type: ignore[arg-type]
        labels.extend(one.get_text() for one in figure.findobj(Text))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda figure, file, **more: file.write(b"<svg/>"))
        english = machine_html(report)
        patch.setattr(Figure, "savefig", noted)
        german = machine_html(report, sheet=sheet_of(report, language=Language.de))
    return Pages(english, german, tuple(labels))


def details(page: str, quotes: str = QUOTED) -> str:
    """Return the text of the appendix and its text alternatives, without quoted files and code."""
    body = page[page.index("<h2>", page.index("<div class=details")) :]
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
    """Texts of the test's JSON file have no identifier."""
    page = pages[1].german
    assert "vorhandene Sätze der folgenden Abschnitte: 3." in page
    assert re.findall(r"<span lang=en>([^<]*)", page) == [
        "it &lt;moves&gt; with the reflectors",
        "an outlier",
        "the file says: simulated by a script",
    ]


def identifiers() -> dict[str, str]:
    """Return the identifiers of all messages of code and templates, each with a file that has it."""
    found: dict[str, str] = {}
    root = Path(twin.__file__).parent
    for path in root.rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match call:
                case ast.Call(ast.Name("Message" | "say"), [ast.Constant(str(text)), *_]):
                    found[" ".join(text.split())] = path.name
                case ast.Call(ast.Name("partial"), [ast.Name("Message"), ast.Constant(str(text)), *_]):
                    found[" ".join(text.split())] = path.name
    for path in root.rglob("*.j2"):
        for node in templates().parse(path.read_text(encoding="utf-8")).find_all(nodes.Call):
            match node.node, node.args:
                case nodes.Name(name="_" | "say"), [nodes.Const(value=str(text)), *_]:
                    found[" ".join(text.split())] = path.name
    for specification in SPECIFICATIONS.values():
        advice = specification.advice
        texts = [advice.look, advice.do, advice.never, specification.plural]
        if specification.kind == "instrument":
            texts.append(specification.decided_by)
        found |= {" ".join(text.split()): specification.name for text in texts}
    for instrument in INSTRUMENTS:
        words = instrument.specification.set_up
        texts = [f"{words.station} {{name}}", f"{words.target} {{name}}", words.station_place, words.target_place]
        found |= dict.fromkeys(texts, instrument.name)
    return {text: file for text, file in found.items() if re.search(r"[^\W\d_]", PLACE.sub("", text))}


def test_the_catalogue_has_every_message_and_no_other() -> None:
    found, known = identifiers(), GERMAN
    assert len(found) > 400
    assert {text: file for text, file in found.items() if text not in known} == {}
    assert [text for text in known if text not in found] == []


@pytest.mark.parametrize("english", GERMAN)
def test_both_languages_have_the_same_places(english: str) -> None:
    german = GERMAN[english]
    assert {*PLACE.findall(english)} == {*PLACE.findall(german)}
    assert re.findall("`[^`]*`", english) == re.findall("`[^`]*`", german)


def test_effects_on_the_first_page_are_german(pages: list[Pages]) -> None:
    details, _, _ = pages[1].german.partition("<h1 class=appendix")
    assert "Wärmedehnung des Maßstabs Z" in details and "Thermal expansion" not in details


def test_the_3d_field_is_german(pages: list[Pages]) -> None:
    page = pages[0].german
    assert "Abweichung in µm · Pfeile × " in unpacked(page)
    assert 'iframe title="Abweichungsfeld in 3D: Ziehen dreht"' in page


def test_the_page_is_as_before_in_english(pages: list[Pages]) -> None:
    page = pages[1].english
    assert "<html lang=en>" in page and "lang=de" not in page and "<!--" not in page


# --- Commands are run in both languages: what is printed and shown in German has no words in a row that the English one has

RUN: Final = 4
"""Number of words in a row, none of them a name or a number, that are a sentence left in English."""
QUOTES: Final = r"simulated by twin.*? noise|identified by twin[^\n]*|`[^`]*`|<(code|style|script|title|pre)\b.*?</\1>"


def runs_of_words(text: str) -> set[str]:
    """Return the sequences of `RUN` words in lower case, without quoted text, code and tags."""
    plain = unescape(
        re.sub(r"<[^>]*(?:translate=no|lang=en>)[^<]*|<[^>]+>", " ", re.sub(QUOTES, " ", text, flags=re.S))
    )
    found = set()
    for part in re.split(r"[^\w\s,;:()'’\-]", plain):
        words = part.replace(",", " ").split()
        for i in range(len(words) - RUN + 1):
            run = [word.strip("();:") for word in words[i : i + RUN]]
            if all(re.fullmatch(r"[a-zäöüß'’-]{2,}", word) for word in run):
                found.add(" ".join(run))
    return found


def left_in_english(
    folder: Path, capsys: pytest.CaptureFixture[str], *arguments: object, page: bool = True, to: str = "--html"
) -> set[str]:
    """Run a command in both languages; return the runs of words that are the same in the printed text and in the page."""
    found = []
    for language in Language:
        html = folder / f"{language.value}.html"
        status(*arguments, "--lang", language.value, *([to, html] if page else []))
        found.append(runs_of_words(capsys.readouterr().out + (html.read_text(encoding="utf-8") if page else "")))
    assert found[0]
    return found[0] & found[1]


def test_words_left_in_english_are_found() -> None:
    german = runs_of_words("Das ist gut. The readings agree with the model; E_XX 3 µm.")
    assert runs_of_words("The readings agree with the model") & german == {
        "readings agree with the",
        "agree with the model",
    }


@pytest.fixture
def readings(tmp_path: Path, calibration: Calibration) -> Path:
    """Readings of a machine with a backlash and a squareness that the default calibration does not have."""
    moved = replace(calibration, squareness={**calibration.squareness, "E_C0Y": 300.0})
    moved.save(tmp_path / "moved.yaml")
    table = tmp_path / "readings.csv"
    assert status("simulate", "thesis_plan.csv", "-o", table, "-c", tmp_path / "moved.yaml", "--seed", 3) == 0
    return table


def test_compare_prints_german(tmp_path: Path, calibration: Calibration, capsys: pytest.CaptureFixture[str]) -> None:
    calibration.save(tmp_path / "older.yaml")
    replace(calibration, squareness={**calibration.squareness, "E_C0Y": 300.0}).save(tmp_path / "newer.yaml")
    assert left_in_english(tmp_path, capsys, "compare", tmp_path / "older.yaml", tmp_path / "newer.yaml") == set()


def test_machine_asks_in_german(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = []
    for language in Language:
        monkeypatch.setattr("sys.stdin", io.StringIO("\n9\n" + 12 * "\n"))
        assert status("machine", "new", "-o", tmp_path / f"{language.value}.yaml", "--lang", language.value) == 0
        printed.append(runs_of_words(capsys.readouterr().out))
    assert printed[0] and printed[1] and printed[0] & printed[1] == set()


PRINTED: Final = (
    "check cone_frustum.nc --tool-length 120",
    "check cone_frustum.nc cone_frustum.cls --tool-length 120",
    "plan -o new.csv --artefact diagonals",
    "plan -o new.csv --artefact block",
    "plan -o new.csv --artefact straightedge",
    "plan -o new.csv --instrument probe --sequence turns --tool-length 120",
    "plan -o new.csv --instrument ball-bar",
)
PAGES: Final = (
    "diagnose readings.csv -c mine.yaml",
    "evaluate readings.csv --tolerance E_C0Y=20 --instrument tracker",
    "confirm mine.yaml readings.csv",
)
ELSEWHERE: Final = {"compare", "forecast", "machine", "report"}
"""Commands with ``--lang`` that other tests run."""


def printed(folder: Path, words: str) -> list[object]:
    own = ("readings.csv", "mine.yaml", "new.csv")
    return [folder / word if word in own else word for word in words.split()]


@pytest.mark.parametrize("words", PRINTED)
def test_printed_text_is_german(words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert left_in_english(tmp_path, capsys, *printed(tmp_path, words), page=False) == set()


def test_every_command_with_a_language_is_run() -> None:
    """A command that gets ``--lang`` without an example here fails."""
    found = {
        name
        for name in COMMANDS
        for command in [load(name)]
        if any("--lang" in parameter.opts for parameter in command.params)
    }
    assert found == {words.split()[0] for words in (*PRINTED, *PAGES)} | ELSEWHERE


@pytest.mark.slow
@pytest.mark.parametrize("words", PAGES)
def test_a_page_and_its_text_are_german(
    words: str, tmp_path: Path, readings: Path, calibration: Calibration, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration.save(tmp_path / "mine.yaml")
    capsys.readouterr()
    assert left_in_english(tmp_path, capsys, *printed(tmp_path, words)) == set()
