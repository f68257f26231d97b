"""Report of a run: as text, and as JSON (``schema: twin.axis_run/1``)."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from twin._common.counts import count_with_noun
from twin._common.json_form import json_form
from twin._common.provenance import warning_texts, warnings_to_json
from twin.identification.axis_run.layout import AxisLayout
from twin.identification.axis_run.motions import NAMES, AxisCurves, Motions, disagreements
from twin.identification.axis_run.readings import BeamReadings
from twin.measurement.checks import grouped_notes

SCHEMA: Final = "twin.axis_run/1"
REPEAT_RATIO: Final = 3.0
"""Ratio of the standard deviation of repeats to the noise of the beams above which it is reported."""


def notices(motions: Motions, curves: AxisCurves) -> tuple[str, ...]:
    """Return the facts to know before using the result."""
    found = list(disagreements(motions, curves))
    own = np.sqrt(np.einsum("nii->ni", motions.displacement.noise_covariance)).mean(axis=0) * 1e6
    varying = [i for i in range(6) if motions.spread == "stated" and motions.repeatability[i] > REPEAT_RATIO * own[i]]
    if varying:
        names = ", ".join(f"E_{NAMES[i]}{motions.axis}" for i in varying)
        found.append(f"{names}: repeats vary more than the beams' noise explains; base the uncertainty on repeats")
    return tuple(found)


def to_dict(layout: AxisLayout, readings: BeamReadings, motions: Motions, curves: AxisCurves) -> dict[str, Any]:
    """Return the report as JSON."""
    installation, names = motions.displacement, [f"E_{letter}{motions.axis}" for letter in NAMES]
    installation_u, u = np.sqrt(np.diag(installation.installation_covariance)), motions.u
    found = {
        "schema": SCHEMA,
        "layout": layout.name,
        "axis": motions.axis,
        "data": readings.source,
        "rows": {"used": len(readings), "set_aside": len(readings.set_aside)},
        "uncertainty": motions.spread,
        "motions": [
            {"position_mm": motions.position_mm[g], "approach": int(motions.approach[g]), "rows": motions.count[g]}
            | {
                name: {"value": motions.values[g, i], "u": u[g, i], "u_installation": motions.u_installation[g, i]}
                for i, name in enumerate(names)
            }
            for g in range(len(motions))
        ],
        "curves": {
            name: {"functions": count, "held_out": curves.held_out[name]} for name, count in curves.orders.items()
        },
        "reversal": {name: {"value": value, "u": u} for name, (value, u) in curves.reversal.items()},
        "repeatability": dict(zip(names, motions.repeatability, strict=True)),
        "misfit": {"chi2": motions.chi2, "dof": motions.dof, "p_value": motions.p_value},
        "curves_misfit": {"chi2": curves.chi2, "dof": curves.dof, "p_value": curves.p_value},
        "installation": [
            {"name": name, "estimate": estimate, "u_stated": stated, "u": after}
            for name, estimate, stated, after in zip(
                layout.beams.installation, installation.installation, layout.installation_u, installation_u, strict=True
            )
        ],
        "warnings": warnings_to_json(curves.calibration.warnings),
        "notices": [*readings.notices, *notices(motions, curves)],
        "set_aside": [{"line": note.line, "reason": note.text} for note in readings.set_aside],
    }
    return dict(json_form(found))


def to_text(layout: AxisLayout, readings: BeamReadings, motions: Motions, curves: AxisCurves) -> str:
    """Return the report as text."""
    lines = [
        f"{layout.name}: {motions.axis}, {count_with_noun(len(readings), 'row')}, "
        f"{count_with_noun(len(np.unique(motions.position_mm)), 'position')}, "
        f"counters zeroed at {layout.reference_mm:g} mm",
        *warning_texts(curves.calibration.warnings),
        f"misfit: chi² {motions.chi2:.0f} for {motions.dof} degrees of freedom (p = {motions.p_value:.2g})",
        "",
        "error motion      range   functions   held out   u, largest   of it installation   reversal",
    ]
    for i, letter in enumerate(NAMES):
        name = f"E_{letter}{motions.axis}"
        if name not in curves.held_out:
            continue
        unit = "µm  " if i < 3 else "µrad"
        turned = curves.reversal.get(name)
        lines.append(
            f"{name}   {np.ptp(motions.values[:, i]):10.3f} {unit}   {curves.orders.get(name, 0):5d}   {curves.held_out[name]:10.4f}"
            f"   {motions.u[:, i].max():10.4f}   {motions.u_installation[:, i].max():18.4f}   "
            + ("" if turned is None else f"{turned[0]:+.4f} ± {turned[1]:.4f}")
        )
    lines += ["", *(f"note: {text}" for text in (*readings.notices, *notices(motions, curves)))]
    lines += [f"set aside, {text}" for text in grouped_notes(readings.set_aside)]
    return "\n".join(lines).rstrip() + "\n"
