"""Render a machine report as one HTML file: the summary first, then the details. Needs the extra ``plots`` (matplotlib).

Pictures and the 3D field are embedded; the page loads nothing from the network. In print, a still picture replaces the 3D field. The
text is in the templates next to this module, one per section.
"""

from __future__ import annotations

import base64
import gzip
import html
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from twin._common.families import Language
from twin._common.messages import Message, Number, joined, say, say_html, translated
from twin.controls import ControlSection
from twin.display import Html, figure, place, render, with_half
from twin.display.figures import embedded
from twin.display.markup import ACCENT
from twin.display.numbers import COVERAGE_FACTOR, listed, signed
from twin.display.sheet import Job, Sheet, translation_of
from twin.model.display import uncertainty_of
from twin.model.effects import Effect
from twin.numerics.curves import Basis, basis_named
from twin.reporting import plots
from twin.reporting.advice import grouped_sentences
from twin.reporting.compensation import MACHINES
from twin.reporting.contributions import Contribution, Motion
from twin.reporting.front import EarlierReport, FrontPage, front_page
from twin.reporting.identified import PositionEstimates
from twin.reporting.names import CLASSES, item_named
from twin.reporting.result import MachineReport
from twin.reporting.scene.draw import field_html
from twin.reporting.scene.path import scale_top_um
from twin.tool.uncertainty import DEFINITION

MARKS: Final = {
    "do": Message("✔ Do"),
    "measure": Message("◎ Measure"),
    "never": Message("✘ Do not"),
    "unknown": Message("? Not known"),
}
SYMBOLS: Final = {"pass": "✔", "fail": "✘", "undecided": "?"}
ROWS: Final = 40
"""Largest number of excluded rows that are listed."""
FILES: Final = ("calibration", "identification", "measured")
"""Roles of the files named on the first page."""
VIEWER: Final = "<!-- the field in 3D -->"
"""Placeholder of the viewer until the rest of the page is rendered."""
PARAMETERS: Final = MappingProxyType(
    {
        "size": Message("size"),
        "offset": Message("offset"),
        "amplitude": Message("amplitude"),
        "period": Message("period"),
        "phase": Message("phase"),
        "coefficient": Message("coefficient"),
        "order": Message("order"),
        "time_constant": Message("time_constant"),
        "exponent": Message("exponent"),
        "highest_rpm": Message("highest_rpm"),
        "tilt": Message("tilt"),
        "compliance": Message("compliance"),
        "mass": Message("mass"),
        "mass_ratio": Message("mass_ratio"),
    }
)
"""Names of the parameters of effects, in words where a language has them."""
AT_TOOL: Final[list[str]] = [Message("at the tool, RMS [µm]"), Message("largest [µm]"), "U [µm]"]
SECTIONS: Final = (
    (Message("Error budget at the tool"), "budget"),
    (Message("Error over the working volume"), "field"),
    (Message("Before and after compensation"), "compensation"),
    (Message("Uncertainty"), "known"),
    (Message("Not covered by this calibration"), "gaps"),
)
"""Heading and template of every section of the main part, after the first page."""
APPENDIX: Final = (
    (Message("Error motions, axis by axis"), "motions"),
    (Message("Squareness and location of the rotary axes"), "constants"),
    (Message("Planes"), "planes"),
    (Message("Sources"), "sources"),
)
ARCSEC: Final = 180.0 * 3600.0 / np.pi * 1e-6
"""Arc seconds in a microradian."""
VISIBLE: Final = 1.5e-6
"""Difference of a control's parameter from which it is listed; the sixth decimal is its last one."""


def machine_html(report: MachineReport, front: FrontPage | None = None, sheet: Sheet | None = None) -> str:
    """Return the page as self-contained HTML in the language of its sheet; untranslated sentences stay English and are counted."""

    def stops_of(name: str) -> tuple[PositionEstimates, ...]:
        return tuple(stop for comparison in report.comparisons for stop in comparison.stops.get(name, ()))

    def words_of(name: str) -> str:
        return item_named(name, report.machine, references.get(name, ""))

    references = {constant.name: constant.to for constant in report.constants}
    first = front_page(report) if front is None else front
    sheet = sheet_of(report) if sheet is None else sheet
    translation = translation_of(sheet.language)
    with translated(translation):
        page = render(
            "reporting/templates/report.html.j2",
            title=f"{report.machine.name}: report of the machine",
            report=report,
            front=first,
            items={item.name: item for item in first.items},
            sheet=sheet,
            translation=translation,
            item_named=item_named,
            words_of=words_of,
            symbols=SYMBOLS,
            over=_over(report),
            sections=SECTIONS,
            appendix=APPENDIX,
            marks=MARKS,
            conditions=_conditions(report),
            trend=_trend(first.history),
            held_rows=_held_rows(report),
            held_note=_held_note(report),
            in_shop=_in_shop,
            stops_of=stops_of,
            plots=plots,
            AT_TOOL=AT_TOOL,
            CLASSES=CLASSES,
            MACHINES=MACHINES,
            DEFINITION=DEFINITION,
            ROWS=ROWS,
            VIEWER=VIEWER,
            coded=_coded,
            not_identified=[
                *grouped_sentences(report.gaps.not_identified, "why"),
                *grouped_sentences(report.gaps.not_identified, "remedy"),
            ],
            degree=_degree,
            embedded=_embedded,
            numbers=_numbers,
            rows_of=_rows_of,
            say=say,
            scale_top_um=scale_top_um,
            spacing=_spacing,
            tables_of=_tables_of,
        )
        # Inserted last: the page's filter ties numbers to their units, which must not change the viewer's code.
        return page.replace(VIEWER, _viewer(report)) if VIEWER in page else page


