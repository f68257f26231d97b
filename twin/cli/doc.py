"""``twin doc``."""

from __future__ import annotations

import importlib
import inspect
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.markdown import Markdown

from twin._common.errors import InputError, nearest
from twin.cli.shared.command import CommandResult, JsonOption, command

PAGES: Final = {
    "programs": "twin.compensation",
    "identify": "twin.identification",
    "diagnose": "twin.diagnosis",
    "plan": "twin.planning",
    "report": "twin.report",
    "compare": "twin.comparison",
    "control": "twin.machine.control",
    "interferometer": "twin.identification.axis_run",
    "paths": "twin.compensation.fewer_blocks",
    "many": "twin.compute.parallel",
    "files": "twin._common.files",
    "datum": "twin.machine.datum",
    "curves": "twin.numerics.curves",
    "speed": "twin.compute.native",
}
"""Longer than a README: what a room says of itself, by the name it is asked for."""


@command("twin doc", "twin doc diagnose", "twin doc control")
def doc(
    page: Annotated[
        str | None,
        typer.Argument(
            help=f"One of {', '.join(PAGES)}; all of them listed if none.",
            autocompletion=lambda incomplete: [name for name in PAGES if name.startswith(incomplete)],
        ),
    ] = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """A page of the manual: how one part works, what it is good for and what not.

    The pages are the docstrings of the package: the same in a notebook by `help(twin.diagnosis)`.
    """
    if page is not None and page not in PAGES:
        raise InputError(
            "no such page", expected=f"one of {', '.join(PAGES)}", value=page, nearest=nearest(page, PAGES)
        )
    pages = {name: page_text(room) for name, room in PAGES.items() if page in (None, name)}

    def show() -> None:
        console = Console()
        if page is not None:
            console.print(Markdown(pages[page]))
            return
        for name, text in pages.items():
            console.print(f"twin doc {name:<15} {text.splitlines()[0]}", markup=False, highlight=False)

    return CommandResult("", lambda: {"schema": "twin.doc/1", "pages": pages}, written="", show=show)


def page_text(room: str) -> str:
    """The docstring of a room, as it is printed."""
    return inspect.cleandoc(importlib.import_module(room).__doc__ or "")
