"""A machine's report as one HTML file: first what to do, then what it rests on. Needs the extra ``plots`` (matplotlib).

Pictures and the field in 3D are embedded; nothing is fetched. On paper a still picture stands in for the field.
"""

from __future__ import annotations

import re
from typing import Final

from twin._common.provenance import SourceWarning
from twin.diagnosis.wording.words import tied
from twin.display.page import bullets, document, escaped
from twin.report.advice import Step
from twin.report.numbers import UNKNOWN, expanded, figure, place
from twin.report.result import MachineReport
from twin.report.sections import (
    VIEWER,
    after_part,
    budget_part,
    constants_part,
    field_part,
    gaps_part,
    known_part,
    motions_part,
    sources_part,
    viewer,
)

COLOURS: Final = {"well": "#e8f3ea", "wrong": "#fdf2df", "unknown": "#fbe4de"}
MARKS: Final = {"do": "✔ Do", "measure": "◎ Measure", "never": "✘ Do not", "unknown": "? Not known"}
HEAD: Final = (
    "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:\">"
)
"""Nothing can be fetched, whatever the page holds."""
MORE_STYLE: Final = """
.drawn{background:#1b1b1b;color:#fff;padding:.7rem 1.2rem;border-radius:.5rem;margin:.3rem 0 .8rem;font-weight:600}
.drawn p{font-weight:400}
.step{display:grid;grid-template-columns:8.2rem 1fr;gap:.1rem .8rem;margin:.55rem 0}.step b.mark{white-space:nowrap}
code{font-size:.92em;background:#0000000d;border-radius:.2rem;padding:0 .2rem;overflow-wrap:anywhere}
iframe{width:100%;height:30rem;border:1px solid #ccc;border-radius:.4rem;display:block}
.paper{display:none}.flat iframe{display:none}.flat .paper{display:block}
.big{font-size:1.35rem;font-weight:650;white-space:nowrap}
.key{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,13rem),1fr));gap:.5rem 1rem;margin:.7rem 0}
.key div{background:#ffffffb0;border:1px solid #0002;border-radius:.4rem;padding:.4rem .7rem}
.squares{display:grid;grid-template-columns:repeat(auto-fit,minmax(11rem,1fr));gap:.4rem}
.squares figure{max-width:14rem}figure.paper{max-width:none}.after figure{max-width:44rem}
td,th{overflow-wrap:break-word}th.n{white-space:normal}td.hash{font-size:.78rem;overflow-wrap:anywhere;font-family:ui-monospace,monospace}
@media(max-width:600px){.step{grid-template-columns:1fr}.drawn{padding:.6rem .8rem}iframe{height:24rem}
table{font-size:.84rem}td,th{padding:.25rem .2rem}.source{display:none}}
@media print{iframe{display:none}.paper{display:block}.verdict{break-inside:auto;font-size:.93em}
.step{margin:.3rem 0}.key div,.step,.drawn,h3{break-inside:avoid}
thead{display:table-header-group}.figures{grid-template-columns:repeat(2,1fr);gap:.4rem .6rem}h3{break-after:avoid}}
"""


def machine_html(report: MachineReport) -> str:
    """One self-contained page; needs matplotlib (extra ``plots``).

    Args:
        report: what `twin.report.machine_report` worked out.
    """
    name = report.machine.name
    file = "no calibration" if report.calibration.path is None else report.calibration.path.name
    made = report.sources.made.strftime("%d %B %Y")
    head = f"{name} · {file} · {made} · tool length {report.kinematics.tool_length_mm:g} mm"
    parts = [
        f"<p class=small>{escaped(head)}{escaped(_conditions(report))}</p>{_warnings(report)}",
        f'<div class=verdict style="background:{COLOURS[report.advice.mood]}">{_summary(report)}</div>',
        "<h2>What each error makes at the tool</h2>" + budget_part(report),
        "<h2>Error motions, axis by axis</h2>" + motions_part(report),
        "<h2>Squareness, and where the rotary axes lie</h2>" + constants_part(report),
        "<h2>The error over the working space</h2>" + field_part(report),
        "<h2>Before and after compensation</h2>" + after_part(report),
        "<h2>How well it is known</h2>" + known_part(report),
        "<h2>What this calibration does not know</h2>" + gaps_part(report),
        "<h2>Where it comes from</h2>" + sources_part(report),
    ]
    # Numbers keep to their units in the text; what the viewer is made of stays as it is.
    body = tied("".join(parts), "&nbsp;").replace(VIEWER, viewer(report))
    return document(f"{name}: report of the machine", body, more_style=MORE_STYLE, head=HEAD)


def _conditions(report: MachineReport) -> str:
    told = report.kinematics.conditions.channels
    return "".join(f" · {name} {value:g}" for name, value in told.items())


def _warnings(report: MachineReport) -> str:
    """Where the numbers come from, if that is to be minded: in front of everything else."""
    return "".join(
        f"<div class=drawn>▲ {one.title}<p>{escaped(_meaning(one, report))}</p></div>" for one in report.warnings
    )


def _meaning(one: SourceWarning, report: MachineReport) -> str:
    if one.name == "illustrative":
        count = f"{len(report.illustrative)} of the {len(report.calibration.curves)} error motions of this calibration"
        return f"{count} are drawn, not measured (marked * below). Do not cut, adjust or fill tables with it."
    return one.sentence[0].upper() + one.sentence[1:]


def _summary(report: MachineReport) -> str:
    advice = report.advice
    text = f"<h1>{escaped(advice.headline)}</h1>"
    if report.budget.errors:
        text += _key(report)
    if advice.wrong:
        text += "<p><b>Wrong most</b></p>" + bullets(escaped(line) for line in advice.wrong)
    return text + "".join(_step(step) for step in advice.steps)


def _key(report: MachineReport) -> str:
    """The three numbers a production manager asks for."""
    outcome = report.after
    total = report.budget.total
    left = "–" if outcome.exact is None else UNKNOWN
    if outcome.likely is not None:
        left = f"{'' if outcome.complete else 'at least '}{figure(outcome.likely.rms_um, 'µm')}"
    cells = [
        (
            "As it is",
            figure(total.rms_um, "µm"),
            f"RMS at the tool; up to {figure(total.max_um, 'µm')} at {place(report.budget.worst)}",
        ),
        (
            "Compensated",
            left,
            "no programs on this machine"
            if outcome.exact is None
            else "RMS to be expected"
            if outcome.likely is not None
            else "the calibration gives no uncertainty",
        ),
        (
            "Uncertain by",
            expanded(total.u_rms_um, complete=total.u_complete),
            "U at the tool (95 %), RMS over the working space",
        ),
    ]
    return (
        "<div class=key>"
        + "".join(
            f"<div>{escaped(name)}<br><span class=big>{escaped(value)}</span><br><span class=small>{escaped(note)}</span></div>"
            for name, value, note in cells
        )
        + "</div>"
    )


def _step(step: Step) -> str:
    return f"<div class=step><b class=mark>{MARKS[step.kind]}</b><div><b>{escaped(step.title)}.</b> {_coded(step.text)}</div></div>"


def _coded(text: str) -> str:
    """Plain text as HTML, commands between back quotes as such."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", escaped(text))
