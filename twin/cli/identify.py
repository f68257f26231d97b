"""Command ``twin identify``."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError, closest_name, require_name
from twin._common.families import INSTRUMENTS
from twin._common.files import scratch_folder, write_atomic
from twin.cli.shared import complete, options
from twin.cli.shared.command import CALIBRATION, HTML, CommandResult, JsonOption, command, progress_bar

if TYPE_CHECKING:
    from twin.controls import ControlSection
    from twin.machine.machine import Machine
    from twin.measurement.certificate import Artefact
    from twin.measurement.table import Measurements


TABLES_ACTIVE = (
    "\nThese errors were measured with the control's tables active: keep them active, and add new tables to them "
    "(twin control --add).\n"
)
MODULE_ACTIVE = (
    "\nMeasured with a kinematics module active: twin control --add makes one that corrects the old errors and these.\n"
)


class UncertaintyChoice(StrEnum):
    """Source of the noise from which uncertainties are computed."""

    stated = "stated"
    repeats = "repeats"
    between_poses = "between poses"
    between_rounds = "between rounds"


INSTRUMENT_OPTIONS = (
    "\nThe instrument is named by --instrument, or in the table's column instrument; "
    "the noise comes from repeats with --uncertainty repeats.\n"
)
InstrumentOption = Annotated[
    str | None,
    typer.Option(
        "--instrument",
        help="Instrument: {instruments}; default: the table's column instrument, else what the readings indicate.",
        autocompletion=complete.instruments,
    ),
]
UncertaintyOption = Annotated[
    UncertaintyChoice,
    typer.Option(
        "--uncertainty",
        help="Noise that the uncertainties are computed from: as stated, unless repeats contradict it; of repeats; or between poses or "
        "rounds, which includes what the model does not describe.",
    ),
]
OnlyOption = Annotated[
    list[str] | None,
    typer.Option(
        "--only",
        help="Errors to identify; * for any letters: E_*X E_C0Y E_*0C; default: all.",
        autocompletion=complete.errors,
    ),
]
ControlOption = Annotated[
    list[str] | None,
    typer.Option(
        "--control",
        help="FORMAT=FILE of a compensation table active in the control during the measurement, or of the calibration.yaml of an "
        "active kinematics module; repeatable (twin doc control).",
    ),
]
CertificateOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--certificate",
        help="Digital calibration certificate (DCC, XML) of an artefact whose spheres are targets: known distances or coordinates, "
        "with their covariance; repeatable (twin doc certificates).",
    ),
]
ArtefactTemperatureOption = Annotated[
    float | None,
    typer.Option(
        "--artefact-temperature",
        metavar="DEGC",
        help="Temperature of the artefacts, °C: their certificates' values are those at 20 °C; default: the mean of the column "
        "T_artefact_degC, else 20.",
    ),
]


@command(
    "twin identify measured.csv -o mine.yaml --json identified.json --html identified.html",
    "twin identify measured.csv -o x.yaml --only E_*X",
    "twin identify measured.csv -o mine.yaml --uncertainty 'between poses'",
    "twin identify measured.csv -o mine.yaml --certificate ball_plate.xml",
    "twin identify measured.csv -o left.yaml --control linuxcnc=X.comp --control linuxcnc=joints.ini",
    "twin identify measured.csv -o left.yaml --control linuxcnc-kinematics=live/calibration.yaml",
)
def identify(
    measured: options.MeasuredArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Calibration file to write."), CALIBRATION],
    machine: options.MachineOption = DEFAULT,
    instrument: InstrumentOption = None,
    noise_source: UncertaintyOption = UncertaintyChoice.stated,
    only: OnlyOption = None,
    control: ControlOption = None,
    certificate: CertificateOption = None,
    artefact_temperature: ArtefactTemperatureOption = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the report to this HTML file."), HTML] = None,
) -> CommandResult:
    """Identify error motions, squareness and axis locations, with uncertainties, from measured points."""
    if instrument is not None:
        require_name("instrument", instrument, INSTRUMENTS)
    from twin.identification import identify as run_identification
    from twin.measurement.instruments import instrument_named
    from twin.measurement.table import Measurements
    from twin.model.calibration import Calibration
    from twin.reporting.identified import Identified

    if html_file is not None:
        options.need_pictures("the HTML report")
    loaded = options.machine(machine)
    names = (*loaded.motion_names, *loaded.squareness_names, *loaded.location_names)
    for pattern in only or []:
        if not fnmatch.filter(names, pattern):
            raise InputError(
                "--only matches no error of this machine",
                expected=f"among {', '.join(names)}",
                value=pattern,
                nearest=closest_name(pattern, names),
            )
    tables = tables_on(control, loaded) if control else None
    with progress_bar() as bar:
        bar("reading", 0.0)
        data = Measurements.join([Measurements.load(path, loaded) for path in measured])
        if tables is not None and tables.live:
            _check_relative(data)
        identification = run_identification(
            data,
            loaded,
            instrument=None if instrument is None else instrument_named(instrument),
            wanted=lambda name: only is None or any(fnmatch.fnmatchcase(name, pattern) for pattern in only),
            spread=noise_source.value,
            artefacts=_artefacts(certificate or [], data, artefact_temperature),
            progress=bar,
        )
    calibration = identification.calibration.with_control(tables)
    with scratch_folder() as folder:
        # The report describes the written file: it is read back and evaluated before it replaces the output.
        copy = folder / output.name
        write_atomic(copy, calibration.to_yaml(folder))
        identification = identification.evaluated_with(replace(Calibration.load(copy, loaded), path=None))
    calibration.save(output)
    if html_file is not None:
        from twin.identification.plots import identification_html  # imports matplotlib, slow and needed only here

        write_atomic(html_file, identification_html(identification))
    text = identification.to_text() + (
        INSTRUMENT_OPTIONS if identification.noise.contradicted or identification.noise.assumed else ""
    )
    if tables is not None:
        text += TABLES_ACTIVE if tables.tables else MODULE_ACTIVE
        text += f"{tables.caution}\n" if tables.caution else ""
    return CommandResult(
        text,
        identification.to_dict,
        met=identification.complete,
        check_json=lambda path: Identified.load(path, identification.calibration),
    )


def _artefacts(paths: Sequence[Path], data: Measurements, temperature_degC: float | None) -> list[Artefact]:
    """Return the artefacts of certificates at the temperature that is given, or at the mean of the table's column."""
    import numpy as np

    from twin.measurement.certificate import TEMPERATURE_U_K, Artefact

    if temperature_degC is not None and not paths:
        raise InputError("--artefact-temperature needs --certificate", expected="both", value=f"{temperature_degC:g}")
    u = TEMPERATURE_U_K
    read = data.temperature_degC.get("artefact", np.zeros(0))
    if temperature_degC is None and np.isfinite(read).any():
        temperature_degC, u = float(np.nanmean(read)), float(np.hypot(u, np.nanstd(read)))
    if temperature_degC is not None and not 0.0 <= temperature_degC <= 60.0:
        raise InputError(
            "the artefact's temperature is not plausible", expected="0 to 60 °C", value=f"{temperature_degC:g}"
        )
    loaded = [Artefact.load(path, data.target.tolist()) for path in paths]
    return loaded if temperature_degC is None else [artefact.at(temperature_degC, u) for artefact in loaded]


