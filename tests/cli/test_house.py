"""Rules of the project, checked by tools: lint, types, layers, and further limits."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(*command: str) -> str:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stdout + done.stderr


def tool(name: str) -> str:
    beside = Path(sys.executable).parent / name
    found = str(beside) if beside.exists() else shutil.which(name)
    if found is None:
        pytest.fail(f"{name} is not installed: the extra `test` brings it")
    return found


def test_lint() -> None:
    assert run(tool("ruff"), "check", ".") == ""


def test_format() -> None:
    assert run(tool("ruff"), "format", "--check", ".") == ""


@pytest.mark.slow
def test_types() -> None:
    assert run(tool("mypy")) == ""


def test_layers() -> None:
    assert run(tool("lint-imports")) == ""


@cache
def package_files() -> tuple[Path, ...]:
    return tuple(sorted((ROOT / "twin").rglob("*.py")))


@cache
def package_trees() -> tuple[ast.Module, ...]:
    return tuple(ast.parse(path.read_text()) for path in package_files())


MOST_LINES = 700
"""Limit of a module: the smaller one of before split single subjects into fragments."""


def test_modules_are_short() -> None:
    assert max(len(path.read_text().splitlines()) for path in package_files()) <= MOST_LINES


def test_no_function_beyond_80_lines() -> None:
    long = [
        node.name
        for tree in package_trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno >= 80
    ]
    assert long == []


def test_class_names_are_unique() -> None:
    names = [
        node.name
        for tree in package_trees()
        for node in tree.body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    assert [name for name in names if names.count(name) > 1] == []


def test_only_the_command_line_prints() -> None:
    package = ROOT / "twin"
    printing = {
        p.relative_to(package).parts[0] for p in package_files() if re.search(r"^\s*print\(", p.read_text(), re.M)
    }
    assert printing == {"cli"}


def test_no_assert_and_no_catch_all_in_the_package() -> None:
    pattern = re.compile(r"^\s*(assert |except( \(?(Base)?Exception\)?)?:)", re.M)
    assert [path.name for path in package_files() if pattern.search(path.read_text())] == []


def test_product_is_self_contained() -> None:
    """No file of the product refers to a folder outside the project."""
    files = [*package_files(), *(ROOT / "urdf").iterdir(), *(ROOT / "notebooks").glob("*"), ROOT / "README.md"]
    assert [path.name for path in files if path.is_file() and "../shared" in path.read_text(errors="replace")] == []
