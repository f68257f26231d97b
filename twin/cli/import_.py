"""Command ``twin import``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.files import check_writable
from twin._common.units import count_with_noun
from twin.cli.shared import complete, options
from twin.cli.shared.command import TABLE, CommandResult, JsonOption, command
from twin.cli.shared.installation import BAD_INPUT
from twin.samples import TABLES

if TYPE_CHECKING:
    from twin.measurement.importing import ImportedTable

ColumnsOption = Annotated[
    Path | None,
    typer.Option(
        "--columns",
        help="Mapping file: applied if it exists; else the proposed mapping is written to it. Default: OUTPUT.columns.yaml, for "
        "the proposal.",
    ),
]
SheetOption = Annotated[
    str | None, typer.Option("--sheet", help="Sheet of a workbook; default: the only one that is not empty.")
]
PlanOption = Annotated[
    Path | None,
    typer.Option(
        "--plan",
        help="Plan with the commanded positions, for a file without them: matched by names of points, or by order.",
        autocompletion=complete.plans,
    ),
]


@command(
    "twin import shop_table.csv -o measured.csv",
    "twin import export.csv -o measured.csv --columns export.columns.yaml",
    "twin import export.xlsx -o measured.csv --sheet Messung --plan plan.csv --json imported.json",
    name="import",
)
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Table of measured points: CSV or Excel (.xlsx).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Measurement table to write."), TABLE],
    columns: ColumnsOption = None,
    sheet: SheetOption = None,
    plan: PlanOption = None,
    machine: options.MachineOption = DEFAULT,
    json_file: JsonOption = None,
) -> CommandResult:
    """Import a table of measured points: any CSV or Excel workbook.

    Delimiter, decimal sign, encoding, units and the meaning of the columns are found from the file. If nothing is assumed, the
    measurement table is written. Otherwise only a mapping is written, for a person to confirm, and the exit status is 2; the same
    command with --columns then applies it. `twin doc import` lists the words that are known.
    """
    path = options.bundled_sample(file, "table", "table of measured points", [table.name for table in TABLES])
    from twin.measurement.importing import import_table as run_import

    loaded = options.machine(machine)
    given = columns if columns is not None and columns.exists() else None
    imported = run_import(
        path, loaded, columns=given, sheet=sheet, plan=None if plan is None else options.plan_file(plan)
    )
    if imported.confirmed:
        imported.save(output)
        return CommandResult(imported.to_text(), imported.to_dict)
    proposal = columns if columns is not None and given is None else output.with_name(f"{output.name}.columns.yaml")
    if given is not None and proposal.exists():  # the lines given were completed
        proposal = output.with_name(f"{output.name}.columns.completed.yaml")
    return _proposed(imported, proposal, output, [sheet, plan, machine])


def _proposed(found: ImportedTable, path: Path, output: Path, others: list[object]) -> CommandResult:
    """Write the proposed mapping, unless one exists (`InputError`), and return a result that asks for its confirmation."""
    sheet, plan, machine = others
    words = ["twin", "import", found.source, "-o", str(output), "--columns", str(path)]
    words += [] if sheet is None else ["--sheet", str(sheet)]
    words += [] if plan is None else ["--plan", str(plan)]
    words += [] if machine == DEFAULT else ["--machine", str(machine)]
    again = shlex.join(words)
    count = count_with_noun(len(found.to_confirm), "item")
    if path.exists():
        raise InputError(
            f"{count} to confirm, and a mapping exists",
            expected="that mapping, or another file",
            file=path,
            setting="columns",
        )
    check_writable([path])
    found.save_columns(path, next_step=again)
    error = (
        f"twin: {found.source}: no table written: {count} to confirm in {path}; expected a confirmed mapping: {again}"
    )
    return CommandResult(found.to_text(), found.to_dict, written="", errors=(error,), status=BAD_INPUT)
