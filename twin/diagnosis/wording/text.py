"""A diagnosis as text for the terminal, and as a short table for a notebook."""

from __future__ import annotations

import html
from collections.abc import Sequence
from textwrap import wrap
from typing import Final

from twin._common.provenance import warning_texts
from twin.diagnosis.result import Cause, DiagnosisResult, readable_unit
from twin.diagnosis.wording.verdict import facts, headline, sentence
from twin.diagnosis.wording.words import (
    cause_title,
    coefficient,
    grouped,
    held_out_words,
    likelihood_words,
    measured,
    micrometres,
    missing,
    odds,
    percent,
    separating_points,
    symbol,
)
from twin.display.numbers import p_value_text, with_joined_units
from twin.display.sentences import listed, lower
from twin.measurement.checks import assumptions, grouped_notes

WIDTH: Final = 100
ABSORBED: Final = 0.9
"""Ratio of the RMS residual with and without the calibration's uncertainty below which both are given."""
HARD: Final = "\u00a0"


def diagnosis_text(diagnosis: DiagnosisResult) -> str:
    """Return the verdict, each cause, what to do, the gain and what to measure next, in lines of at most `WIDTH` characters.

    Args:
        diagnosis: the result of `twin.diagnosis.diagnose`.
    """
    lines = _wrapped(
        f"{diagnosis.verdict.upper()}. {headline(diagnosis)[0].removesuffix(' Found:').removesuffix('.')}."
    )
    for text in (*warning_texts(diagnosis.warnings), *assumptions(diagnosis.data.notices)):
        lines += _wrapped(text, hang=2)
    for cause in diagnosis.causes:
        lines += ["", *_cause(cause)]
    lines.append("")
    for name, text in facts(diagnosis):
        lines += _wrapped(f"{name}: {text}", hang=2)
    lines += [
        "",
        *_wrapped(
            f"RMS residual {diagnosis.rms_um:.3g} µm per coordinate, {diagnosis.expected_rms_um:.3g} µm expected from "
            f"{diagnosis.noise_source} ({p_value_text(diagnosis.p_value)}, {diagnosis.tried} causes tested).",
            hang=2,
        ),
    ]
    if diagnosis.absorbed_rms_um < ABSORBED * diagnosis.rms_um:
        absorbed = (
            f"{diagnosis.absorbed_rms_um:.3g} µm remain after allowing for the uncertainty stated in the calibration"
        )
        lines += _wrapped(f"{absorbed}.", start=2, hang=2)
    if diagnosis.unexplained is not None:
        lines += _wrapped(f"Unexplained: {diagnosis.unexplained.evidence}.", hang=2)
    lines += _gain(diagnosis)
    if diagnosis.next_measurement:
        lines += ["", "What to measure next"]
    for one in separating_points(diagnosis.next_measurement, diagnosis.expected_rms_um):
        lines += _wrapped(
            f"To separate {lower(one.names[0])} from {lower(one.names[1])}: {one.verdict}", start=2, hang=4
        )
        for pose, sides, target, station, difference in one.rows:
            approached = f", approached from {sides}" if sides else ""
            lines += _wrapped(
                f"{pose}, target {target}, station {station}{approached}: difference {difference}", start=4, hang=8
            )
    for entry in diagnosis.next_measurement:
        if "separates" not in entry:
            lines += _wrapped(str(entry["text"]), start=2, hang=4)
    lines += _listing("Not identifiable from these readings, whatever their size:", grouped(diagnosis.unidentifiable))
    lines += _listing("Not tested, because the table lacks these columns:", missing(diagnosis.not_evaluated))
    unused = diagnosis.data.set_aside
    if unused:
        lines += _listing(f"Readings not used ({len(unused)}):", grouped_notes(unused))
    assumed = assumptions(diagnosis.data.notices)
    lines += _listing("Notes:", [notice for notice in diagnosis.data.notices if notice not in assumed])
    return "\n".join(lines) + "\n"