def sheet_of(report: MachineReport, job: Job | None = None, language: Language = Language.en, logo: str = "") -> Sheet:
    """Return the sheet of a report, with the files from which it was made, without machine file and URDF."""
    files = tuple((Path(one.path).name, one.sha256) for one in report.sources.files if one.role in FILES)
    version = report.sources.programs.get("twin", "")
    return Sheet(Job() if job is None else job, report.sources.made, files, version, language, logo)


def _conditions(report: MachineReport) -> tuple[tuple[str, Number], ...]:
    channels = report.kinematics.conditions.channels
    return tuple((name, Number(f"{value:g}")) for name, value in channels.items() if np.ndim(value) == 0)


def _in_shop(error: Contribution) -> str:
    """Return an angle as shops state it: µm/m for squareness, seconds of arc for other angles; empty for a displacement."""
    if error.unit != "urad":
        return ""
    factor, unit = (1.0, "um/m") if error.iso_class == "L-SQU" else (ARCSEC, "″")
    return with_half(factor * error.peak, factor * error.peak_half, unit)


def _held_rows(report: MachineReport) -> list[tuple[str, ...]]:
    """Return the parameters of the control that change: name, present value, new value, and difference with U."""
    held, rows = report.kinematics_of_control, list[tuple[str, ...]]()
    if held is None:
        return rows
    for name, should in held.values.items():
        now, half = held.present[name], COVERAGE_FACTOR * held.u[name]
        if abs(should - now) > VISIBLE:
            change = f"{should - now:+.6f}" + (f" ± {half:.6f}" if np.isfinite(half) else "")
            rows.append(
                (held.form.label(name, held.machine), *(signed(one) for one in (f"{now:.6f}", f"{should:.6f}", change)))
            )
    return rows


def _held_note(report: MachineReport) -> Message:
    held = report.kinematics_of_control
    if held is None:
        return Message("")
    unknown = [error.name for error in report.gaps.not_identified if error.name in report.machine.location_names]
    texts = [
        Message(
            "mm, degrees, components of unit vectors. Counted from the spindle nose with all axes at zero; where the control counts "
            "from other points, enter the differences. Other values stay as they are."
        ),
        *([Message("Not measured, and therefore unchanged here: {names}.", names=listed(unknown))] if unknown else []),
        *(
            [
                Message(
                    "{count} assumptions on the control are not checked: `twin control --kinematics` lists them.",
                    count=len(held.form.unchecked),
                )
            ]
            if held.form.unchecked
            else []
        ),
    ]
    return joined(" ", texts)


def _trend(history: Sequence[EarlierReport]) -> Html | None:
    """Return a small picture of the error of the tool point in the reports of a machine over time, with U; None without history."""
    if not history:
        return None
    days = np.array([(one.made - history[0].made).total_seconds() for one in history])
    at = 8.0 + 184.0 * (days / days[-1] if days[-1] > 0.0 else np.linspace(0.0, 1.0, len(days)))
    half = [one.half if np.isfinite(one.half) else 0.0 for one in history]
    top = max(one.value + more for one, more in zip(history, half, strict=True) if np.isfinite(one.value)) or 1.0
    level = [50.0 - 44.0 * one.value / top for one in history]
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(at, level, strict=True))
    bars = "".join(
        f"<path d='M{x:.1f} {y - 44.0 * u / top:.1f}V{y + 44.0 * u / top:.1f}' stroke='#555'/>"
        f"<circle cx='{x:.1f}' cy='{y:.1f}' r='2.5'/>"
        for x, y, u in zip(at, level, half, strict=True)
    )
    ends = [say(Number(figure(one.value, "µm"))) + f", {one.made:%Y-%m-%d}" for one in (history[0], history[-1])]
    text = "".join(
        f"<text x='{x}' y='61' font-size='8' text-anchor='{anchor}'>{html.escape(end)}</text>"
        for x, anchor, end in ((2, "start", ends[0]), (198, "end", ends[1]))
    )
    return Html(
        f"<svg class=trend role=img viewBox='0 0 200 64'><title>{html.escape(' … '.join(ends))}</title>"
        f"<path d='M4 50H196' stroke='#bbb'/><polyline points='{points}' fill='none' stroke='{ACCENT}' stroke-width='1.5'/>"
        f"{bars}{text}</svg>"
    )


