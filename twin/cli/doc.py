"""Command ``twin doc``."""

from __future__ import annotations

import importlib
import inspect
from typing import Annotated, Final

import typer

from twin._common.errors import InputError, closest_name
from twin.cli.shared.command import CommandResult, JsonOption, command

PAGES: Final = {
    "programs": "twin.compensation",
    "import": "twin.measurement.importing",
    "convert": "twin.measurement.formats",
    "identify": "twin.identification",
    "evaluate": "twin.standards",
    "thermal": "twin.thermal",
    "diagnose": "twin.diagnosis",
    "plan": "twin.planning",
    "report": "twin.reporting",
    "compare": "twin.comparison",
    "watch": "twin.watching",
    "control": "twin.control",
    "interferometer": "twin.identification.axis_run",
    "paths": "twin.compensation.fewer_blocks",
    "many": "twin.compute.parallel",
    "files": "twin._common.files",
    "datum": "twin.machine.datum",
    "curves": "twin.numerics.curves",
    "speed": "twin.compute.native",
}
"""Module whose docstring is the page of that name."""


@command("twin doc", "twin doc diagnose", "twin doc control")
def doc(
    page: Annotated[
        str | None,
        typer.Argument(
            help=f"One of {', '.join(PAGES)}; default: list all.",
            autocompletion=lambda incomplete: [name for name in PAGES if name.startswith(incomplete)],
        ),
    ] = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Show a page of the manual: methods, use and limits of one part of twin.

    The pages are docstrings of the package; in a notebook, `help(twin.diagnosis)` shows the same text.
    """
    if page is not None and page not in PAGES:
        raise InputError(
            "no such page", expected=f"one of {', '.join(PAGES)}", value=page, nearest=closest_name(page, PAGES)
        )
    pages = {name: page_text(module) for name, module in PAGES.items() if page in (None, name)}

    def show() -> None:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        from twin.cli.shared.manual import ManualPage

        console = Console()
        if page is not None:
            console.print(ManualPage(pages[page]))
            return
        table = Table.grid(padding=(0, 2))
        for name, text in pages.items():
            table.add_row(Text(f"twin doc {name}", no_wrap=True), Text(text.splitlines()[0]))
        console.print(table)

    return CommandResult("", lambda: {"schema": "twin.doc/1", "pages": pages}, written="", show=show)


def page_text(module: str) -> str:
    """Return the docstring of a module, without its indentation."""
    return inspect.cleandoc(importlib.import_module(module).__doc__ or "")
