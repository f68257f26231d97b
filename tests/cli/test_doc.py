"""The manual in a narrow terminal."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from rich.console import Console

from twin.cli.doc import PAGES, page_text
from twin.cli.shared.terminal import ManualPage, code_lines


def shown(text: str, width: int) -> list[str]:
    console = Console(width=width, color_system=None)
    with console.capture() as captured:
        console.print(ManualPage(text))
    return captured.get().splitlines()


@pytest.mark.parametrize("name", PAGES)
def test_no_word_is_cut_at_80_columns(name: str) -> None:
    """Every word of the wide page is also in the narrow one, and no line is wider than the terminal."""
    text = page_text(name)
    narrow, wide = shown(text, 80), shown(text, 1000)
    assert max(map(len, narrow)) <= 80
    words = {word for line in wide for word in re.findall(r"[^\s─━]+", line)}
    assert not words - {word for line in narrow for word in (*line.split(), *re.findall(r"[^\s]+(?=:)", line))}


def test_every_page_can_be_shown() -> None:
    """Every file of the manual is a page, and every page that README or the manual names is one."""
    root = Path(__file__).parents[2]
    files = [*(root / "twin/cli/manual").glob("*.md"), root / "README.md"]
    assert {path.stem for path in files[:-1]} == {*PAGES}
    assert {name for path in files for name in re.findall(r"twin doc ([a-z]+)", path.read_text())} <= {*PAGES}


def test_a_long_command_stays_a_command() -> None:
    line = "  twin report --calibration mine.yaml --identified identified.json --tool-length 120 -o report.html --json r.json"
    lines = code_lines(line, 60)
    assert max(map(len, lines)) <= 60 and len(lines) > 1
    assert shlex.split("\n".join(lines).replace("\\\n", "")) == shlex.split(line)


def test_a_table_that_fits_stays_a_table() -> None:
    table = "| error | size at the end of its travel | other |\n|---|---|---|\n| E_XX | 12 µm | 3 µm |\n"
    assert any("E_XX" in line and "12 µm" in line for line in shown(table, 80))
    assert any(line.strip() == "size at the end of its travel: 12 µm" for line in shown(table, 42))
