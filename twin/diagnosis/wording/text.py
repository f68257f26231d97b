"""A diagnosis as text for the terminal, and in short for a notebook."""

from __future__ import annotations

import html
from collections.abc import Sequence
from textwrap import wrap
from typing import Final

from twin._common.provenance import texts
from twin.diagnosis.result import Answer, Cause, readable_unit
from twin.diagnosis.wording.verdict import facts, headline, sentence
from twin.diagnosis.wording.words import (
    coefficient,
    contests,
    grouped,
    held_out_words,
    likelihood_words,
    listed,
    lower,
    measured,
    missing,
    odds,
    percent,
    plain,
    probability,
    symbol,
)
from twin.display.numbers import tied
from twin.measurement.checks import assumptions, grouped_notes

WIDTH: Final = 100
ABSORBED: Final = 0.9
"""Share of the residual below which it is said how much the calibration's own uncertainty takes up."""
HARD: Final = "\u00a0"


def diagnosis_text(diagnosis: Answer) -> str:
    """For people, in lines of at most `WIDTH`: the verdict, what follows, each cause, what it gains, what to measure next.

    Args:
        diagnosis: what `twin.diagnosis.diagnose` found.
    """
    lines = _wrapped(
        f"{diagnosis.verdict.upper()}. {headline(diagnosis)[0].removesuffix(' Found:').removesuffix('.')}."
    )
    for text in (*texts(diagnosis.warnings), *assumptions(diagnosis.data.notices)):
        lines += _wrapped(text, hang=2)
    for cause in diagnosis.causes:
        lines += ["", *_cause(cause)]
    lines.append("")
    for name, text in facts(diagnosis):
        lines += _wrapped(f"{name}: {text}", hang=2)
    lines += [
        "",
        *_wrapped(
            f"The readings differ from the model by {diagnosis.rms_um:.3g} µm RMS a coordinate; {diagnosis.expected_rms_um:.3g} µm "
            f"were expected, from {diagnosis.scatter} ({probability(diagnosis.p_value)}, {diagnosis.tried} causes tried).",
            hang=2,
        ),
    ]
    if diagnosis.absorbed_rms_um < ABSORBED * diagnosis.rms_um:
        absorbed = f"{diagnosis.absorbed_rms_um:.3g} µm are left once the calibration's stated uncertainty has taken up what it can"
        lines += _wrapped(f"{absorbed}.", start=2, hang=2)
    if diagnosis.unexplained is not None:
        lines += _wrapped(f"Left unexplained: {diagnosis.unexplained.evidence}.", hang=2)
    lines += _gain(diagnosis)
    if diagnosis.next_measurement:
        lines += ["", "What to measure next"]
    for one in contests(diagnosis.next_measurement, diagnosis.expected_rms_um):
        lines += _wrapped(f"To tell {lower(one.names[0])} from {lower(one.names[1])}: {one.verdict}", start=2, hang=4)
        for pose, sides, target, station, apart in one.rows:
            come = f", arriving {sides}" if sides else ""
            lines += _wrapped(
                f"{pose}, target {target}, station {station}{come}: they differ by {apart}", start=4, hang=8
            )
    for entry in diagnosis.next_measurement:
        if "separates" not in entry:
            lines += _wrapped(str(entry["text"]), start=2, hang=4)
    lines += _listing("These readings could not show, however large:", grouped(diagnosis.unidentifiable))
    lines += _listing("Not tried, for want of a column:", missing(diagnosis.not_evaluated))
    aside = diagnosis.data.set_aside
    if aside:
        lines += _listing(f"Readings not used ({len(aside)}):", grouped_notes(aside))
    assumed = assumptions(diagnosis.data.notices)
    lines += _listing("Notes:", [notice for notice in diagnosis.data.notices if notice not in assumed])
    return "\n".join(lines) + "\n"


