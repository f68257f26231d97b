"""A machine's report as one HTML file: first what to do, then what it rests on. Needs the extra ``plots`` (matplotlib).

Pictures and the field in 3D are embedded; nothing is fetched. On paper a still picture stands in for the field. The words are in the
templates beside this module, a section each.
"""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from typing import Final

from twin.diagnosis.wording import words
from twin.display import Html, place, render, with_half
from twin.display.figures import embedded
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.control import ControlSection
from twin.machine.display import uncertainty_of
from twin.machine.effects import Effect
from twin.numerics.curves import Basis, basis_named
from twin.report import plots
from twin.report.motions import Motion
from twin.report.readings import Stops
from twin.report.result import MachineReport
from twin.report.scene.field import field_html
from twin.report.scene.path import scale_top_um
from twin.report.words import CLASSES
from twin.uncertainty.at_tool import DEFINITION

COLOURS: Final = {"well": "#e8f3ea", "wrong": "#fdf2df", "unknown": "#fbe4de"}
MARKS: Final = {"do": "✔ Do", "measure": "◎ Measure", "never": "✘ Do not", "unknown": "? Not known"}
ROWS: Final = 40
"""Rows set aside that are listed."""
VIEWER: Final = "<!-- the field in 3D -->"
"""Stands for the viewer until the text around it is done."""
AT_TOOL: Final = ["at the tool, RMS [µm]", "largest [µm]", "U [µm]"]
SECTIONS: Final = (
    ("What each error makes at the tool", "budget"),
    ("Error motions, axis by axis", "motions"),
    ("Squareness, and where the rotary axes lie", "constants"),
    ("The error over the working space", "field"),
    ("Before and after compensation", "after"),
    ("How well it is known", "known"),
    ("What this calibration does not know", "gaps"),
    ("Where it comes from", "sources"),
)
"""Heading and template of every part below the first screen."""


def machine_html(report: MachineReport) -> str:
    """One self-contained page; needs matplotlib (extra ``plots``).

    Args:
        report: what `twin.report.machine_report` worked out.
    """

    def stops_of(name: str) -> tuple[Stops, ...]:
        return tuple(stop for one in report.checked for stop in one.stops.get(name, ()))

    page = render(
        "report/templates/report.html.j2",
        title=f"{report.machine.name}: report of the machine",
        report=report,
        over=_over(report),
        sections=SECTIONS,
        colours=COLOURS,
        marks=MARKS,
        stops_of=stops_of,
        plots=plots,
        words=words,
        AT_TOOL=AT_TOOL,
        CLASSES=CLASSES,
        DEFINITION=DEFINITION,
        ROWS=ROWS,
        VIEWER=VIEWER,
        coded=_coded,
        degree=_degree,
        embedded=embedded,
        numbers=_numbers,
        rows_of=_rows_of,
        scale_top_um=scale_top_um,
        tables_of=_tables_of,
    )
    # Numbers keep to their units in the text; what the viewer is made of stays as it is.
    return page.replace(VIEWER, _viewer(report)) if VIEWER in page else page


def _over(report: MachineReport) -> str:
    field = report.field
    stands = f", {place(field.standing)} standing still" if field.standing else ""
    return f"over {words.listed(list(field.spread))}{stands}"


def _viewer(report: MachineReport) -> str:
    """The field to be turned, in a frame of its own."""
    field, rows = report.field, report.field.drawn
    inner = field_html(
        field.point_mm[rows],
        field.error_um[rows],
        title=f"Error of the tool point {_over(report)}",
        edges=field.edges(),
        illustrative=bool(report.illustrative),
    )
    return f'<iframe title="Error field in 3D: drag to turn" srcdoc="{html.escape(inner)}"></iframe>'


def _coded(text: str) -> Html:
    """Plain text as HTML, commands between back quotes as such."""
    return Html(re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(text)))


def _degree(report: MachineReport, motion: Motion) -> str:
    """What a motion's curve is made of: the identification's own number of functions where it is this calibration's."""
    order = "–" if motion.order is None else str(motion.order)
    told = report.identified
    if told is not None and not told.others:
        order = str(told.orders.get(motion.name, order))
    noun = basis_named(motion.basis).order_noun if motion.basis else Basis.order_noun
    kind = "" if noun == Basis.order_noun else f"{noun} "
    return " + ".join([f"{kind}{order}", *([", ".join(motion.added)] if motion.added else [])])


def _numbers(report: MachineReport, effect: Effect) -> str:
    """An effect's parameters with their 95 % intervals."""
    known = report.calibration.covariance
    halves = [(one, COVERAGE_FACTOR * uncertainty_of(one.name, known)) for one in effect.parameters]
    return "; ".join(f"{one.name.rpartition('.')[2]} {with_half(one.value, half, one.unit)}" for one, half in halves)


def _rows_of(rows: Sequence[tuple[int, str]]) -> list[str]:
    """Rows set aside, with their reasons."""
    more = [f"and {len(rows) - ROWS} more, all in --json"] if len(rows) > ROWS else []
    return [*(f"line {line}: {reason}" for line, reason in rows[:ROWS]), *more]


def _tables_of(control: ControlSection) -> list[str]:
    return [f"{one.file.name} ({' '.join(one.classes)})" for one in control.tables]
