"""Invalid files and words: success, or one `InputError` in limited time; no other exception and no partial output."""

from __future__ import annotations

import inspect
import json
import time
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.hostile import KINDS, NUMBERS, TEXTS, beside, edited, layout, machine, sample
from twin import cli
from twin._common.errors import InputError
from twin.cli import commands
from twin.cli.commands import load

EXAMPLES = 60
"""Examples for a kind of file that is fast to read; about 1,000 in total."""
LONGEST_S = 10.0
"""Largest processor time of one input; the slowest takes a tenth of it."""
COMMANDS: dict[str, Any] = {name: load(name) for name in commands.COMMANDS}
SIMULATE = (
    "simulate-run",
    "--layout",
    "nine_beams_x.yaml",
    "--positions",
    "0,500,5",
    "-o",
    "run.csv",
    "--json",
    "run.json",
)
WORDS = [
    *NUMBERS,
    "=",
    "X=1",
    "X=nan",
    "X=1e308",
    "1,2,3",
    "0,500,5",
    "0,500,1e8",
    "0,nan,3",
    "--",
    "-",
    "..",
    "/",
    "tcp://x",
    "E_*",
    "*",
]


def read_or_refused(kind: str, folder: Path, examples: int) -> None:
    """Try invalid texts of a kind; fail on the first that is neither read nor refused."""
    path = folder / KINDS[kind].file
    beside(kind, folder)
    path.write_text(sample(kind))
    KINDS[kind].use(path)  # the unmodified text is valid

    @settings(max_examples=examples // KINDS[kind].cost)
    @given(data=edited(kind))
    def attempt(data: bytes) -> None:
        path.write_bytes(data)
        begin = time.process_time()
        try:
            KINDS[kind].use(path)
        except InputError as error:
            assert error.expected and "\n" not in str(error)
            assert not any(unicodedata.category(one)[0] == "C" for one in str(error))
        assert time.process_time() - begin < LONGEST_S

    attempt()


@pytest.mark.sample(11)  # of 35
@pytest.mark.parametrize("kind", KINDS)
def test_a_hostile_file_is_read_or_refused(kind: str, tmp_path: Path) -> None:
    read_or_refused(kind, tmp_path, EXAMPLES)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_hostile_files_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    read_or_refused(kind, tmp_path, 40 * EXAMPLES)


def done_or_refused(capsys: pytest.CaptureFixture[str], words: list[str]) -> int:
    """Run a command in the current folder as `ended`; return its exit status."""
    return ended(capsys, words)[0]


def ended(capsys: pytest.CaptureFixture[str], words: list[str]) -> tuple[int, str, dict[str, bytes]]:
    """Run a command in the current folder; return its exit status, what it printed and the files it made, which are removed.

    It must exit with 0 or 3 and complete outputs, or with 2, one line and no output.
    """
    before = set(Path().iterdir())
    with pytest.raises(SystemExit) as stopped:
        cli.main(words)
    status = int(stopped.value.code or 0)
    # The mapping that `import` proposes is for a person to confirm.
    made = {path for path in set(Path().iterdir()) - before if not path.name.endswith(".columns.yaml")}
    printed = capsys.readouterr()
    errors = printed.err
    assert status in (0, 2, 3), (words, status)
    if status == 2:
        assert errors.startswith("twin: ") and errors.count("\n") == 1 and not made, (words, errors, made)
    contents = {}
    for path in made:
        assert not path.name.startswith("."), (words, path)
        if path.suffix == ".json":
            json.loads(path.read_text(), parse_constant=_no_constant)
        contents[path.name] = path.read_bytes() if path.is_file() else b""
        path.unlink()
    return status, printed.out + errors, contents


def _no_constant(name: str) -> float:
    raise AssertionError(f"{name} is not JSON")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_a_hostile_table_at_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    @settings(max_examples=20)
    @given(data=edited("readings"))
    def attempt(data: bytes) -> None:
        Path("readings.csv").write_bytes(data)
        words = ["axis-run", "readings.csv", "--layout", "nine_beams_x.yaml", "-o", "x.yaml", "--json", "x.json"]
        done_or_refused(capsys, words)

    attempt()


@pytest.mark.slow
def test_hostile_words_at_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = sorted(name for one in COMMANDS["simulate-run"].params for name in one.opts if name.startswith("--"))
    words = st.sampled_from([*WORDS, *TEXTS[:-4]])

    @settings(max_examples=40)
    @given(option=st.sampled_from(options), value=words)
    def attempt(option: str, value: str) -> None:
        if option not in ("--help", "--json", "--output"):  # a file of any name may be written
            done_or_refused(capsys, [*SIMULATE, f"{option}={value}"])

    attempt()


NUMERIC = [
    (name, option.opts[0])
    for name, one in COMMANDS.items()
    for option in one.params
    if float in (hint := get_type_hints(inspect.unwrap(one.callback)).get(option.name), *get_args(hint))
]


@pytest.mark.sample(349)  # of 406
@pytest.mark.parametrize("value", ["nan", "inf", "-1e308", "1e308", "1e-300", "x", ""])
@pytest.mark.parametrize(("name", "option"), NUMERIC)
def test_no_number_overflows(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, option: str, value: str
) -> None:
    Path("a.csv").write_text(sample("table"))
    Path("a.nc").write_text(sample("iso"))
    Path("c.yaml").write_text(sample("calibration"))
    given: dict[str, list[str]] = {
        "compensate": ["a.nc", "-o", "b.nc"],
        "path": ["a.nc", "-o", "b.nc"],
        "scene": ["a.nc", "-o", "b.html"],
        "simulate": ["a.csv", "-o", "b.csv"],
        "convert": ["a.csv", "-o", "b.csv"],
        "identify": ["a.csv", "-o", "b.yaml"],
        "evaluate": ["a.csv"],
        "watch": ["."],
        "compare": ["c.yaml", "c.yaml"],
        "plan": ["-o", "b.csv"],
        "report": ["-o", "b.html"],
        "control": ["--to", "grid", "-o", "tables"],
    }
    assert done_or_refused(capsys, [name, *given.get(name, []), f"{option}={value}"]) == 2


def test_the_numbers_are_tried_of_every_command_that_has_one() -> None:
    assert {"--tolerance", "--tool-length", "--minutes", "--time"} <= {option for _, option in NUMERIC}
    assert len(NUMERIC) > 15


TOO_MUCH: dict[str, tuple[str, Callable[[], str]]] = {
    "columns": ("table", lambda: ",".join(f"c{i}" for i in range(200_000)) + "\n"),
    "unknown columns": ("table", lambda: sample("table").replace("u_z_mm", ",".join(f"u_z_m{i}" for i in range(900)), 1)),
    "cells": ("table", lambda: sample("table") + "," * 10_000_000 + "\n"),
    "quotes": ("table", lambda: sample("table") + '"' * 1_000_000),
    "aliases": (
        "calibration",
        lambda: "a: &a [x, x]\n"
        + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]\n" for a, b in zip("abcdefghij", "bcdefghijk", strict=True)),
    ),
    "levels": ("calibration", lambda: sample("calibration") + "effects: " + "[" * 5000),
    "nested blocks": ("calibration", lambda: "".join(" " * i + "a:\n" for i in range(5000))),
    "entries": ("calibration", lambda: "a: [" + "1, " * 2_000_000 + "]\n"),
    "bytes": ("calibration", lambda: "source: " + "a" * 20_000_000),
    "digits": ("calibration", lambda: sample("calibration").replace("22.0", "9" * 1_000_000)),
    "minutes": ("calibration", lambda: sample("calibration").replace("22.0", "1" + ":59" * 100_000)),
    "JSON levels": ("identified", lambda: "[" * 1_000_000),
    "JSON digits": ("identified", lambda: '{"schema": ' + "9" * 100_000 + "}"),
    "positions": (
        "readings",
        lambda: sample("readings").partition("\n0")[0] + "\n" + "".join(f"{i / 10},{','.join('1' * 9)},1,1\n" for i in range(5000)),
    ),
}  # fmt: skip


@pytest.mark.sample(8)  # of 14
@pytest.mark.parametrize("name", TOO_MUCH)
def test_too_much_is_refused_in_time(name: str, tmp_path: Path) -> None:
    kind, text = TOO_MUCH[name]
    machine(), layout(), sample(kind)
    path = tmp_path / KINDS[kind].file
    path.write_text(text())
    begin = time.process_time()
    with pytest.raises(InputError):
        KINDS[kind].use(path)
    assert time.process_time() - begin < LONGEST_S
