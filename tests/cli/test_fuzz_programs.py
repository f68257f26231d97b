"""Random programs with statements outside every vocabulary, for every command that reads a program.

The reader's own tests are in `tests.nc.test_unknown`. Here a program ends with status 0, 2 or 3 and never with another exception. If it
cuts where nothing is known, the status is 2 or 3, and the message names the statement and the line.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from string import ascii_uppercase

import pytest

from tests.cli.test_fuzz import ended
from tests.nc.test_unknown import (
    G_CODES,
    M_CODES,
    NAMES,
    PLAIN_CYCLES,
    PLAIN_FN,
    PLAIN_M,
    PLAIN_STATEMENTS,
    WORDS,
)

EXAMPLES = 6
CALIBRATION = (
    "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\n"
    "squareness: {E_C0Y: 22.0}\nlocation: {E_X0C: 4.0, E_A0C: -12.0}\n"
)
COMMANDS = {
    "compensate": ["compensate", "-o", "out{}", "-c", "c.yaml", "--json", "out.json"],
    "path": ["path", "-o", "out{}", "-c", "c.yaml", "--json", "out.json"],
    "path, not compensated": ["path", "-o", "out{}", "--no-compensate", "--json", "out.json"],
    "scene": ["scene", "-o", "out.html", "-c", "c.yaml", "--json", "out.json"],
}
OFFSET = ["--work-offset", "X=250", "Y=225", "Z=-200"]


@dataclass(frozen=True)
class Language:
    """Blocks of one language.

    Attributes:
        start: a rapid that names every axis; ``machine``: the same in machine coordinates, absolute.
        feeds: blocks that cut, once the start was given.
        part: blocks in machine coordinates that leave an axis out.
        harmless: blocks that leave everything as it is.
        unknown: statements outside the vocabulary, to which random names with one of the ``endings`` are added.
    """

    suffix: str
    start: str
    machine: str
    feeds: Sequence[str]
    part: Sequence[str]
    harmless: Sequence[str]
    unknown: Sequence[str]
    endings: Sequence[str]


LANGUAGES = [
    Language(
        ".nc",
        "G0 X1 Y2 Z3 B4 C5",
        "G53 G0 X250 Y225 Z-1 B0 C0",
        ["G1 X6 F500", "G1 X6.1 Y2.2 F500", "G1 X6.2", "G1 Y3 B5", "G1 Z2.5 C6"],
        ["G53 G0 Z-1", "G53 X250 Y225 Z-1 B0", "SUPA G0 Z=-1", "G28 Z0", "G0 X1 Y2"],
        ["(a comment)", "", "M8", "N10", "S500 M3", "; X1", "G90"],
        [*G_CODES, *M_CODES, *NAMES, *WORDS, *PLAIN_STATEMENTS[:3]],
        ["", "(1)", "(1,2,X)"],
    ),
    Language(
        ".h",
        "L X+1 Y+2 Z+3 B+4 C+5 FMAX",
        "L X+250 Y+225 Z-1 B+0 C+0 FMAX M91",
        ["L X+6 F500", "L X+6.1 Y+2.2 F500", "L X+6.2", "L Y+3 B+5", "L Z+2.5 C+6"],
        ["L Z-1 FMAX M91", "L X+250 Y+225 Z-1 B+0 FMAX M91", "L X+1 FMAX"],
        ["; a comment", "", "M8", "L", "STOP"],
        [*PLAIN_M, *PLAIN_CYCLES, *PLAIN_FN, *PLAIN_STATEMENTS, "TRAORI(1)", "GOTO/1,2,3"],
        [""],
    ),
    Language(
        ".cls",
        "GOTO/1,2,3,0,0,1",
        "",
        ["GOTO/6,2,3", "GOTO/6.1,2.2,3", "GOTO/6.2,2,3,0,0.1,0.99"],
        ["FROM/1,2,3"],
        ["$$ a comment", "COOLNT/ON", "FEDRAT/MMPM,500."],
        [],
        ["", "/1", "/X,ON,2.5"],
    ),
]
NOTHING = ["M30\n", "", "%", "%\n", "(only)\n(comments)\n", "; only\n", "G28\n", "G53\n", "G28 X0 Y0 Z0\n", "\n\n", " "]
NOTHING += [
    "G53 G0 X0 Y0 Z0 B0 C0\n",
    "%\nO1\n%\n",
    "FOO\n",
    "BEGIN PGM A MM\nEND PGM A MM\n",
    "L M91\n",
    "G91 G28 Z0\n",
]
NOTHING += ["GOHOME\n", "PARTNO A\nUNITS/MM\nFINI\n", "$$ only\n", "\x1a", "\ufeff".encode().decode("latin-1")]


@dataclass(frozen=True)
class Written:
    """A program, the statements that are not known, and the numbers of the lines that cut where nothing is known."""

    suffix: str
    text: str
    unknown: tuple[str, ...]
    lost: tuple[int, ...]


def drawn(random: Random) -> Written:
    """Return a random program, with the lines lost between an unknown statement and a block of every axis in machine coordinates."""
    language = random.choice(LANGUAGES)
    lines, unknown, lost, known = [language.start], [], [], True
    for kind in random.choices("ffffuumhps", k=random.randrange(3, 15)):
        if kind == "f":
            for feed in language.feeds if random.random() < 0.5 else [random.choice(language.feeds)]:
                lines.append(feed)
                lost += [] if known else [len(lines)]
        elif kind == "u":
            name = "".join(random.choices(ascii_uppercase, k=random.randrange(5, 9))) + random.choice(language.endings)
            unknown.append(random.choice([name, random.choice(language.unknown or [name])]))
            lines.append(unknown[-1])
            known = False
        elif kind == "m" and language.machine:
            lines += [language.machine, language.start]
            known = True
        else:
            others = {"h": language.harmless, "p": language.part}.get(kind, [language.start])
            lines.append(random.choice(others))
            lost += [] if known or not lines[-1].startswith("GOTO/") else [len(lines)]
    return Written(language.suffix, "\n".join(lines) + "\n", tuple(unknown), tuple(lost))


def try_program(name: str, program: Written, capsys: pytest.CaptureFixture[str]) -> int:
    """Run a command on a program; return its exit status."""
    source = Path(f"a{program.suffix}")
    data = program.text.encode("latin-1")
    source.write_bytes(data)
    command, *words = COMMANDS[name]
    target = ".nc" if program.suffix == ".cls" else program.suffix
    words = [command, source.name, *OFFSET, *(word.format(target) for word in words)]
    status, printed, made = ended(capsys, words)
    assert source.read_bytes() == data
    if status == 2 or not program.lost:
        return status
    assert status == 3, "a block that cuts where nothing is known is as done"
    assert any(f"the effect of {one} is not known" in printed for one in program.unknown), printed
    report = json.loads(made["out.json"])
    if name == "scene":
        assert "Not shown: " in made["out.html"].decode()
        assert {one["line"] for one in report["unknown"] if one["cutting"]} == {*program.lost}
        return status
    found = report["compensation"] if name == "path" else report
    left = [one for one in found.get("not_corrected", []) if one["kind"] == "unknown"]
    assert not left or {line for one in left for line in one["missed"]} == {*program.lost}
    assert left or program.lost[0] in {one["line"] for one in report["not_met"]}
    text = program.text.splitlines()
    assert Counter(text[line - 1] for line in program.lost) <= Counter(made[f"out{target}"].decode().splitlines())
    return status


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(CALIBRATION)


def try_programs(name: str, seeds: range, capsys: pytest.CaptureFixture[str]) -> None:
    statuses = set()
    for seed in seeds:
        program = drawn(Random(seed))
        try:
            statuses.add(try_program(name, program, capsys))
        except (Exception, AssertionError) as error:
            raise AssertionError(f"{name} of program {seed}:\n{program.text}") from error
    assert 3 in statuses


@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_done_as_known_that_is_not(folder: None, capsys: pytest.CaptureFixture[str], name: str) -> None:
    try_programs(name, range(EXAMPLES), capsys)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_done_as_known_in_many_programs(folder: None, capsys: pytest.CaptureFixture[str], name: str) -> None:
    try_programs(name, range(EXAMPLES, 50 * EXAMPLES), capsys)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_program_of_nothing(folder: None, capsys: pytest.CaptureFixture[str], name: str) -> None:
    """A program without a motion between known positions is refused, in whichever language."""
    for number, text in enumerate(NOTHING):
        suffix = LANGUAGES[number % len(LANGUAGES)].suffix
        assert try_program(name, Written(suffix, text, (), ()), capsys) == 2, (text, suffix)
