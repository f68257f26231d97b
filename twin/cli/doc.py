"""Command ``twin doc``."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING, Annotated, Final

import typer

from twin._common.errors import InputError, closest_name
from twin.cli.shared.command import CommandResult, JsonOption, command

if TYPE_CHECKING:
    from twin.model.effects import Specification

PAGES: Final = (
    *(
        "machine",
        "programs",
        "forecast",
        "parts",
        "import",
        "convert",
        "identify",
        "evaluate",
        "artefacts",
        "thermal",
        "diagnose",
        "plan",
        "report",
        "certificates",
        "compare",
        "confirm",
        "watch",
    ),
    *("control", "interferometer", "paths", "many", "files", "effects", "instruments", "datum", "curves", "speed"),
)
"""Names of the pages: `manual/NAME.md` beside this file."""


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

    The pages are Markdown files of the package, with the formats, bases and words that it knows now.
    """
    if page is not None and page not in PAGES:
        raise InputError(
            "no such page", expected=f"one of {', '.join(PAGES)}", value=page, nearest=closest_name(page, PAGES)
        )
    pages = {name: page_text(name) for name in PAGES if page in (None, name)}

    def show() -> None:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        from twin.cli.shared.terminal import ManualPage

        console = Console()
        if page is not None:
            console.print(ManualPage(pages[page]))
            return
        table = Table.grid(padding=(0, 2))
        for name, text in pages.items():
            table.add_row(Text(f"twin doc {name}", no_wrap=True), Text(text.splitlines()[0]))
        console.print(table)

    return CommandResult("", lambda: {"schema": "twin.doc/1", "pages": pages}, written=None, show=show)


def page_text(page: str) -> str:
    """Return a page of the manual, Markdown; in place of a line that is only a mark stand the rows of the package."""
    text = (resources.files("twin.cli") / "manual" / f"{page}.md").read_text(encoding="utf-8")
    for mark, rows in _listed(page).items():
        text = text.replace(f"\n{mark}\n", "\n" + "\n".join(rows) + "\n", 1)
    return text


def _listed(page: str) -> dict[str, list[str]]:
    """Return the rows in place of each mark of a page."""
    if page == "control":
        from twin.controls import kinematics_formats, table_formats

        return {
            "FORMATS": [
                f"| `{form.name}` {form.what} | {form.carries} | {form.leaves} | {form.defaults} |"
                for form in table_formats()
            ],
            "KINEMATICS": [
                f"| `{form.name}` {form.title}: {form.what} | {form.carries} | {form.leaves} |"
                for form in kinematics_formats()
            ],
        }
    if page == "artefacts":
        from twin.standards.artefacts import artefacts

        return {"ARTEFACTS": [f"| `{one.name}` | {one.shows} |" for one in artefacts()]}
    if page == "convert":
        from twin.measurement.formats import FORMATS
        from twin.measurement.formats.heidenhain import MASK

        formats = [form.specification for form in FORMATS]
        return {
            "FORMATS": [
                f"| `{one.name}` {one.title} | {' '.join(one.suffixes)} | {one.gives} | {one.needs or '(complete)'} |"
                for one in formats
            ],
            "    MASK": [f"    {MASK}"],
            "NOT VERIFIED": [
                f"- `{one.name}` ({one.source}): {'; '.join(one.unverified) or 'complete'}." for one in formats
            ],
        }
    if page == "import":
        from twin.measurement.importing.quantities import NAMES, ROLES

        phrases = {**ROLES, **NAMES}
        return {
            "VOCABULARY": [f"- {name}: {', '.join(sorted(filter(None, words)))}" for name, words in phrases.items()]
        }
    if page == "effects":
        from twin.model.effects import MACHINE_EFFECTS

        return {"EFFECTS": [_effect_row(machine_effect) for machine_effect in MACHINE_EFFECTS]}
    if page == "instruments":
        from twin.measurement.instruments import INSTRUMENTS

        readers = [instrument.specification for instrument in INSTRUMENTS]
        return {
            "INSTRUMENTS": [
                f"| `{reader.name}` | {reader.title} | {', '.join(reader.columns) or '(axis positions)'} | "
                f"{', '.join(reader.rides_on)} | {reader.source} |"
                for reader in readers
            ]
        }
    if page == "curves":
        from twin.numerics.curves import BASES

        return {"BASES": [f"- `{basis.name}`: {basis.formula}" for basis in BASES]}
    return {}


def _effect_row(one: Specification) -> str:
    fitted = ", ".join(name for name in one.parameters if name not in one.fixed)
    stated = ", ".join(f"{name}{_unit(unit)}" for name, unit in one.fixed.items())
    limits = []
    for unit, largest in one.limits.items():
        first = f"{one.least[unit]:g} to " if unit in one.least else "0 to " if one.non_negative else "±"
        limits.append(
            f"{first}{largest:.0f}{_unit(unit)}" if largest >= 100.0 else f"{first}{largest:.3g}{_unit(unit)}"
        )
    return f"| `{one.name}` | {one.plural} | {fitted or '—'} | {stated or '—'} | {', '.join(limits)} |"


def _unit(unit: str) -> str:
    from twin.diagnosis.result import readable_unit

    return "" if unit == "1" else f" {readable_unit(unit)}"