def diagnosis_brief(diagnosis: DiagnosisResult) -> str:
    """Return the verdict and a table of the causes, as HTML for a notebook.

    Args:
        diagnosis: the result of `twin.diagnosis.diagnose`.
    """
    title, mood = headline(diagnosis)
    edge = {"well": "#009e73", "wrong": "#e69f00", "unknown": "#d55e00", "disturbed": "#0072b2"}[mood]
    rows = [("cause", "size", "share of the excess", "alternatives")] if diagnosis.causes else []
    rows += [
        (
            f"<b>{_e(cause_title(one.effect, one.where))}</b> <small>{_e(symbol(one.effect, one.where))}</small>",
            _e(_numbers(one)),
            percent(one.share),
            _e(listed([cause_title(*key) for key in one.equivalent], most=3)) or "none",
        )
        for one in diagnosis.causes
    ]
    left = "text-align:left"
    body = "".join("<tr>" + "".join(f"<td style='{left}'>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    table = f"<table>{body}</table>" if rows else ""
    advice = "".join(f"<div><b>{_e(name)}:</b> {_e(text)}</div>" for name, text in facts(diagnosis))
    warnings = "".join(f"<div><b>{_e(one.title)}</b>: {_e(one.sentence)}</div>" for one in diagnosis.warnings)
    return (
        f"<div style='border-left:.4em solid {edge};padding:.2em 1em'><p><b>{_e(title)}</b> <small>{diagnosis.verdict}</small></p>"
        f"{warnings}{table}{advice}</div>"
    )


def _cause(cause: Cause) -> list[str]:
    lines = _wrapped(
        f"{cause_title(cause.effect, cause.where)} ({symbol(cause.effect, cause.where)}, {cause.origin})", hang=2
    )
    lines += _wrapped(sentence(cause), start=4, hang=4)
    if cause.parameters:
        lines += _wrapped(_numbers(cause), start=4, hang=6)
    if cause.share > 0.0:
        lines += _wrapped(
            f"explains {percent(cause.share)} of the excess over noise, {p_value_text(cause.p_value)}", start=4, hang=6
        )
    if cause.probability is not None:
        lines += _wrapped(likelihood_words(cause.probability, not cause.equivalent), start=4, hang=6)
    for rival in cause.rivals[:1]:
        name = f"{cause_title(rival.effect, rival.where)} ({symbol(rival.effect, rival.where)})"
        lines += _wrapped(f"next best, ruled out: {name}, {odds(rival.log_odds)}", start=4, hang=6)
    if cause.equivalent:
        names = [f"{cause_title(*key)} ({symbol(*key)})" for key in cause.equivalent]
        lines += _wrapped(f"fits these readings equally well: {listed(names)}", start=4, hang=6)
    return lines


def _numbers(cause: Cause) -> str:
    values = [
        f"{q.name.replace('_', ' ')} {measured(q.value, q.u, readable_unit(q.unit))}"
        for q in cause.parameters
        if not coefficient(q.name)
    ]
    curve = len(cause.parameters) - len(values)
    numbers = [f"{', '.join(values)} (95 %)"] if values else []
    return "; ".join([*numbers, *([f"a curve of {curve} coefficients"] if curve else [])])


def _gain(diagnosis: DiagnosisResult) -> list[str]:
    gain = diagnosis.gain
    if gain is None:
        return []
    text = f"RMS residual without → with the causes: {gain.rms_before_um:.3g} → {gain.rms_after_um:.3g} µm"
    held = gain.held_out
    if held is not None:
        text += f"; on held-out {held_out_words(held.of)} {held.before_um:.3g} → {held.after_um:.3g} µm"
        if held.ci95_um is not None:
            low, high = held.ci95_um
            text += f" (reduced by {micrometres(low)} to {micrometres(high)}, 95 %)".replace("-", "−")
    if gain.tool_before_um > 0.0:
        text += f"; compensated, at the tool over the working volume, {micrometres(gain.tool_before_um)} → "
        text += f"{micrometres(gain.tool_after_um)} RMS"
    return _wrapped(f"{text}.", hang=2)


def _listing(title: str, items: Sequence[str]) -> list[str]:
    if not items:
        return []
    return ["", title, *(line for item in items for line in _wrapped(item, start=2, hang=4))]


def _wrapped(text: str, *, start: int = 0, hang: int = 0) -> list[str]:
    indents = {"initial_indent": " " * start, "subsequent_indent": " " * hang}
    lines = wrap(with_joined_units(text, HARD), WIDTH, **indents, break_long_words=False, break_on_hyphens=False)  # type: ignore[arg-type]
    return [line.replace(HARD, " ") for line in lines]


def _e(text: str) -> str:
    return html.escape(text)