def tables_on(entries: Sequence[str], machine: Machine) -> ControlSection:
    """Return the control's tables or module that were active during the measurement, each given as ``FORMAT=FILE``."""
    from twin._common.families import LIVE_FORMATS, TABLE_FORMATS
    from twin.compensation.live import held_by_module
    from twin.controls import ControlSection, TableEntry, read_tables

    tables: dict[str, list[Path]] = {}
    known = [*TABLE_FORMATS, *LIVE_FORMATS]
    for entry in entries:
        kind, equals, file = entry.partition("=")
        if not equals or kind not in known:
            raise InputError(
                "--control cannot be read",
                expected=f"FORMAT=FILE, once per file, FORMAT one of {', '.join(known)}",
                value=entry,
                nearest=closest_name(kind, known),
            )
        tables.setdefault(kind, []).append(Path(file))
    live = [entry for kind in LIVE_FORMATS for file in tables.pop(kind, []) for entry in held_by_module(file, machine)]
    if live and len(entries) > 1:
        raise InputError(
            "--control names a kinematics module and more",
            expected="the calibration.yaml of the module alone: it holds all errors, and the control runs one",
            value=entries[-1],
        )
    for kind, files in tables.items():
        read_tables(kind, files, machine)
    found = tuple(TableEntry.of(file, kind, ()) for kind, files in tables.items() for file in files)
    return ControlSection("remaining", found, (), tuple(live))


def _check_relative(data: Measurements) -> None:
    """Raise `InputError` unless every reading is of the tool relative to the workpiece.

    A kinematics module moves the linear axes for the errors of the rotary ones. Relative to the workpiece only what remains is seen;
    from the base these corrections as well, which are no error motions of the linear axes.
    """
    relative = (data.carrier != data.station_carrier) & (data.station_carrier != "base")
    if not relative.all():
        raise data.error(
            "a reading from the base while a kinematics module was active",
            expected="the tool relative to the workpiece (probe and sphere, R-test, ball bar), or a measurement with the module off",
            row=int(relative.argmin()),
        )
