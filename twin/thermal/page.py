"""A thermal model as one HTML file: expected errors, terms, measured and predicted displacements. Needs the extra ``plots``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from twin._common.files import write_atomic
from twin._common.units import HOUR, count_with_noun
from twin.display import Html, measured, render
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, SHADE, embedded, new_figure, style_axes
from twin.model.calibration import Calibration
from twin.model.effects.thermal_response import ThermalResponse
from twin.thermal.fit import FORWARD_SHARES
from twin.thermal.model import ThermalModel, ThermalPrediction, ThermalTerm
from twin.thermal.record import ThermalRecord


def model_lines(model: ThermalModel) -> list[str]:
    """Return the terms of every displacement, the groups of sensors and the held-out errors."""
    lines = [f"Thermal model of {model.source}"]
    for displacement in model.displacements:
        lines += ["", f"{displacement.name}: residual {displacement.residual_um:.2g} µm"]
        if np.isfinite(displacement.held_out_um):
            forward = ", ".join(f"{value:.2g}" for value in displacement.forward_um)
            shares = ", ".join(f"{share:.0%}" for share in FORWARD_SHARES)
            lines[-1] += (
                f"; held out {displacement.held_out_um:.2g} µm RMS on blocks of time, {forward} µm on the rest after {shares} of "
                "the record"
            )
        lines += [f"  {term_text(term)}" for term in displacement.listed]
        rest = [term for term in displacement.terms if not term.matters]
        if rest:
            together = float(np.sqrt(sum(term.contribution_um**2 for term in rest)))
            lines.append(f"  {len(rest)} smaller terms, together {together:.2g} µm RMS")
    lines.append("")
    for group in model.groups:
        if len(group) > 1:
            lines.append(f"sensors that this record cannot distinguish: {', '.join(group)}")
    return [*lines, *model.notices]


def term_text(term: ThermalTerm) -> str:
    """Return one term in a line."""
    text = f"{term.effect:<15} {term.name}: {measured(term.coefficient, term.standard_uncertainty, term.unit)}"
    if term.effect.startswith("spindle"):
        text += f" at the highest speed, exponent {term.exponent:.2g}"
    if term.effect != "spindle_shift":
        text += f", {time_constant_text(term)}"
    if term.alternatives:
        text += f"; in {term.share:.0%} of the models, else {' or '.join(term.alternatives)}"
    return text


def time_constant_text(term: ThermalTerm) -> str:
    """Return the time constant with its standard deviation over the models."""
    if term.time_constant_s < term.u_time_constant_s / 2.0:
        return "mostly without lag"
    return f"time constant {round(term.time_constant_s, -2):.0f} s (u = {round(term.u_time_constant_s, -2):.0f} s)"


def prediction_lines(path: str, prediction: ThermalPrediction) -> list[str]:
    """Return the expected error for a record and, where it was measured, the error found."""
    lines = [f"Prediction for {path}", *(f"warning: {text}" for text in prediction.warnings)]
    for k, name in enumerate(prediction.displacements):
        u = prediction.standard_uncertainty_um[:, k]
        line = f"  {name}: expected RMS error {prediction.expected_rms_um[k]:.2f} µm"
        line += f" (standard uncertainty {u.min():.2g} to {u.max():.2g} µm)"
        if np.isfinite(prediction.rms_um[k]):
            inside = float((np.abs(prediction.residual_um[:, k]) <= 2.0 * u).mean())
            line += f"; measured minus predicted {prediction.rms_um[k]:.2f} µm RMS, {inside:.0%} of the rows within U (k = 2)"
        lines.append(line)
    return lines


def response_lines(calibration: Calibration) -> list[str]:
    """Return one line for each thermal response of a calibration: its uncertainty and its ranges."""
    found = calibration.covariance
    u = dict(zip(found.names, np.sqrt(np.diag(found.matrix)).tolist(), strict=True))
    return [
        f"{one.name}: RMS error on later data {u[one.parameters[0].name]:.2g} µm; valid for "
        + ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in one.ranges.items())
        for one in calibration.extra
        if isinstance(one, ThermalResponse)
    ]


def save_prediction(prediction: ThermalPrediction, path: str | Path) -> None:
    """Write a table with ``time_s`` and, for each displacement, the prediction ``<name>_um`` and ``u_<name>_um``, atomically.

    Raises `InputError`: it cannot be written.
    """
    header = ["time_s"]
    columns = [prediction.time_s]
    for k, name in enumerate(prediction.displacements):
        header += [f"{name}_um", f"u_{name}_um"]
        columns += [prediction.displacement_um[:, k], prediction.standard_uncertainty_um[:, k]]
    rows = [",".join([f"{row[0]:.10g}", *(f"{value:.3f}" for value in row[1:])]) for row in zip(*columns, strict=True)]
    write_atomic(Path(path), "\n".join([",".join(header), *rows, ""]))


# --- A thermal model as one HTML file: expected errors, terms, measured and predicted displacements. Needs the extra ``plots`

MOST_PICTURES: Final = 20


def thermal_html(model: ThermalModel, shown: Sequence[tuple[ThermalRecord, ThermalPrediction]]) -> str:
    """Return one self-contained HTML page; ``shown``: records with their predictions, drawn one after the other."""
    listed = sum(len(displacement.listed) for displacement in model.displacements)
    return render(
        "thermal/templates/thermal.html.j2",
        title=f"Thermal model of {Path(model.source).name}",
        headline=f"{count_with_noun(len(model.displacements), 'displacement')}, {count_with_noun(listed, 'term')} that matter",
        model=model,
        shares=", ".join(f"{share:.0%}" for share in FORWARD_SHARES),
        groups=[group for group in model.groups if len(group) > 1],
        shown=[(Path(record.path).name, record.path == model.source, prediction) for record, prediction in shown],
        measured=measured,
        time_constant=time_constant_text,
        warnings=sorted({text for _, prediction in shown for text in prediction.warnings}),
        picture=lambda k: _picture(model, k, shown) if k < MOST_PICTURES else Html(""),
    )


def _picture(model: ThermalModel, k: int, shown: Sequence[tuple[ThermalRecord, ThermalPrediction]]) -> Html:
    """Draw one displacement: measured and predicted with U above, residual with U below, speed behind."""
    name = model.displacements[k].name
    drawn = new_figure(9.0, 4.8)
    above, below = drawn.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for i, (record, prediction) in enumerate(shown):
        first = i == 0
        hours = record.time_s / HOUR
        value, half = prediction.displacement_um[:, k], 2.0 * prediction.standard_uncertainty_um[:, k]
        above.fill_between(
            hours,
            value - half,
            value + half,
            color=FORWARD,
            alpha=SHADE,
            linewidth=0,
            label="U (k = 2)" if first else None,
        )
        below.fill_between(hours, -half, half, color=FORWARD, alpha=SHADE, linewidth=0)
        above.plot(hours, value, color=FORWARD, linewidth=1.2, label="predicted" if first else None)
        residual = prediction.residual_um[:, k]
        if np.isfinite(residual).all():
            above.plot(
                hours, value + residual, color=BOTH, linewidth=0.9, linestyle="--", label="measured" if first else None
            )
            below.plot(hours, residual, color=BACKWARD, linewidth=0.9)
        if not first:
            above.axvline(hours[0], color=RUN, linewidth=0.8)
            below.axvline(hours[0], color=RUN, linewidth=0.8)
    for plot in (above, below):
        style_axes(plot)
    above.set_title(name, loc="left", fontweight="bold")
    above.set_ylabel("displacement [µm]")
    above.legend(bbox_to_anchor=(1.01, 1.0), loc="upper left", frameon=False)
    below.set(xlabel="time [h]", ylabel="measured minus\npredicted [µm]")
    return embedded(drawn, f"{name}: measured and predicted displacement, residual and U over time", kind="big")
