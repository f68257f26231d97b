"""The diagnosis as one HTML file: expected and actual residuals, causes tested, evidence, alternatives, gain, next measurement.

The first screen is for the machine operator: the error, its effect at the tool, what to do, what to avoid. Symbols accompany names in
words, they never replace them. Pictures are embedded; nothing is fetched. The text is in the templates of this package.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from twin._common.messages import Message, joined
from twin._common.provenance import warning_texts
from twin.diagnosis import plots, text
from twin.diagnosis.plots import plot_panel, plot_unexplained
from twin.diagnosis.result import Cause, DiagnosisResult, readable_unit
from twin.diagnosis.text import column
from twin.display import render
from twin.display.figures import embedded
from twin.display.numbers import listed, lower
from twin.display.sheet import Sheet
from twin.measurement.columns import assumptions, grouped_notes
from twin.model.effects.specification import NOTHING

UNLISTED_P_VALUE: Final = 0.5  # p-value above which a cause tested is not listed
COLOURS: Final = {"well": "#e8f3ea", "wrong": "#fdf2df", "unknown": "#fbe4de", "disturbed": "#e6eff8"}


def diagnosis_html(diagnosis: DiagnosisResult, sheet: Sheet | None = None) -> str:
    """Return one self-contained HTML page; needs matplotlib (extra ``plots``).

    Args:
        diagnosis: the result of `twin.diagnosis.diagnose`.
        sheet: facts of the test, for a page that is handed over.

    Examples:
        >>> from pathlib import Path
        >>> machine = twin.Machine.load("dmu50")
        >>> model, tracker = twin.Calibration.default(machine), twin.instruments.LaserTracker()
        >>> plan = twin.thesis_plan.plan(machine)
        >>> along_x = plan.select(plan.approach[:, 0] != 0)
        >>> data, _ = twin.simulate(along_x, machine, model, tracker, np.random.default_rng(2))
        >>> page = twin.diagnosis_html(twin.diagnose(data, machine, model, instrument=tracker))
        >>> _ = Path("diagnosis.html").write_text(page, encoding="utf-8")
    """
    title, mood = text.headline(diagnosis)
    machine = diagnosis.calibration.machine.name
    left = diagnosis.unexplained
    columns = [] if left is None else [column(name) for name in left.depends_on]
    return render(
        "diagnosis/templates/diagnosis.html.j2",
        found=diagnosis,
        sheet=sheet,
        heading=Message("Diagnosis of a machine tool"),
        machine_name=machine,
        NOTHING=NOTHING,
        title=joined("", [title, f": {machine}"]),
        headline=title,
        colour=COLOURS[mood],
        machine=machine,
        source=Path(diagnosis.data.source).name,
        badges=(*warning_texts(diagnosis.warnings), *assumptions(diagnosis.data.notices)),
        first_facts=text.facts(diagnosis),
        ranked=_ranked(diagnosis),
        several=len({(cause.effect, cause.where) for cause in diagnosis.causes}) > 1,
        mapped=plot_unexplained(diagnosis),
        mapped_over=listed(columns[:2]),
        left_over=listed(columns) if columns else "",
        compared=text.compared(diagnosis),
        plots=plots,
        words=text,
        embedded=embedded,
        grouped_notes=grouped_notes,
        alternatives=_alternatives,
        picture=lambda panel, caption: embedded(
            plot_panel(panel), Message("{title}: {y} against {x}", title=panel.title, y=panel.y, x=panel.x), caption
        ),
        readable_unit=readable_unit,
    )


def _ranked(diagnosis: DiagnosisResult) -> list[dict[str, Any]]:
    """Return the causes found and those tested with a p-value below `UNLISTED_P_VALUE`, with their kind: found, doubted or none."""
    named = {(cause.effect, cause.where) for cause in diagnosis.causes}
    doubted = {key for cause in diagnosis.causes for key in cause.equivalent}
    ranked = []
    for effect, where, explains, p in diagnosis.ranking:
        key = (effect, where)
        kind = "found" if key in named else "doubted" if key in doubted else ""
        if p < UNLISTED_P_VALUE or kind == "found":
            line = {"effect": effect, "where": where, "explains": explains, "p_value": p}
            ranked.append({**line, "kind": kind, "doubted": key in doubted})
    return ranked


def _alternatives(cause: Cause) -> str:
    """Return the alternatives to a cause in words with their symbols."""
    return listed(cause.alternatives(lambda *key: lower(text.named(*key))))
