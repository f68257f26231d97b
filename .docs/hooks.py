"""Functions that mkdocs calls while it builds the site: pages made from the package itself, so that nothing is written twice.

Generated: the manual and the reference of files from the pages of `twin doc`, the commands from their `--help`, the API from
`twin.__all__`, the course from the notebooks (executed here), and the package diagram from the layers in pyproject.toml.
"""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

import twin
from twin.cli.commands import COMMANDS, load
from twin.cli.doc import PAGES, page_text

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / ".pictures"
BOX_WIDTH, BOX_HEIGHT, GAP = 150, 34, 16


def on_files(files: Files, config: Any) -> Files:
    """Add every generated page and picture."""
    for path, content in generated():
        files.append(File.generated(config, path, content=content))
    return files


def generated() -> Iterator[tuple[str, str | bytes]]:
    """Yield the path and the content of every generated file."""
    for name in PAGES:
        path = "reference/files.md" if name == "files" else f"manual/{name}.md"
        yield path, manual_page(name)
    yield "reference/api.md", api_page()
    yield "reference/commands.md", commands_page()
    yield "development/packages.svg", package_diagram()
    for picture in sorted(PICTURES.glob("*.png")):
        yield f"pictures/{picture.name}", picture.read_bytes()
    with ThreadPoolExecutor(2) as pool:  # each executes in a process of its own
        for pages in pool.map(course_pages, sorted((ROOT / "notebooks").glob("*.ipynb"))):
            yield from pages


def manual_page(name: str) -> str:
    """Return a page of `twin doc` with a title."""
    return f"# {name.capitalize()}\n\n{page_text(name)}\n*In a terminal: `twin doc {name}`.*\n"


def api_page() -> str:
    """Return the reference of every name that `import twin` gives: classes, functions, modules."""
    values = {name: getattr(twin, name) for name in twin.__all__ if not name.startswith("_")}
    groups = {"Classes": inspect.isclass, "Functions": inspect.isfunction, "Modules": inspect.ismodule}
    parts = [
        "# API\n\n`import twin` gives every name on this page; each is imported when it is first used. Arrays are (n, axes) in"
        " command order, in mm and degrees, and read-only in results. The examples begin with `import numpy as np` and `import twin`.\n"
    ]
    for title, belongs in groups.items():
        parts.append(f"## {title}\n")
        for name, value in values.items():
            if belongs(value):
                path = value.__name__ if inspect.ismodule(value) else f"{value.__module__}.{value.__qualname__}"
                parts.append(
                    f"### twin.{name}\n\n::: {path}\n    options: {{show_root_heading: false, heading_level: 4}}\n"
                )
    return "\n".join(parts)


def commands_page() -> str:
    """Return the reference of all commands: arguments and options with their help, and examples."""
    parts = ["# Commands\n\nExit status: 0 done; 2 bad input; 3 done, but something that matters was not met.\n"]
    for name, summary in COMMANDS.items():
        command = load(name)
        parts.append(f"## twin {name}\n\n{summary}\n\n{command.help or ''}\n")
        rows = [
            f"| `{' '.join(one.opts) or one.name}` | {cell(getattr(one, 'help', None))} | {default(one)} |"
            for one in command.params
        ]
        parts.append("\n".join(["| option or argument | meaning | default |", "|---|---|---|", *rows, ""]))
        examples = [line.strip() for line in (command.epilog or "").splitlines() if line.strip().startswith("twin ")]
        parts.append("\n".join(["```sh", *examples, "```", ""]) if examples else "")
    return "\n".join(parts)


def cell(text: str | None) -> str:
    """Return a text that fits a cell of a table."""
    return escape(text or "", quote=False).replace("|", "\\|").replace("\n", " ")


def default(parameter: Any) -> str:
    """Return a parameter's default as text."""
    value = parameter.default
    if parameter.required or value is None or callable(value) or value == ():
        return "required" if parameter.required else ""
    return cell(f"{getattr(value, 'value', value)}")


def package_diagram() -> str:
    """Return the packages by import level as SVG, from the layers contract in pyproject.toml."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    levels = [
        level.split(" | ") for level in next(one for one in contracts if one.get("containers") == ["twin"])["layers"]
    ]
    width = max(map(len, levels)) * (BOX_WIDTH + GAP) + GAP
    height = len(levels) * (BOX_HEIGHT + GAP) + GAP
    shapes = []
    for row, names in enumerate(levels):
        left = (width - len(names) * (BOX_WIDTH + GAP) + GAP) / 2
        for column, name in enumerate(names):
            x, y = left + column * (BOX_WIDTH + GAP), GAP + row * (BOX_HEIGHT + GAP)
            shapes.append(
                f'<rect x="{x:g}" y="{y}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="5" fill="#eceff1" stroke="#546e7a"/>'
            )
            shapes.append(f'<text x="{x + BOX_WIDTH / 2:g}" y="{y + 22}" text-anchor="middle">{name}</text>')
    style = "font-family: sans-serif; font-size: 14px; fill: #263238"
    size = f'viewBox="0 0 {width} {height}" width="{width}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} style="{style}">{"".join(shapes)}</svg>'


def course_pages(path: Path) -> list[tuple[str, str | bytes]]:
    """Execute a notebook in an empty folder; return its page and its pictures."""
    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}}).execute()
    text, resources = MarkdownExporter().from_notebook_node(notebook, {"output_files_dir": path.stem})
    text = re.sub(r"\]\((\w+)\.ipynb\b", r"](\1.md", text)
    pictures = [(f"course/{name}", content) for name, content in resources.get("outputs", {}).items()]
    return [(f"course/{path.stem}.md", without_blank_lines_in_html(text)), *pictures]


def without_blank_lines_in_html(text: str) -> str:
    """Return Markdown whose HTML outputs are one block each: a blank line would end the block."""

    def joined(match: re.Match[str]) -> str:
        return re.sub(r"\n\s*", "\n", match.group())

    return re.sub(r"^<(div|style|table|svg)\b.*?^</\1>", joined, text, flags=re.M | re.S)