def _embedded(picture: Figure, words: str, caption: str = "", kind: str = "") -> Html:
    """Return an embedded picture with the numbers of its axes in the language of the page."""
    for plot in picture.axes:
        for axis in (plot.xaxis, plot.yaxis):
            formatter = axis.get_major_formatter()
            formatter.format_ticks = partial(_ticks, formatter.format_ticks)  # type: ignore[method-assign]
    return embedded(picture, say(words), caption, kind)


def _ticks(format_ticks: Callable[[Any], list[str]], values: Any) -> list[str]:
    return [say(Number(text)) for text in format_ticks(values)]


def _over(report: MachineReport) -> Message:
    field = report.field
    axes = listed(list(field.spread))
    if not field.standing:
        return Message("over {axes}", axes=axes)
    return Message("over {axes}, at {place}", axes=axes, place=place(field.standing))


def _spacing(steps_mm: Mapping[str, float]) -> Number:
    return Number(", ".join(f"{name} {step:.3g} mm" for name, step in steps_mm.items()))


UNPACKING: Final = """<!DOCTYPE html><meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="default-src 'none'; \
script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"><script>(async () => {
try {
  const packed = Uint8Array.from(atob("%s"), c => c.charCodeAt(0));
  const text = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  document.open(); document.write(text); document.close();
} catch (old) { parent.document.body.classList.add("flat"); }
})();</script>"""
"""Page that unpacks the viewer, two thirds of which would be its code; a browser that cannot shows the picture for paper."""


def _viewer(report: MachineReport) -> str:
    field, rows = report.field, report.field.drawn
    inner = field_html(
        field.point_mm[rows],
        field.error_um[rows],
        title=say("Error of the tool point {over}", over=_over(report)),
        edges=field.edges(),
        illustrative=bool(report.illustrative),
    )
    title, packed = (
        say("Error field in 3D: drag to rotate"),
        base64.b64encode(gzip.compress(inner.encode(), mtime=0)).decode(),
    )
    return f'<iframe title="{html.escape(title)}" srcdoc="{html.escape(UNPACKING % packed)}"></iframe>'


def _coded(text: str) -> Html:
    """Return plain text as HTML, with text in back quotes as code."""
    return Html(re.sub(r"`([^`]*)`", r"<code>\1</code>", say_html(text)))


def _degree(report: MachineReport, motion: Motion) -> str:
    """Return the terms of a motion's curve, in its basis, those above the noise if identified, and added effects."""
    order = motion.order
    identified = report.identified
    chosen = None if identified is None or identified.others else identified.orders.get(motion.name)
    noun = basis_named(motion.basis).order_noun if motion.basis else Basis.order_noun
    text: str = "–" if order is None else Message("{noun} {order}", noun=noun, order=order)
    if chosen == 0 and chosen != order:
        text = Message("{terms}, nothing above the noise", terms=text)
    elif chosen is not None and chosen != order:
        text = Message("{terms}, {noun} {order} above the noise", terms=text, noun=noun, order=chosen)
    return joined(" + ", [text, *([", ".join(motion.added)] if motion.added else [])])


def _numbers(report: MachineReport, effect: Effect) -> str:
    known = report.calibration.covariance
    texts = []
    for one in effect.parameters:
        name = one.name.rpartition(".")[2]
        half = COVERAGE_FACTOR * uncertainty_of(one.name, known)
        texts.append(joined(" ", [PARAMETERS.get(name, name), with_half(one.value, half, one.unit)]))
    return joined("; ", texts)


def _rows_of(rows: Sequence[tuple[int, str]]) -> list[str]:
    texts: list[str] = [Message("line {line}: {reason}", line=line, reason=reason) for line, reason in rows[:ROWS]]
    more = len(rows) - ROWS
    return [*texts, Message("and {count} more, all in the JSON", count=more)] if more > 0 else texts


def _tables_of(control: ControlSection) -> list[str]:
    others = [f"{entry.file.name} ({entry.format})" for entry in (*control.kinematics, *control.live)]
    return [*(f"{table.file.name} ({' '.join(table.classes)})" for table in control.tables), *others]
