"""Every command and script of README and of the manual works as written."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest
import typer

from tests.measurement.formats.cases import renishaw_laser
from twin.cli.commands import app, load
from twin.cli.doc import PAGES, page_text
from twin.cli.shared.terminal import repeat_options
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.samples import TABLES

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def said() -> Iterator[tuple[str, str]]:
    """Every call of ``twin`` that README, the manual's pages and the notebooks write on a line of its own."""
    for block in re.findall(r"^```(?:sh|text)\n(.*?)^```", README, re.M | re.S):
        for line in block.splitlines():
            for part in line.split(" && "):
                if part.split()[0].removeprefix(".venv/bin/") == "twin":
                    yield "README", part
    for page in PAGES:
        yield from ((page, line.strip()) for line in page_text(page).splitlines() if line.startswith("    twin "))
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for cell in json.loads(path.read_text())["cells"]:
            text = "".join(cell["source"])
            yield from (
                (path.stem, line.strip("! `")) for line in text.splitlines() if re.match(r"(!|    |)twin \w", line)
            )


CALLS = list(dict.fromkeys(said()))


def test_there_are_calls() -> None:
    assert len(CALLS) > 20 and {place for place, _ in CALLS} >= {"README", "identify", "diagnose", "plan", "many"}


@pytest.mark.parametrize("call", CALLS, ids=lambda call: f"{call[0]}: {call[1][:60]}")
def test_every_call_is_one(call: tuple[str, str]) -> None:
    """Command, options and their kinds, as the command line itself reads them; nothing is run."""
    words = shlex.split(call[1])[1:]
    group: Any = typer.main.get_command(app)
    with group.make_context("twin", ["doc"]) as context:
        load(words[0]).make_context(words[0], repeat_options(words)[1:], parent=context)


def test_the_manual_has_a_page_for_every_name() -> None:
    for page in PAGES:
        first, *rest = page_text(page).splitlines()
        assert first.endswith(".") and len([line for line in rest if line.strip()]) >= 5, page


@pytest.mark.parametrize(
    ("page", "number", "printed"),
    [
        ("README.md", 0, "[["),
        ("README.md", 1, "error at the tool"),
        (".docs/pages/getting-started.md", 0, "error at the tool"),
    ],
)
def test_scripts_run_as_written(page: str, number: int, printed: str, tmp_path: Path) -> None:
    script = (ROOT / page).read_text().split("```python\n")[1:][number].split("```")[0]
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert printed in done.stdout


@pytest.mark.parametrize(
    ("page", "name", "content"),
    [
        ("convert", "x.rtl", renishaw_laser.GOOD.encode()),
        ("import", "export.csv", TABLES[0].read_bytes()),
    ],
)
def test_scripts_of_the_manual_run_as_written(page: str, name: str, content: bytes, tmp_path: Path) -> None:
    lines = page_text(page).splitlines()
    script = takewhile(lambda line: not line or line.startswith("    "), lines[lines.index("    import twin") :])
    (tmp_path / name).write_bytes(content)
    command = [sys.executable, "-c", textwrap.dedent("\n".join(script))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.iterdir())) == 2, "the script saves one file"


PAGES_OF_SITE = sorted((ROOT / ".docs/pages").glob("**/*.md"))
EXAMPLES = re.findall(
    r"^## (.*?)\n.*?^```python\n(.*?)^```\n\n```text\n(.*?)^```",
    (ROOT / ".docs/pages/gallery.md").read_text(),
    re.M | re.S,
)


@pytest.mark.slow
@pytest.mark.parametrize(("script", "printed"), [one[1:] for one in EXAMPLES], ids=[one[0] for one in EXAMPLES])
def test_examples_of_the_gallery_print_what_it_shows(script: str, printed: str, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == printed


def test_the_gallery_has_an_answer_to_each_of_its_questions() -> None:
    text = (ROOT / ".docs/pages/gallery.md").read_text()
    assert len(EXAMPLES) == text.count("```python") == 15


def test_every_test_that_the_site_names_exists() -> None:
    named = {found for page in PAGES_OF_SITE for found in re.findall(r"(tests/[\w/]+\.py)::(\w+)", page.read_text())}
    assert len(named) > 50
    for path, name in named:
        assert re.search(rf"^def {name}\(", (ROOT / path).read_text(), re.M), f"{path}::{name}"


def test_every_source_that_the_site_cites_is_in_the_bibliography() -> None:
    stated = re.findall(r"^  \{: #([\w-]+) \}$", (ROOT / ".docs/pages/concepts/bibliography.md").read_text(), re.M)
    cited = {found for page in PAGES_OF_SITE for found in re.findall(r"bibliography\.md#([\w-]+)", page.read_text())}
    assert sorted(stated) == sorted(cited) and len(set(stated)) == len(stated)


def test_readme_is_short() -> None:
    assert len(README.splitlines()) <= 120


def test_the_calibration_of_the_manual_loads(tmp_path: Path) -> None:
    lines = page_text("files").splitlines()
    start = next(i for i, line in enumerate(lines) if line.strip() == "schema: twin.calibration/1")
    example = list(takewhile(lambda line: line.startswith("    "), lines[start:]))
    path = tmp_path / "c.yaml"
    path.write_text(textwrap.dedent("\n".join(example)))
    machine = Machine.load("dmu50")
    assert set(Calibration.load(path, machine).curves) == {"E_XX", "E_ZC"}


@pytest.mark.slow
def test_readme_runs_from_top_to_bottom(tmp_path: Path) -> None:
    """All commands behind the set-up (which `.ci/run` runs), one after the other in one folder, on what the ones before them left."""
    set_up = README.split("## Service technician")[0]
    calls = [call for place, call in CALLS if place == "README" and call not in set_up]
    assert len(calls) >= 8
    (tmp_path / "out").mkdir()
    for call in calls:
        words = [sys.executable, "-m", "twin.cli", *shlex.split(call)[1:]]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode in (0, 3), (call, done.stderr)
        # Status 3 is explained in the output: a row set aside, an error that the format cannot hold.
        assert done.returncode == 0 or done.stdout, call
        for word in shlex.split(call):
            if word.startswith("out/"):
                assert (tmp_path / word).exists(), call
