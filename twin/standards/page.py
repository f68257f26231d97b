"""The standard tests as one HTML file: tolerances, values, the standards' plots, what was not evaluated. Needs the extra ``plots``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from twin._common.provenance import warning_texts
from twin._common.units import count_with_noun
from twin.display import Html, figure, readable, render
from twin.display.figures import BACKWARD, FORWARD, THIRD, embedded, new_figure, style_axes
from twin.measurement.columns import grouped_notes
from twin.standards.drift.iso230_3 import DriftSeries
from twin.standards.iso230_1 import AngularError, Straightness
from twin.standards.iso230_2 import Positioning, UnidirectionalPositioning
from twin.standards.iso230_4 import CircularTest, RotaryMotion
from twin.standards.plots import (
    plot_angular_error,
    plot_circular,
    plot_drift,
    plot_error_motion,
    plot_positioning,
    plot_straightness,
    plot_unidirectional,
)
from twin.standards.result import SENTENCES, EvaluationResult, StandardTest

MOST_PICTURES: Final = 40
"""Number of tests of one page that are drawn; the values of all are listed."""
PLOTS: Final[tuple[tuple[type, Callable[[Any], Figure]], ...]] = (
    (Positioning, plot_positioning),
    (UnidirectionalPositioning, plot_unidirectional),
    (CircularTest, plot_circular),
    (Straightness, plot_straightness),
    (AngularError, plot_angular_error),
    (RotaryMotion, plot_error_motion),
)
"""Plots by the kind of result."""
COLOURS: Final = {"met": "#e8f3ea", "failed": "#fbe4de", "none": "#f3f3f3"}


def evaluation_html(result: EvaluationResult) -> str:
    """Return one self-contained HTML page.

    Args:
        result: the result of `twin.evaluate`.

    Examples:
        >>> from pathlib import Path
        >>> machine = twin.Machine.load("dmu50")
        >>> plan, truth = twin.thesis_plan.plan(machine), twin.Calibration.default(machine)
        >>> along_x = plan.select(plan.approach[:, 0] != 0)
        >>> data, _ = twin.simulate(along_x, machine, truth, twin.instruments.LaserTracker(), np.random.default_rng(1))
        >>> page = twin.evaluation_html(twin.evaluate(data, machine))
        >>> _ = Path("tests.html").write_text(page, encoding="utf-8")
    """
    failed = sum(not check.met for check in result.checks)
    undecided = sum(check.conformity == "neither" for check in result.checks)
    if not result.checks:
        headline = f"{count_with_noun(len(result.tests), 'standard test')} evaluated"
    elif failed:
        headline = f"{failed} of {count_with_noun(len(result.checks), 'tolerance check')} not met"
    elif undecided:
        headline = f"{undecided} of {count_with_noun(len(result.checks), 'tolerance check')} undecided"
    else:
        headline = "All tolerances met" if len(result.checks) > 1 else "The tolerance is met"
    pictures = [test for test in result.tests if _figure(test, draw=False)][:MOST_PICTURES]
    return render(
        "standards/templates/evaluation.html.j2",
        found=result,
        title=f"{headline}: {result.machine}",
        headline=headline,
        colour=COLOURS["none" if not result.checks else "failed" if failed or undecided else "met"],
        source=", ".join(Path(name).name for name in result.data.source.split(", ")),
        badges=warning_texts(result.warnings),
        picture=lambda test: _picture(test) if any(test is picture for picture in pictures) else "",
        not_drawn=sum(bool(_figure(test, draw=False)) for test in result.tests) - len(pictures),
        SENTENCES=SENTENCES,
        shown=figure,
        unit=readable,
        grouped_notes=grouped_notes,
        targets=_targets,
    )


def _picture(test: StandardTest) -> Html:
    drawn = _figure(test)
    return Html("") if not isinstance(drawn, Figure) else embedded(drawn, f"{test.title}, {test.place}", kind="big")


def _figure(test: StandardTest, *, draw: bool = True) -> Figure | bool:
    """Return the standard's plot of a test; without ``draw`` only whether there is one."""
    detail = test.detail
    if isinstance(detail, Positioning) and not np.isfinite(detail.R):
        return False
    if isinstance(detail, DriftSeries):
        return plot_drift(detail, title=f"{test.title}, {test.standard}") if draw else True
    if isinstance(detail, np.ndarray):
        return _plot_deviations(test, detail) if draw else True
    for kind, plot in PLOTS:
        if isinstance(detail, kind):
            return plot(detail) if draw else True
    return False


def _plot_deviations(test: StandardTest, deviation_um: np.ndarray) -> Figure:
    """Plot the deviations of a kinematic test over the readings in their order."""
    drawn = new_figure(9.0, 4.0)
    plot = drawn.subplots()
    style_axes(plot)
    for k, (colour, marker) in enumerate(((FORWARD, "o"), (BACKWARD, "s"), (THIRD, "D"))):
        if np.isfinite(deviation_um[:, k]).all():
            label = test.values[0].symbol.removeprefix("range ") if len(test.values) == 1 else "xyz"[k]
            number = np.arange(1, len(deviation_um) + 1)
            plot.plot(number, deviation_um[:, k], color=colour, marker=marker, markersize=3, linewidth=1.0, label=label)
    plot.set_title(f"{test.title}, {test.standard}", loc="left", fontweight="bold")
    plot.set(xlabel="reading", ylabel="deviation from the mean [µm]")
    plot.legend(bbox_to_anchor=(1.01, 1.0), loc="upper left", frameon=False)
    return drawn


def _targets(test: StandardTest) -> list[tuple[str, ...]]:
    """Return the table by target of a bi-directional positioning test: P, x̄↑, x̄↓, B, s↑, s↓, R; empty for other tests."""
    detail = test.detail
    if not isinstance(detail, Positioning):
        return []
    columns = (
        detail.mean_forward,
        detail.mean_backward,
        detail.B_i,
        detail.s_i_forward,
        detail.s_i_backward,
        detail.R_i,
    )
    return [
        (f"{target:g}".replace("-", "−"), *(figure(float(column[i])) for column in columns))
        for i, target in enumerate(detail.target)
    ]
