"""An identification as one HTML file: verdict, errors with intervals, residuals and curves. Needs the extra ``plots``."""

from __future__ import annotations

from pathlib import Path

from twin._common.counts import count_with_noun
from twin._common.provenance import warning_texts
from twin.display import Html, render
from twin.display.figures import embedded
from twin.identification.plots import plot_motions, plot_orders, plot_residuals
from twin.identification.result import Identification
from twin.machine.effects import split_name


def identification_html(found: Identification) -> str:
    """Return one self-contained HTML page.

    Args:
        found: the result of `twin.identify`.
    """
    calibration = found.calibration
    machine = calibration.machine.name
    axes = list(dict.fromkeys(split_name(name)[2] for name in calibration.curves))
    return render(
        "identification/templates/identification.html.j2",
        title=f"Identification of {machine}",
        machine=machine,
        source=", ".join(Path(name).name for name in found.data.source.split(", ")),
        points=count_with_noun(int(found.used.sum()), "point"),
        badges=warning_texts(calibration.warnings),
        card=Html(found._repr_html_()),
        residuals=embedded(plot_residuals(found), "Residuals over the readings and over each axis", kind="big"),
        axes=axes,
        motions=lambda axis: embedded(
            plot_motions(found, axis), f"Error motions of axis {axis} with their 95 % intervals", kind="big"
        ),
        orders=embedded(plot_orders(found), "Prediction error by the number of functions", kind="big")
        if found.choice.uniform
        else "",
    )