def diagnosis_brief(diagnosis: Answer) -> str:
    """The verdict and a table of the causes, as HTML for a notebook.

    Args:
        diagnosis: what `twin.diagnosis.diagnose` found.
    """
    title, mood = headline(diagnosis)
    edge = {"well": "#009e73", "wrong": "#e69f00", "unknown": "#d55e00", "disturbed": "#0072b2"}[mood]
    rows = [("cause", "how much", "of the misfit", "could as well be")] if diagnosis.causes else []
    rows += [
        (
            f"<b>{_e(plain(one.effect, one.where))}</b> <small>{_e(symbol(one.effect, one.where))}</small>",
            _e(_numbers(one)),
            percent(one.share),
            _e(listed([plain(*key) for key in one.equivalent], most=3)) or "nothing",
        )
        for one in diagnosis.causes
    ]
    left = "text-align:left"
    body = "".join("<tr>" + "".join(f"<td style='{left}'>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    table = f"<table>{body}</table>" if rows else ""
    told = "".join(f"<div><b>{_e(name)}:</b> {_e(text)}</div>" for name, text in facts(diagnosis))
    drawn = "".join(f"<div><b>{_e(one.title)}</b>: {_e(one.sentence)}</div>" for one in diagnosis.warnings)
    return (
        f"<div style='border-left:.4em solid {edge};padding:.2em 1em'><p><b>{_e(title)}</b> <small>{diagnosis.verdict}</small></p>"
        f"{drawn}{table}{told}</div>"
    )


def _cause(cause: Cause) -> list[str]:
    lines = _wrapped(
        f"{plain(cause.effect, cause.where)} ({symbol(cause.effect, cause.where)}, {cause.origin})", hang=2
    )
    lines += _wrapped(sentence(cause), start=4, hang=4)
    if cause.parameters:
        lines += _wrapped(_numbers(cause), start=4, hang=6)
    if cause.share > 0.0:
        lines += _wrapped(
            f"{percent(cause.share)} of what is beyond the scatter, {probability(cause.p_value)}", start=4, hang=6
        )
    if cause.probability is not None:
        lines += _wrapped(likelihood_words(cause.probability, not cause.equivalent), start=4, hang=6)
    for rival in cause.rivals[:1]:
        name = f"{plain(rival.effect, rival.where)} ({symbol(rival.effect, rival.where)})"
        lines += _wrapped(f"ruled out in its place: {name}, {odds(rival.log_odds)}", start=4, hang=6)
    if cause.equivalent:
        names = [f"{plain(*key)} ({symbol(*key)})" for key in cause.equivalent]
        lines += _wrapped(f"could as well be: {listed(names)}", start=4, hang=6)
    return lines


def _numbers(cause: Cause) -> str:
    told = [
        f"{q.name.replace('_', ' ')} {measured(q.value, q.u, readable_unit(q.unit))}"
        for q in cause.parameters
        if not coefficient(q.name)
    ]
    curve = len(cause.parameters) - len(told)
    numbers = [f"{', '.join(told)} (95 %)"] if told else []
    return "; ".join([*numbers, *([f"a curve of {curve} coefficients"] if curve else [])])


def _gain(diagnosis: Answer) -> list[str]:
    gain = diagnosis.gain
    if gain is None:
        return []
    text = f"Modelling it: {gain.rms_before_um:.3g} → {gain.rms_after_um:.3g} µm"
    held = gain.held_out
    if held is not None:
        text += f"; on {held_out_words(held.of)} left out of the fit {held.before_um:.3g} → {held.after_um:.3g} µm"
        if held.ci95_um is not None:
            low, high = held.ci95_um
            text += f" (less by {low:.2g} to {high:.2g}, 95 %)".replace("-", "−")
    if gain.tool_before_um > 0.0:
        text += f"; at the tool over the working volume, compensated, {gain.tool_before_um:.3g} → {gain.tool_after_um:.2g} µm RMS"
    return _wrapped(f"{text}.", hang=2)


def _listing(title: str, items: Sequence[str]) -> list[str]:
    if not items:
        return []
    return ["", title, *(line for item in items for line in _wrapped(item, start=2, hang=4))]


def _wrapped(text: str, *, start: int = 0, hang: int = 0) -> list[str]:
    indents = {"initial_indent": " " * start, "subsequent_indent": " " * hang}
    lines = wrap(tied(text, HARD), WIDTH, **indents, break_long_words=False, break_on_hyphens=False)  # type: ignore[arg-type]
    return [line.replace(HARD, " ") for line in lines]


def _e(text: str) -> str:
    return html.escape(text)
