"""A thermal model as one HTML file: expected errors, terms, measured and predicted displacements. Needs the extra ``plots``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from twin._common.counts import count_with_noun
from twin.display import Html, measured, render
from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, SHADE, embedded, new_figure, style_axes
from twin.thermal.fit import FORWARD as SHARES
from twin.thermal.model import ThermalModel, ThermalPrediction
from twin.thermal.record import ThermalRecord
from twin.thermal.text import time_constant_text

MOST_PICTURES: Final = 20
HOUR: Final = 3600.0


def thermal_html(model: ThermalModel, shown: Sequence[tuple[ThermalRecord, ThermalPrediction]]) -> str:
    """Return one self-contained HTML page.

    Args:
        model: the model.
        shown: records with their predictions, drawn one after the other.
    """
    listed = sum(len(one.listed) for one in model.displacements)
    return render(
        "thermal/templates/thermal.html.j2",
        title=f"Thermal model of {Path(model.source).name}",
        headline=f"{count_with_noun(len(model.displacements), 'displacement')}, {count_with_noun(listed, 'term')} that matter",
        model=model,
        shares=", ".join(f"{share:.0%}" for share in SHARES),
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
