"""Command ``twin plan``, with the drift tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError, require_name
from twin._common.families import DRIFT_INSTRUMENTS, DRIFTS, INSTRUMENTS, SEQUENCE_INSTRUMENTS, Language
from twin._common.messages import Message, say
from twin._common.provenance import warning_texts, warnings_to_json
from twin._common.units import count_with_noun
from twin.cli.shared import complete, options
from twin.cli.shared.command import POSITIVE, TABLE, CommandResult, JsonOption, Output, command, progress_bar
from twin.cli.shared.paper import PrintedOption
from twin.cli.shared.terminal import not_negative, three_numbers

if TYPE_CHECKING:
    from twin.machine.machine import Machine
    from twin.measurement.table import Measurements
    from twin.model.calibration import Calibration
    from twin.planning import InstrumentSizes, Kit, Plan, SequencePlan

DriftOption = Annotated[
    str | None,
    typer.Option(
        "--drift",
        help="Plan a thermal test (ISO 230-3): {drifts}; --instrument: {drift_instruments}.",
        autocompletion=complete.drifts,
    ),
]
HighestOption = Annotated[
    float | None, typer.Option("--highest-rpm", help="Highest spindle speed, 1/min, with --drift spindle."), POSITIVE
]
SpectrumOption = Annotated[
    bool,
    typer.Option("--spectrum", help="Change the speed at random every 10 min, with --drift spindle; default: steps."),
]
AxisOption = Annotated[
    str | None, typer.Option("--axis", help="Linear or rotary axis that moves, with --drift axes; default: the first.")
]


@final
@dataclass(frozen=True)
class DriftRequest:
    """Options of a drift test: name, highest speed, spectrum, axis, feed, seed, program."""

    name: str | None
    highest_rpm: float | None
    spectrum: bool
    axis: str | None
    feed_mm_min: float | None
    seed: int
    program: Path | None = None

    def wanted(self, others: bool) -> bool:
        """Return whether a drift test is wanted; `InputError` for its options without its name, or beside those of another plan."""
        names = "|".join(DRIFTS)
        if self.name is None and (self.highest_rpm is not None or self.spectrum or self.axis is not None):
            raise InputError("--highest-rpm, --spectrum and --axis need --drift", expected=f"--drift {names}")
        if self.name is not None and others:
            raise InputError("--drift plans a thermal test", expected="no option of another plan", value=self.name)
        return self.name is not None

    def planned(
        self,
        machine: Machine,
        kit: Kit,
        instrument: str | None,
        spheres: list[str] | None,
        minutes: float | None,
        sizes: InstrumentSizes,
        output: Path | None,
    ) -> CommandResult:
        """Plan the drift test and write it."""
        from twin.planning.drift import drift_plan
        from twin.planning.programs.controls import format_of, write_program
        from twin.planning.programs.steps import drift_steps

        chosen = instrument or DRIFT_INSTRUMENTS[0]
        part = "sphere" if chosen == DRIFT_INSTRUMENTS[0] else "nest"
        places = {
            f"{part} {k + 1}": three_numbers("--spheres", text, text, "x,y,z in mm")
            for k, text in enumerate(spheres or [])
        }
        options = {name: getattr(self, name) for name in ("highest_rpm", "spectrum", "axis", "feed_mm_min", "seed")}
        made = drift_plan(
            machine,
            str(self.name),
            chosen,
            kit,
            places_mm=places or None,
            minutes=minutes,
            sizes=sizes,
            options=options,
        )
        text, report = made.to_text(), made.to_dict()
        if self.program is not None:
            language = format_of(self.program)
            steps = drift_steps(made)
            write_program(steps, self.program)
            report["program"] = {"file": str(self.program), "control": language.title}
            text += f"note: program for {language.title}, NOT RUN ON A MACHINE. {language.unverified if steps.probing else ''}\n"
        if output is not None:
            made.save(output)
        return CommandResult(text, lambda: report)


MINUTES = 210.0
MINUTES_TO_SEPARATE = 60.0
SEQUENCE_MINUTES = 60.0

PlanOutput = Annotated[
    Path | None, typer.Option("--output", "-o", help="Plan to write: a measurement table without coordinates."), TABLE
]
KitOption = Annotated[
    Path | None,
    typer.Option(
        "--kit",
        help="File of the available instruments and targets (schema twin.kit/1), or the bundled dmu50; default: an assumed kit.",
        autocompletion=complete.kits,
    ),
]
MinutesOption = Annotated[
    float | None,
    typer.Option(
        "--minutes", help="Time budget in minutes, including set-up; default: 210, or 60 with --separate or a sequence."
    ),
    POSITIVE,
]
ReduceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--reduce",
        help="Uncertainty to minimise: tool (default), everything (D-optimal), weakest (worst direction), or errors: E_C0Y E_*C.",
        autocompletion=complete.aims,
    ),
]
SeparateOption = Annotated[
    tuple[str, str] | None,
    typer.Option(
        "--separate",
        help='Two causes to distinguish, each in quotes: "reversal Y" "pitch_error X amplitude=2 period=10".',
        autocompletion=complete.causes,
    ),
]
AfterOption = Annotated[
    Path | None,
    typer.Option("--after", help="Table of previous measurements, with --separate.", autocompletion=complete.tables),
]
JudgeOption = Annotated[
    Path | None,
    typer.Option(
        "--judge",
        help="Evaluate this plan instead of making one: expected uncertainties and duration.",
        autocompletion=complete.plans,
    ),
]
InstrumentOption = Annotated[
    str | None,
    typer.Option(
        "--instrument",
        help="Plan a measuring sequence for {relative_instruments}; with --judge: {instruments}.",
        autocompletion=complete.instruments,
    ),
]
SequenceOption = Annotated[
    str | None,
    typer.Option(
        "--sequence", help="Measuring sequence, with --instrument: {sequences}.", autocompletion=complete.sequences
    ),
]
SpheresOption = Annotated[
    list[str] | None,
    typer.Option("--spheres", help='Spheres (nests, pivots) on the table, work frame: "x,y,z" in mm, several allowed.'),
]
SphereDiameterOption = Annotated[
    float | None,
    typer.Option("--sphere-diameter", help="Diameter of the calibration sphere, mm; default: 25."),
    POSITIVE,
]
BallDiameterOption = Annotated[
    float | None, typer.Option("--ball-diameter", help="Diameter of the stylus ball, mm; default: 6."), POSITIVE
]
ClearanceOption = Annotated[
    float | None,
    typer.Option("--clearance", help="Distance kept from the sphere before a contact, mm; default: 10."),
    POSITIVE,
]


RadiusOption = Annotated[
    float | None, typer.Option("--radius", help="Length of the ball bar, mm; default: 100."), POSITIVE
]
FeedOption = Annotated[
    float | None,
    typer.Option(
        "--feed",
        help="Feed with a ball bar, mm/min, default 1000; of the axis with --drift axes, default 5000 (rotary: degrees/min).",
    ),
    POSITIVE,
]
ConfirmOption = Annotated[
    Path | None,
    typer.Option(
        "--confirm",
        help="Folder that twin control wrote: make the shortest measurement that shows a wrong sign of any table or value in it.",
    ),
]
ArtefactOption = Annotated[
    str | None,
    typer.Option(
        "--artefact",
        help="Plan squareness and scale with simple means: {artefacts}.",
        autocompletion=complete.artefacts,
    ),
]
PlaneOption = Annotated[
    str | None,
    typer.Option("--plane", help="Two linear axes, with --artefact; default: XY, first axis along the datum."),
]
SizeOption = Annotated[
    str | None,
    typer.Option("--size", help='Lengths along both axes in mm, or of the artefact, with --artefact: "400,300".'),
]
PartOption = Annotated[
    list[str] | None,
    typer.Option(
        "--part",
        help="Program of a test part (its features: NAME.part.yaml), or `all` bundled ones: which shows the errors that matter most; "
        "-o: the points to measure.",
    ),
]
ProgramOption = Annotated[
    Path | None,
    typer.Option(
        "--program",
        help="Program for a touch probe or a drift test, untested: .ngc .nc (LinuxCNC), .h (HEIDENHAIN), .mpf (SINUMERIK).",
    ),
    Output((".ngc", ".nc", ".h", ".mpf")),
]


@command(
    "twin plan -o plan.csv --minutes 120",
    "twin plan -o plan.csv --kit dmu50 --reduce E_C0Y E_A0Z",
    'twin plan -o plan.csv --separate "cross_axis E_AX by Z" "cross_axis E_AY by Z" --after measured.csv',
    "twin plan --judge thesis_plan.csv --json judged.json",
    "twin plan --confirm tables -o check.csv --tool-length 120 --program check.mpf",
    "twin plan --instrument probe -o plan.csv --tool-length 120 --minutes 45",
    "twin plan --drift spindle --instrument displacement --highest-rpm 12000 --minutes 300 -o spindle.csv --program spindle.mpf",
    "twin plan --part all --tool-length 120 -o points.csv",
    "twin plan --artefact diagonals --plane XY -m router.yaml -o diagonals.csv",
    'twin plan --instrument probe --sequence turns -o plan.csv --tool-length 120 --spheres "150,0,60" --program probe.ngc',
)
def plan(
    output: PlanOutput = None,
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    kit: KitOption = None,
    minutes: MinutesOption = None,
    reduce: ReduceOption = None,
    causes: SeparateOption = None,
    confirm: ConfirmOption = None,
    after: AfterOption = None,
    judged: JudgeOption = None,
    instrument: InstrumentOption = None,
    sequence: SequenceOption = None,
    spheres: SpheresOption = None,
    sphere_diameter: SphereDiameterOption = None,
    ball_diameter: BallDiameterOption = None,
    clearance: ClearanceOption = None,
    radius: RadiusOption = None,
    feed: FeedOption = None,
    program_file: ProgramOption = None,
    drift: DriftOption = None,
    highest_rpm: HighestOption = None,
    spectrum: SpectrumOption = False,
    axis: AxisOption = None,
    artefact: ArtefactOption = None,
    plane: PlaneOption = None,
    size: SizeOption = None,
    part: PartOption = None,
    tool_length: options.ToolOption = None,
    seed: Annotated[int, typer.Option("--seed", help="Random seed of the candidate poses, or of the speeds.")] = 0,
    json_file: JsonOption = None,
    lang: PrintedOption = Language.en,
) -> CommandResult:
    """Plan the measurement that gives the smallest uncertainty in the available time."""
    not_negative("--seed", seed)
    if (output is None) is (judged is None):
        raise InputError("no output, or two outputs", expected="either -o PLAN.csv or --judge PLAN.csv")
    _check_combination(after, causes, reduce, instrument)
    if confirm is not None and (causes or reduce or judged or sequence or drift or calibration):
        raise InputError("--confirm plans by itself", expected="no other aim or calibration", value=confirm)
    test = DriftRequest(drift, highest_rpm, spectrum, axis, feed, seed, program_file)
    for_drift = test.wanted(bool(causes or reduce or judged or sequence or radius))
    if instrument is not None and not for_drift:
        require_name("instrument", instrument, INSTRUMENTS)
    from twin.planning import Kit
    from twin.planning.kit import bundled_kit
    from twin.planning.sequences.specification import InstrumentSizes

    loaded = options.machine(machine)
    if part or artefact is not None or plane is not None or size is not None:
        others = (causes, reduce, judged, sequence, instrument, drift, confirm, kit, minutes, program_file)
        sheet = artefact, loaded, plane, size, output
        return _for_part_or_artefact(part, sheet, calibration, tool_length, alone=not any(others))
    own = Kit.default(loaded) if kit is None else Kit.load(bundled_kit(kit), loaded)
    if confirm is not None:
        sizes = _sizes(sphere_diameter, ball_diameter, clearance, radius, feed)
        asked = _SequenceRequest(instrument, None, spheres, sizes, program_file)
        return asked.to_confirm(confirm, loaded, None if kit is None else own, tool_length, minutes, seed, output)
    errors = options.calibration_of(calibration, loaded)
    if for_drift:
        own_sizes = InstrumentSizes(tool_length, **_sizes(sphere_diameter, ball_diameter, clearance, None, None))
        return test.planned(loaded, own, instrument, spheres, minutes, own_sizes, output)
    sizes = _sizes(sphere_diameter, ball_diameter, clearance, radius, feed)
    request = _SequenceRequest(instrument, sequence, spheres, sizes, program_file)
    for_sequence = request.wanted(judged is not None)
    if judged is not None:
        return _judged(judged, loaded, own, errors, instrument, tool_length)
    if for_sequence:
        return request.planned(loaded, own, tool_length, minutes, seed, output)
    made = _made(loaded, own, errors, minutes, reduce, causes, after, tool_length, seed)
    if output is not None:
        made.save(output)
    return CommandResult(made.to_text(), made.to_dict, met=made.complete)


def _for_part_or_artefact(
    part: list[str] | None, sheet: Any, calibration: Path | None, tool_length_mm: float | None, *, alone: bool
) -> CommandResult:
    """Compare test parts, or write the sheet of an artefact."""
    artefact, loaded, plane, size, output = sheet
    if not part:
        return _with_artefact(*sheet, alone=alone and calibration is None)
    errors = options.calibration_of(calibration, loaded)
    return _with_parts(part, loaded, errors, tool_length_mm, output, alone=alone and not (artefact or plane or size))


def _with_parts(
    names: list[str],
    machine: Machine,
    errors: Calibration,
    tool_length_mm: float | None,
    output: Path | None,
    *,
    alone: bool,
) -> CommandResult:
    """Compare test parts, and write the points to measure of the one that shows most."""
    from twin._common.bundled import find_program
    from twin.compensation.programs.prepared import Options
    from twin.planning.parts import compare_parts
    from twin.samples import PARTS

    if not alone or output is None:
        raise InputError(
            "--part plans by itself", expected="only -m, -c, --tool-length and -o beside it", value=names[0]
        )
    if names == ["all"]:
        names = [f"{name}.nc" for name in PARTS]
    programs = [find_program(name) for name in names]
    parts = [(program, options.part_file(program.with_suffix(".part.yaml"))) for program in programs]
    with progress_bar() as bar:
        bar("test parts", 0.0)
        found = compare_parts(parts, machine, errors, Options(tool_length_mm=tool_length_mm))
    found.parts[0].save(output)
    return CommandResult(found.to_text(), found.to_dict)


def _with_artefact(
    name: str | None, machine: Machine, plane: str | None, size: str | None, output: Path | None, *, alone: bool
) -> CommandResult:
    """Write the sheet of an artefact, to be filled in."""
    if name is None:
        raise InputError("--plane and --size need --artefact", expected="one of the artefacts", value=plane or size)
    if not alone:
        raise InputError("--artefact plans by itself", expected="only --plane, --size, -m and -o beside it", value=name)
    plane = plane or "XY"
    from twin._common.files import write_atomic
    from twin.standards.artefacts import artefact_named, plan_sheet

    try:
        sizes = tuple(float(part) for part in size.split(",")) if size else ()
    except ValueError:
        raise InputError("--size is not one or two lengths", expected='"400,300" in mm', value=size) from None
    text, steps = plan_sheet(machine, name, plane, sizes)
    own = artefact_named(name)
    if output is not None:
        write_atomic(output, text)
    head = Message(
        "{title} in {plane} of {machine}: {shows}", title=own.title, plane=plane, machine=machine.name, shows=own.shows
    )
    lines = [say(head), ""]
    lines += [f"  {k}. {say(step)}" for k, step in enumerate(steps, start=1)]
    lines += [
        "",
        say("The sheet states what the uncertainty needs. Correct what is marked (assumed), enter the readings, then:"),
        f"  twin evaluate {output} -m {machine.path} -o mine.yaml",
    ]
    report = {"schema": "twin.plan/1", "artefact": name, "plane": plane, "steps": list(steps)}
    return CommandResult("\n".join(lines) + "\n", lambda: report)


def _made(
    machine: Machine,
    kit: Kit,
    errors: Calibration,
    minutes: float | None,
    reduce: list[str] | None,
    causes: tuple[str, str] | None,
    after: Path | None,
    tool_length_mm: float | None,
    seed: int,
) -> Plan:
    """Return the plan for reflectors: the smallest uncertainty, or two causes distinguished."""
    from twin.measurement.table import Measurements
    from twin.planning import plan as make_plan
    from twin.planning import separate

    with progress_bar() as bar:
        if causes is not None:
            return separate(
                machine,
                *causes,
                kit,
                minutes=MINUTES_TO_SEPARATE if minutes is None else minutes,
                calibration=errors,
                after=None if after is None else Measurements.load(after, machine),
                seed=seed,
                progress=bar,
            )
        return make_plan(
            machine,
            kit,
            minutes=MINUTES if minutes is None else minutes,
            reduce=reduce or "tool",
            expected=errors,
            tool_length_mm=tool_length_mm,
            seed=seed,
            progress=bar,
        )


def _sizes(*given: float | None) -> dict[str, float]:
    names = ("sphere_mm", "ball_mm", "clearance_mm", "bar_mm", "feed_mm_min")
    return {name: value for name, value in zip(names, given, strict=True) if value is not None}


def _check_combination(
    after: Path | None, causes: tuple[str, str] | None, reduce: list[str] | None, instrument: str | None
) -> None:
    if after is not None and causes is None:
        raise InputError("--after needs --separate", expected="two causes to distinguish", value=after)
    if causes is not None and reduce:
        raise InputError("--separate and --reduce exclude each other", expected="one of them", value=" ".join(reduce))
    if instrument in SEQUENCE_INSTRUMENTS and (causes is not None or reduce):
        raise InputError("--instrument plans a sequence", expected="no --separate and no --reduce", value=instrument)


@final
@dataclass(frozen=True)
class _SequenceRequest:
    """Options of a measuring sequence: instrument, name, places on the table, sizes, program to write."""

    instrument: str | None
    sequence: str | None
    spheres: list[str] | None
    sizes: Mapping[str, float]
    program: Path | None

    def wanted(self, judged: bool) -> bool:
        """Return whether a sequence is wanted; `InputError` for its options without its instrument, or if a plan is judged."""
        given = self.sequence is not None or bool(self.spheres or self.sizes) or self.program is not None
        if judged and given:
            raise InputError("--judge evaluates an existing plan", expected="no option of a measuring sequence")
        own = self.instrument in SEQUENCE_INSTRUMENTS
        if given and not own:
            expected = f"--instrument {' or '.join(SEQUENCE_INSTRUMENTS)}"
            raise InputError("a measuring sequence needs its instrument", expected=expected, value=self.instrument)
        return own and not judged

    def planned(
        self,
        machine: Machine,
        kit: Kit,
        tool_length_mm: float | None,
        minutes: float | None,
        seed: int,
        output: Path | None,
    ) -> CommandResult:
        """Plan the sequence and write it."""
        from twin.measurement.instruments import instrument_named
        from twin.planning import measuring_sequence
        from twin.planning.sequences.specification import SET_UPS, InstrumentSizes

        instrument = instrument_named(str(self.instrument))
        words = SET_UPS[instrument.name]
        name = words.target if instrument.specification.reads == "null" else words.station
        made = measuring_sequence(
            machine,
            instrument,
            self.sequence,
            kit,
            places_mm=self._places(name),
            minutes=SEQUENCE_MINUTES if minutes is None else minutes,
            sizes=InstrumentSizes(tool_length_mm, **self.sizes),
            seed=seed,
        )
        report = {**made.to_dict(), **self._program(made)}
        if output is not None:
            made.save(output)
        return CommandResult(made.to_text() + report.pop("note"), lambda: report, met=not report["not_probed"])

    def to_confirm(
        self,
        folder: Path,
        machine: Machine,
        kit: Kit | None,
        tool_length_mm: float | None,
        minutes: float | None,
        seed: int,
        output: Path | None,
    ) -> CommandResult:
        """Plan the shortest measurement that shows what `twin control` wrote, and write it."""
        from twin.model.calibration import Calibration
        from twin.monitoring.written import active_tool_mm, written_by
        from twin.planning import SequencePlan
        from twin.planning.confirmation import plan_confirmation
        from twin.planning.sequences.specification import InstrumentSizes

        if self.instrument not in (None, "probe"):
            raise InputError("no such instrument for --confirm", expected="probe, or a --kit", value=self.instrument)
        calibration = Calibration.load(folder / "calibration.yaml", machine)
        length = active_tool_mm(machine, calibration, tool_length_mm)
        with progress_bar() as bar:
            made = plan_confirmation(
                calibration,
                written_by(calibration, length),
                kit,
                probe=True if self.instrument or self.spheres or self.sizes or self.program else None,
                spheres_mm=self._places("sphere"),
                sizes=InstrumentSizes(length or None, **self.sizes),
                minutes=minutes,
                seed=seed,
                progress=bar,
            )
        report = {**made.to_dict(), **(self._program(made.plan) if isinstance(made.plan, SequencePlan) else {})}
        if output is not None:
            made.plan.save(output)
        text = made.plan.to_text() + report.pop("note", "") + "\n".join(map(say, made.lines())) + "\n"
        met = not report["not_probed"] if isinstance(made.plan, SequencePlan) else made.plan.complete
        return CommandResult(text, lambda: report, met=met and made.shown and not made.hidden)

    def _places(self, name: str) -> dict[str, tuple[float, float, float]] | None:
        """Return the places of the parts on the table, by name; None if none are given."""
        places = {
            f"{name} {k + 1}": three_numbers("--spheres", text, text, "x,y,z in mm")
            for k, text in enumerate(self.spheres or [])
        }
        return places or None

    def _program(self, made: SequencePlan) -> dict[str, Any]:
        """Write the program, if one is wanted; return entries of the report, with the note of the text."""
        from twin.planning.programs.controls import format_of, write_program
        from twin.planning.programs.steps import program_steps

        if self.program is None:
            return {"note": "", "program": None, "not_probed": []}
        language = format_of(self.program)
        steps = program_steps(made)
        said = Message(
            "note: program for {title}: {count} poses, NOT RUN ON A MACHINE. {unverified}",
            title=language.title,
            count=steps.poses,
            unverified=language.unverified,
        )
        note = f"{say(said)}\n"
        if steps.skipped:
            poses = ", ".join(map(str, steps.skipped))
            note += say(Message("note: NOT PROBED for lack of clearance: poses {poses}", poses=poses)) + "\n"
        write_program(steps, self.program)
        program = {"file": str(self.program), "control": language.title}
        return {"note": note, "program": program, "not_probed": list(steps.skipped)}


def _judged_sequence(plan: Path, machine: Machine, kit: Kit, table: Measurements) -> CommandResult:
    """Evaluate a given measuring sequence: duration, and what it determines of the constant errors."""
    from twin.measurement.columns import grouped_notes
    from twin.planning import judge_sequence
    from twin.planning.sequences.specification import minutes_of

    expected = judge_sequence(table, machine)
    minutes = minutes_of(machine, kit, table)
    lines = [
        f"{plan}: {count_with_noun(len(table), 'pose')} with {table.instrument[0]}, {minutes:.0f} minutes\n",
        *expected.lines(),
        *(f"  set aside, {text}" for text in grouped_notes(table.set_aside)),
    ]
    report = {"schema": "twin.plan/1", "judged": str(plan), "minutes": minutes, "constant_errors": expected.to_dict()}
    return CommandResult("\n".join(lines) + "\n", lambda: report, met=not table.set_aside)


def _judged(
    plan: Path, machine: Machine, kit: Kit, errors: Calibration, named: str | None, tool_length_mm: float | None
) -> CommandResult:
    """Evaluate a given plan: expected uncertainties and duration."""
    from twin.measurement.columns import grouped_notes
    from twin.measurement.instruments import INSTRUMENTS, instrument_named
    from twin.measurement.table import Measurements
    from twin.planning import duration, judge
    from twin.planning.sequences.specification import SET_UPS

    instrument = named or INSTRUMENTS[0].name
    reader = instrument_named(instrument)
    table = Measurements.load(options.plan_file(plan), machine, plan=True)
    if set(table.instrument.astype(str)) & set(SET_UPS):
        return _judged_sequence(plan, machine, kit, table)
    with progress_bar() as bar:
        bar("judging", 0.0)
        forecast = judge(
            table, machine, instrument=reader, expected=errors, known=kit.known, tool_length_mm=tool_length_mm
        )
    minutes = duration(machine, kit, table) / 60.0
    lines = [
        f"{plan}: {count_with_noun(len(table), 'reading')} with {instrument}, {minutes:.0f} minutes according to the kit\n",
        *(f"expected errors: {text}" for text in warning_texts(errors.warnings)),
        forecast.to_text() + "".join(f"  set aside, {text}\n" for text in grouped_notes(table.set_aside)),
    ]
    report = {
        "schema": "twin.plan/1",
        "judged": str(plan),
        "minutes": minutes,
        "forecast": forecast.to_dict(),
        "warnings": warnings_to_json(errors.warnings),
    }
    return CommandResult("\n".join(lines), lambda: report, met=not table.set_aside)
