"""Commands ``twin import`` and ``twin convert``: measured data of other programs."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.files import check_writable
from twin._common.units import count_with_noun
from twin.cli.shared import complete, options
from twin.cli.shared.command import EXISTING, POSITIVE, TABLE, CommandResult, JsonOption, command
from twin.cli.shared.complete import one_of
from twin.cli.shared.installation import BAD_INPUT
from twin.cli.shared.terminal import axis_values, three_numbers
from twin.samples import TABLES

if TYPE_CHECKING:
    from twin.machine.machine import Machine
    from twin.measurement.importing import ImportedTable

Files = Annotated[
    list[Path], typer.Argument(metavar="FILES", help="Files of one format, each one round or more."), EXISTING
]
FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format", help="Format of the files; default: recognised by their content.", **one_of("measured_formats")
    ),
]
AtOption = Annotated[
    list[str] | None,
    typer.Option("--at", help="Positions of axes that the files do not contain, mm and degrees: X=250 B=0."),
]
FileOffsetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--work-offset", help="Offset added to the files' coordinates to give axis positions: X=… Y=…; default: 0."
    ),
]
PlanOption = Annotated[
    Path | None,
    typer.Option("--plan", help="Plan with targets and commanded positions (tracker).", autocompletion=complete.plans),
]
AxisOption = Annotated[str | None, typer.Option("--axis", help="Measured axis; default: as the file says.")]
SphereOption = Annotated[
    float | None, typer.Option("--sphere-radius", help="Known radius of the spheres, mm; default: fitted."), POSITIVE
]
TipOption = Annotated[
    float | None, typer.Option("--tip-radius", help="Effective radius of the probe's tip, mm."), POSITIVE
]
KnownTipOption = Annotated[
    str | None,
    typer.Option(
        "--tip",
        help='Known place of the tip from the spindle nose, frame of the tool: "x,y,z" in mm; default: estimated.',
    ),
]
UncertaintyOption = Annotated[
    float | None,
    typer.Option(
        "--contact-uncertainty",
        help="Standard uncertainty of a contact, mm; default: from the residuals of all spheres.",
    ),
    POSITIVE,
]
ContactsOption = Annotated[
    int | None,
    typer.Option(
        "--contacts", min=4, help="Number of consecutive contacts with each sphere; default: all of one pose."
    ),
]
TraceOption = Annotated[
    str | None, typer.Option("--trace", help="Element that holds the readings of a ball bar; default: the only list.")
]
StartOption = Annotated[
    float, typer.Option("--start-angle", help="Angle of a circle's first reading, degrees from the plane's first axis.")
]
SweepOption = Annotated[float, typer.Option("--sweep", help="Angle that a circle's readings span, degrees."), POSITIVE]


@command(
    "twin convert contacts.csv -o measured.csv --contact-uncertainty 0.001 --json centres.json",
    "twin convert probe.txt -o measured.csv --work-offset X=250 Y=225 Z=-200",
    "twin convert x.rtl -o measured.csv --axis X --at Y=225 Z=-200 B=0 C=0",
    "twin convert circle.b5r -o measured.csv --at X=250 Y=225 Z=-200 B=0 C=0",
)
def convert(
    files: Files,
    output: Annotated[Path, typer.Option("--output", "-o", help="Measurement table to write."), TABLE],
    kind: FormatOption = None,
    machine: options.MachineOption = DEFAULT,
    plan: PlanOption = None,
    at: AtOption = None,
    work_offset: FileOffsetOption = None,
    axis: AxisOption = None,
    sphere_radius: SphereOption = None,
    tip_radius: TipOption = None,
    tip: KnownTipOption = None,
    contact_uncertainty: UncertaintyOption = None,
    contacts: ContactsOption = None,
    trace: TraceOption = None,
    start_angle: StartOption = 0.0,
    sweep: SweepOption = 360.0,
    json_file: JsonOption = None,
) -> CommandResult:
    """Convert measured data of other programs into a measurement table.

    Contacts of a probe, a ball bar, an interferometer, a tracker; `twin doc convert` describes the formats.
    """
    from twin.measurement.contacts import Probing
    from twin.measurement.formats import Given
    from twin.measurement.formats import convert as convert_files
    from twin.measurement.table import Measurements

    loaded = options.machine(machine)
    given = Given(
        at=axis_values("--at", at, loaded.names),
        offset=axis_values("--work-offset", work_offset, loaded.names),
        axis=axis,
        probing=Probing(
            sphere_radius,
            tip_radius,
            contact_uncertainty,
            None if tip is None else three_numbers("--tip", tip, tip, "x,y,z in mm"),
        ),
        contacts=contacts,
        plan=None if plan is None else Measurements.load(options.plan_file(plan), loaded, plan=True),
        trace=trace,
        start_deg=start_angle,
        sweep_deg=sweep,
    )
    conversion = convert_files(files, loaded, given, format_name=kind)
    conversion.save(output, loaded)
    return CommandResult(conversion.to_text(), conversion.to_dict)


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
PartProgramOption = Annotated[
    Path | None,
    typer.Option("--program", help="Program that cut the part, with --features.", autocompletion=complete.programs),
]
PartFeaturesOption = Annotated[
    Path | None,
    typer.Option("--features", help="Features and tools of a measured part (.yaml), with --program."),
    EXISTING,
]
MatchedPlanOption = Annotated[
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
    "twin import cmm.csv -o measured.csv --program part.nc --features part.yaml --tool-length 120",
    name="import",
)
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Table of measured points: CSV or Excel (.xlsx).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Measurement table to write."), TABLE],
    columns: ColumnsOption = None,
    sheet: SheetOption = None,
    plan: MatchedPlanOption = None,
    machine: options.MachineOption = DEFAULT,
    program: PartProgramOption = None,
    features: PartFeaturesOption = None,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Import a table of measured points: any CSV or Excel workbook, or a file that `twin convert` reads without its options.

    With --program and --features, the table is that of a part measured on a coordinate measuring machine: each point becomes a
    reading of the machine where the program cut it (`twin doc parts`).

    Delimiter, decimal sign, encoding, units and the meaning of the columns are found from the file. If nothing is assumed, the
    measurement table is written. Otherwise only a mapping is written, for a person to confirm, and the exit status is 2; the same
    command with --columns then applies it. `twin doc import` lists the words that are known.
    """
    if program is not None or features is not None:
        if program is None or features is None or columns is not None or plan is not None:
            raise InputError(
                "--program and --features belong together",
                expected="both, without --columns and --plan",
                value=program or features,
            )
        setup = work_offset, work_origin, offsets, tools
        cut = (program, features), machine, language, mode, tool_length, setup
        return _measured_part(file, sheet, output, *cut)
    path = options.bundled_sample(file, "table", "table of measured points", [table.name for table in TABLES])
    from twin.measurement.formats import other_format
    from twin.measurement.importing import import_table as run_import

    loaded = options.machine(machine)
    given = columns if columns is not None and columns.exists() else None
    points = None if plan is None else options.plan_file(plan)
    try:
        imported = run_import(path, loaded, columns=given, sheet=sheet, plan=points)
    except InputError:
        if given is not None or other_format(path) is None:
            raise
        return _converted(path, loaded, points, output)
    if imported.confirmed:
        imported.save(output)
        return CommandResult(imported.to_text(), imported.to_dict)
    proposal = columns if columns is not None and given is None else output.with_name(f"{output.name}.columns.yaml")
    if given is not None and proposal.exists():  # the lines given were completed
        proposal = output.with_name(f"{output.name}.columns.completed.yaml")
    return _proposed(imported, proposal, output, [sheet, plan, machine])


