"""Command ``twin thermal``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin.cli.shared import options
from twin.cli.shared.command import CALIBRATION, EXISTING, HTML, TABLE, CommandResult, JsonOption, command, progress_bar
from twin.cli.shared.terminal import pairs

if TYPE_CHECKING:
    from twin.model.calibration import Calibration
    from twin.thermal import ThermalModel, ThermalPrediction, ThermalRecord

TOO_FAR = 2.0
"""Ratio of the error found to the expected error above which the expectation does not hold."""


@command(
    "twin thermal warm_up.csv -o thermal.yaml --html thermal.html",
    "twin thermal first.csv -o thermal.yaml --predict second.csv --predicted predicted.csv",
    "twin thermal second.csv --model thermal.yaml --continues --predicted predicted.csv",
    "twin thermal second.csv --model thermal.yaml -c mine.yaml --along X=d1 Z=-d5 --extended warm.yaml",
)
def thermal(
    record: Annotated[
        Path, typer.Argument(help="Record: time_s, spindle_rpm, T_<sensor>_degC and displacements <name>_um."), EXISTING
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the fitted model to this YAML file."), CALIBRATION
    ] = None,
    model_file: Annotated[
        Path | None, typer.Option("--model", help="Use this model instead of fitting one, and predict the record.")
    ] = None,
    predict: Annotated[
        Path | None,
        typer.Option("--predict", help="Predict this record too; its displacements are compared if it has them."),
    ] = None,
    predicted: Annotated[
        Path | None, typer.Option("--predicted", help="Write the last prediction to this CSV file."), TABLE
    ] = None,
    continues: Annotated[
        bool,
        typer.Option(
            "--continues", help="The predicted record follows the fitted one without a break, whatever its times."
        ),
    ] = False,
    extended: Annotated[
        Path | None,
        typer.Option("--extended", help="Write the calibration, extended by the displacements, to this file."),
        CALIBRATION,
    ] = None,
    along: Annotated[
        list[str] | None,
        typer.Option(
            "--along",
            help="Direction of the base frame and the displacement of the tool side that is measured along it, with a minus sign if it "
            "counts against the direction: X=d1 Z=-d5; default: those named X, Y and Z.",
        ),
    ] = None,
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    json_file: JsonOption = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="Write the report to this HTML file."), HTML] = None,
) -> CommandResult:
    """Fit displacements to temperatures and spindle speed over time, and state the expected error of predictions.

    The exit status is 3 if a predicted record has displacements and the error is more than twice the expected error.
    """
    from twin.thermal import ThermalRecord, save_model
    from twin.thermal.page import model_lines, prediction_lines, response_lines, save_prediction

    if model_file is not None and (predict is not None or output is not None):
        raise InputError("--model excludes --predict and --output", expected="the record to predict as the argument")
    if along is not None and extended is None:
        raise InputError("--along needs --extended", expected="--extended CALIBRATION.yaml as well")
    if html_file is not None:
        options.need_pictures("the HTML report")
    first = ThermalRecord.load(options.record_path(record))
    other = None if predict is None else ThermalRecord.load(options.record_path(predict))
    model, shown = _predictions(first, other, model_file, continues)
    new = shown[-1:] if model_file is not None or other is not None else []
    effects = []
    if extended is not None:
        added = _extended(model, shown[-1][1] if new else None, along, machine, calibration)
        added.save(extended)
        effects = ["", *response_lines(added)]
    if output is not None:
        save_model(model, output)
    if predicted is not None:
        save_prediction(shown[-1][1], predicted)
    if html_file is not None:
        from twin.thermal.page import thermal_html  # imports matplotlib, which is slow and needed only here

        write_atomic(html_file, thermal_html(model, shown))
    lines = model_lines(model)
    for one, prediction in new:
        lines += ["", *prediction_lines(one.path, prediction), *one.notices]
    met = not any((one.rms_um > TOO_FAR * one.expected_rms_um).any() for _, one in new)
    return CommandResult("\n".join([*lines, *effects, ""]), lambda: _report(model, shown), met=met)


def _predictions(
    first: ThermalRecord, other: ThermalRecord | None, model_file: Path | None, continues: bool
) -> tuple[ThermalModel, list[tuple[ThermalRecord, ThermalPrediction]]]:
    from twin.thermal import fit_thermal as run_fit
    from twin.thermal import load_model

    if model_file is not None:
        model = load_model(model_file)
        return model, [(first, model.predict(first, continues=continues or None))]
    with progress_bar() as bar:
        model = run_fit(first, progress=bar)
    shown = [(first, model.predict(first))]
    if other is not None:
        shown.append((other, model.predict(other, continues=continues or None)))
    return model, shown


def _extended(
    model: ThermalModel,
    later: ThermalPrediction | None,
    along: list[str] | None,
    machine: str,
    calibration: Path | None,
) -> Calibration:
    """Return the calibration with the displacements of the model as effects."""
    given = pairs("--along", along, "direction and displacement: Z=d5")
    found = {direction: name for direction, name, _ in given}
    names = [one.name for one in model.displacements]
    return model.extend(
        options.calibration_of(calibration, options.machine(machine)),
        found if along is not None else {direction: direction for direction in "XYZ" if direction in names},
        later,
    )


def _report(model: ThermalModel, shown: list[tuple[ThermalRecord, ThermalPrediction]]) -> dict[str, Any]:
    return {
        **model.to_dict(),
        "schema": "twin.thermal/1",
        "predictions": [
            {
                "record": record.path,
                "warnings": list(prediction.warnings),
                "expected_rms_um": dict(
                    zip(prediction.displacements, map(float, prediction.expected_rms_um), strict=True)
                ),
                "rms_um": dict(zip(prediction.displacements, map(float, prediction.rms_um), strict=True)),
            }
            for record, prediction in shown
        ],
    }
