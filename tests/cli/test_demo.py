"""The first look at twin: one folder, made by the documented commands, whose numbers are those of its files."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import pytest

from tests.cli.commands import twin
from twin._common.errors import OutputError
from twin.cli import demo


def test_an_existing_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "mine.txt").write_text("mine")
    ended = twin("demo", "-o", "kept", cwd=tmp_path)
    assert ended.returncode == 2 and "kept: already exists; expected the name of a new folder, or of" in ended.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["kept", "mine.txt"]


def test_a_command_that_fails_is_said_and_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "STEPS", (demo.ExampleStep("none", "info --machine nowhere", ()),))
    with pytest.raises(OutputError, match=r"twin info --machine nowhere: exit status 2: twin: .*nowhere"):
        demo.demo(tmp_path / "new")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_page_says_what_its_files_say(tmp_path: Path) -> None:
    ended = twin("demo", "--json", "demo.json", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    folder = tmp_path / "twin-demo"
    page = (folder / "index.html").read_text()
    linked = re.findall('<a href="([^"]+)">', page)
    assert twin("demo", cwd=tmp_path).returncode == 0, "an earlier demo is replaced"
    assert len(linked) > 8 and all((folder / name).stat().st_size > 0 for name in linked)
    assert all(f"twin {step.words}" in page for step in demo.STEPS)
    found, later = (json.loads((folder / f"{name}.json").read_text()) for name in ("diagnosis", "later"))
    (cause,) = found["causes"]
    (size,) = cause["parameters"]
    effect, where, numbers = demo.HIDDEN
    assert (cause["effect"], cause["where"], found["verdict"]) == (effect, where, "explained")
    assert abs(size["value"] - numbers["size"]) < 2.0 * size["u"]
    assert later["verdict"] == "consistent"
    for figure in (found["residual"]["rms_um"], later["residual"]["rms_um"]):
        assert f"{figure:.1f} µm" in " ".join(unescape(page).split())