def _measured_part(
    file: Path,
    sheet: str | None,
    output: Path,
    cut: tuple[Path, Path],
    machine: str,
    language: str | None,
    mode: options.Mode,
    *run: Any,
) -> CommandResult:
    """Import a part that was measured on a coordinate measuring machine."""
    from twin.compensation.programs.prepared import Options
    from twin.nc import read_program
    from twin.part.features import PartDrawing
    from twin.part.measured import import_part

    loaded, (tool_length, setup) = options.machine(machine), run
    program, features = cut
    given = Options(setup=options.setup(loaded, *setup), tool_length_mm=tool_length, tcp=mode is options.Mode.tcp)
    part = PartDrawing(options.part_file(features))
    found = import_part(file, part, read_program(program, language), loaded, given, sheet=sheet)
    found.save(output, loaded)
    return CommandResult(found.to_text(), found.to_dict)


def _converted(path: Path, machine: Machine, plan: Path | None, output: Path) -> CommandResult:
    """Convert a file of another format, with what it says itself.

    Raises:
        InputError: it does not say enough; with the command that takes the rest.
    """
    from twin.measurement.formats import Given, convert
    from twin.measurement.table import Measurements

    try:
        conversion = convert(
            path, machine, Given(plan=None if plan is None else Measurements.load(plan, machine, plan=True))
        )
    except InputError as error:
        if error.setting is None:
            raise
        again = shlex.join(
            ["twin", "convert", str(path), "-o", str(output), *(f"--{one.strip()}" for one in error.setting.split(","))]
        )
        expected = f"{error.expected}: `{again} …`"
        raise InputError(error.what, expected=expected, file=error.file, line=error.line, value=error.value) from None
    conversion.save(output, machine)
    return CommandResult(conversion.to_text(), conversion.to_dict)


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
    return CommandResult(found.to_text(), found.to_dict, written=None, errors=(error,), status=BAD_INPUT)
