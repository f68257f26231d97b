"""The diagnosis as one HTML file that reads as an argument: expected, seen, tried, why this one, doubted, gained, to be measured next.

The first screen is for the machinist: what is wrong, how much it makes, what to do, what not. Symbols stand beside words, never
instead of them. Pictures are embedded; nothing is fetched.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from twin._common.provenance import texts
from twin.diagnosis.result import Answer, Cause, readable_unit
from twin.diagnosis.wording.panels import Panel, cause_panels, residual_panels
from twin.diagnosis.wording.plots import alone, plot_left
from twin.diagnosis.wording.verdict import SHOWN, advised, either_side, facts, headline, moves, sentence
from twin.diagnosis.wording.words import (
    capital,
    chance,
    coefficient,
    column,
    contests,
    grouped,
    held_out_words,
    kind,
    listed,
    lower,
    measured,
    missing,
    odds,
    percent,
    plain,
    probability,
    side,
    symbol,
    tied,
)
from twin.display.page import bullets as _list
from twin.display.page import document
from twin.display.page import embedded as _embedded
from twin.display.page import escaped as _e
from twin.display.page import facts as _facts
from twin.machine.effects.specification import NOTHING
from twin.measurement.checks import assumptions, grouped_notes

LIKELY: Final = 0.5
"""Chance above which a cause is not worth a line."""
ONCE: Final = ("frame_shift", "target_shift", "station_drift", "thermal_drift")
"""Causes that belong to one time of the measurement."""
COLOURS: Final = {"well": "#e8f3ea", "wrong": "#fdf2df", "unknown": "#fbe4de", "disturbed": "#e6eff8"}


def diagnosis_html(diagnosis: Answer) -> str:
    """One self-contained page; needs matplotlib (extra ``plots``).

    Args:
        diagnosis: what `twin.diagnosis.diagnose` found.
    """
    title, mood = headline(diagnosis)
    machine = diagnosis.calibration.machine
    source = Path(diagnosis.data.source).name
    parts = [
        f"<p class=small>{_e(machine.name)} · {_e(source)} · {diagnosis.points:,} readings {_drawn(diagnosis)}</p>",
        f'<div class=verdict style="background:{COLOURS[mood]}"><h1>{_e(title)}</h1>{_first_screen(diagnosis)}</div>',
        "<h2>What was expected</h2>" + _expected(diagnosis),
        "<h2>What was seen</h2>" + _seen(diagnosis),
        "<h2>What was tried, and how it ranked</h2>" + _tried(diagnosis),
    ]
    if diagnosis.causes:
        parts.append("<h2>Why this one</h2>" if len(diagnosis.causes) == 1 else "<h2>Why these</h2>")
        parts += [_why(diagnosis, cause) for cause in diagnosis.causes]
        parts.append("<h2>What it could be mistaken for</h2>" + _mistaken(diagnosis))
    if diagnosis.unexplained is not None:
        parts.append("<h2>What is left unexplained</h2>" + _left(diagnosis))
    if diagnosis.causes or diagnosis.gain is not None:
        parts.append("<h2>What changes when it is modelled</h2>" + _gain(diagnosis))
    parts.append("<h2>What to measure next</h2>" + _next(diagnosis))
    parts.append("<h2>Small print</h2>" + _small_print(diagnosis))
    body = tied("".join(parts), "&nbsp;")
    return document(f"{title}: {machine.name}", body)


def _drawn(diagnosis: Answer) -> str:
    """Badges of what is not measured on a machine, or was assumed of the readings."""
    return " ".join(
        f"<span class=badge>{_e(text)}</span>"
        for text in (*texts(diagnosis.warnings), *assumptions(diagnosis.data.notices))
    )


def _first_screen(diagnosis: Answer) -> str:
    causes = diagnosis.causes
    text = "".join(
        f"<p class=cause><b>{_e(plain(one.effect, one.where))}</b> {_symbol(one)}<br>{_e(sentence(one))}</p>"
        for one in causes[:SHOWN]
    )
    if len(causes) > SHOWN:
        text += f"<p>And {len(causes) - SHOWN} more below.</p>"
    return text + _facts(*facts(diagnosis))


def _expected(diagnosis: Answer) -> str:
    calibration = diagnosis.calibration
    source = calibration.source if calibration.path is None else f"{calibration.path.name}: {calibration.source}"
    return (
        f"<p>The model is {_e(calibration.machine.name)} with the calibration that was given (<span class=small>{_e(source)}</span>). "
        "What was not told of where the instrument stood and where its targets sit was fitted, and nothing else. If the model is "
        f"right, the readings differ from it by their own scatter only: <b>{diagnosis.expected_rms_um:.3g} µm</b> a coordinate (RMS), "
        f"from {_e(diagnosis.scatter)}.</p>"
    )


def _seen(diagnosis: Answer) -> str:
    said = "It goes with none of the columns of the table"
    if diagnosis.trends or diagnosis.unexplained is not None:
        said = "Where it shows most"
    elif diagnosis.causes:
        said = "No column of the table shows it by itself"
    how = f"The chance that scatter alone does this: {chance(diagnosis.p_value)}."
    if diagnosis.causes and all(cause.effect == "read_back" for cause in diagnosis.causes):
        how, said = (
            "That is as expected, with the axes where they were told to go.",
            "It goes with none of the columns of the table",
        )
    return (
        f"<p>They differ by <b>{diagnosis.rms_um:.3g} µm</b> a coordinate (RMS). {how}</p>"
        f"{_figures(residual_panels(diagnosis))}<p class=small>{said}. Dots: means of what was read "
        "less what the model foresees, in the directions of the machine (x, y, z); bars: their 95 % intervals, from the scatter of the "
        "readings in them. A model that is right leaves the dots on the line at zero.</p>"
    )


def _tried(diagnosis: Answer) -> str:
    text = f"<p>{diagnosis.tried} possible causes in machine, calibration and instrument were tried. "
    if not diagnosis.ranking:
        return text + "None of them explains anything.</p>"
    named = {(cause.effect, cause.where) for cause in diagnosis.causes}
    doubted = {key for cause in diagnosis.causes for key in cause.equivalent}
    ranked = [one for one in diagnosis.ranking if one[3] < LIKELY or one[:2] in named]
    if not ranked:
        return text + "None of them explains more than scatter does.</p>"
    shown = {one[:2] for one in ranked}
    most = max(explained for _, _, explained, _ in ranked)
    rows = []
    for effect, where, explained, p in ranked:
        of = "found" if (effect, where) in named else "doubted" if (effect, where) in doubted else ""
        name = f"<b>{_e(plain(effect, where))}</b>" if of == "found" else _e(plain(effect, where))
        bar = f'<span class="bar {of}" style="width:{100 * explained / most:.0f}%"></span>'
        rows.append(
            f"<tr><td>{name} <span class=symbol>{_e(symbol(effect, where))}</span><td class=bars>{bar}<td class=n>{explained:.0f}"
            f"<td class=w>{chance(p)}"
        )
    text += f"The first {len(rows)}, each alone, in the order of the chance that scatter looks like that somewhere among all tried. "
    text += "Orange: found. " if named & shown else ""
    text += "Blue: cannot be told from what was found. " if doubted & shown else ""
    if diagnosis.verdict == "consistent":
        text += "None of them is more than scatter shows now and then. "
    if len(named) > 1:
        text += "A smaller cause may stand far down here: it comes to light when the larger are taken out."
    return (
        f"{text}</p><div class=wide><table><tr><th>cause<th class=bars>explains<th class=n>chi²<th>by chance{''.join(rows)}"
        "</table></div>"
    )


def _why(diagnosis: Answer, cause: Cause) -> str:
    belongs = {
        "instrument": f"<p><b>It belongs to the instrument</b> and enters no calibration. {NOTHING}</p>",
        "calibration": "<p><b>It belongs to the calibration file</b>, not to the machine.</p>",
        "machine": "",
    }[kind(cause.effect)]
    reasons = [] if cause.effect == "read_back" else [moves(cause)]
    if cause.share > 0.0:
        reasons.append(
            f"It explains {percent(cause.share)} of what is beyond the scatter. By chance: {chance(cause.p_value)}."
        )
    reasons += [
        f"Ruled out in its place: {_e(lower(plain(rival.effect, rival.where)))} "
        f"<span class=symbol>{_e(symbol(rival.effect, rival.where))}</span> would explain {percent(rival.share)}, "
        f"{odds(rival.log_odds)}."
        for rival in cause.rivals
    ]
    figures = "".join(_figure(panel, captioned=False) for panel in cause_panels(diagnosis, cause))
    caption = "Dots: means of what was read, all else that was found taken out; bars: their 95 % intervals. Line: what this cause says."
    text = (
        f"<h3>{_e(plain(cause.effect, cause.where))} {_symbol(cause)}</h3><p>{_e(capital(cause.evidence))}.</p>{belongs}"
        f"<div class=why><div>{figures}<p class=small>{caption if figures else ''}</p></div>"
        f"<div>{_list(reasons)}{_parameters(cause)}</div></div>"
    )
    told = advised(cause)
    if diagnosis.verdict == "unexplained" or cause.equivalent:
        # What to do stands on the first screen: not this yet.
        return text + _facts(told[0], told[2])
    return text + (_facts(*told) if len(diagnosis.causes) > 1 else "")


def _parameters(cause: Cause) -> str:
    """Its numbers; a curve's coefficients mean nothing to a reader and are counted."""
    told = [q for q in cause.parameters if not coefficient(q.name)]
    rows = [
        f"<tr><td>{_e(q.name.replace('_', ' '))}<td class=n>{_e(measured(q.value, q.u, readable_unit(q.unit)))}"
        for q in told
    ]
    if len(told) < len(cause.parameters):
        rows.append(f"<tr><td>curve<td>{len(cause.parameters) - len(told)} coefficients: in --json and --extended")
    return f"<table><tr><th>number<th class=n>value, 95 % interval{''.join(rows)}</table>" if rows else ""


def _mistaken(diagnosis: Answer) -> str:
    items = []
    for cause in diagnosis.causes:
        name = f"<b>{_e(plain(cause.effect, cause.where))}</b>"
        if not cause.equivalent:
            items.append(f"{name}: nothing else that was tried fits these readings nearly as well.")
            continue
        others = [f"{_e(lower(plain(*key)))} <span class=symbol>{_e(symbol(*key))}</span>" for key in cause.equivalent]
        meant = "With that the readings fit as well, within a factor of a hundred in likelihood; sizes are of what is named first."
        if either_side([cause]):
            meant += " It may thus be the instrument or the machine; of the instrument nothing is to be compensated."
        items.append(f"{name} could as well be {listed(others)}. {meant}")
    return _list(items)


def _left(diagnosis: Answer) -> str:
    left = diagnosis.unexplained
    if left is None:
        return ""
    stays = (
        "<p>Compensating what was found is not enough: this part stays, and it may have pulled at the sizes found.</p>"
    )
    stays = stays if diagnosis.causes and not (left.extension and left.extension.written) else ""
    if not left.depends_on:
        return f"<p>{_e(capital(left.evidence))}.</p>{stays}"
    names = listed([column(name) for name in left.depends_on])
    figures = [_figure(panel) for panel in residual_panels(diagnosis, after=True)[: len(left.depends_on)]]
    mapped = plot_left(diagnosis)
    if mapped is not None:
        over = listed([column(name) for name in left.depends_on[:2]])
        figures.insert(
            0, _embedded(mapped, f"what is left, over {over}", f"Over {over} together, {side(left.carrier)}")
        )
    return (
        f"<p>{percent(left.share)} of what is beyond the scatter goes with {_e(names)} ({_e(side(left.carrier))}) and fits nothing "
        f"that is known here.</p>{stays}<div class=figures>{''.join(figures)}</div>"
    )


def _gain(diagnosis: Answer) -> str:
    gain = diagnosis.gain
    if gain is None:
        return f"<p>Nothing enters the model. {NOTHING}</p>"
    expected = f"{diagnosis.expected_rms_um:.3g} expected"
    rows = [("readings less model", gain.rms_before_um, f"{gain.rms_after_um:.3g}", expected)]
    doubt = ""
    held = gain.held_out
    if held is not None:
        where = f"on {held_out_words(held.of)} left out of the fit"
        low, high = (float("nan"), float("nan")) if held.ci95_um is None else held.ci95_um
        less = f"less by {low:.2g} to {high:.2g} (95 %)"
        if held.ci95_um is None:
            less = f"too few {held_out_words(held.of)} for an interval"
        rows.append((f"the same, {where}", held.before_um, f"{held.after_um:.3g}", less))
        if low <= 0.0:
            doubt = f"<p>{capital(where)}, no gain is proven: what was found may not come back alike.</p>"
    if gain.tool_before_um > 0.0:
        where = "at the tool over the working volume, compensated"
        rows.append((where, gain.tool_before_um, f"{gain.tool_after_um:.2g}", "by what is uncertain in what was found"))
    body = "".join(
        f"<tr><td>{_e(name)}<td class=n>{before:.3g}<td class=n>{after}<td>{_e(note)}"
        for name, before, after, note in rows
    )
    text = f"<div class=wide><table><tr><th>µm RMS<th class=n>without<th class=n>with<th>{body}</table></div>{doubt}"
    if diagnosis.extended is diagnosis.calibration:
        only = all(cause.origin == "instrument" for cause in diagnosis.causes)
        text += f"<p>It is taken out of the account of the readings and enters no calibration. {NOTHING if only else ''}</p>"
    elif diagnosis.verdict == "unexplained" and not diagnosis.extended.empirical:
        text += "<p>Not enough to compensate with: something is left that is not in it.</p>"
    else:
        empirical = " --empirical" if diagnosis.unexplained is not None and diagnosis.unexplained.extension else ""
        text += (
            f"<p>To write the calibration with it, and to use it:</p><pre>twin diagnose … --extended better.yaml{empirical}\n"
            "twin compensate part.nc -o part.compensated.nc --calibration better.yaml</pre>"
        )
        if any(cause.origin == "instrument" for cause in diagnosis.causes):
            text += "<p>What belongs to the instrument is not in it.</p>"
    if diagnosis.unexplained is not None and diagnosis.unexplained.depends_on:
        return text
    caption = "<p class=small>The pictures of “What was seen” on the same scale, what was found taken out.</p>"
    return text + _figures(residual_panels(diagnosis, after=True)) + caption


def _next(diagnosis: Answer) -> str:
    text = ""
    for one in contests(diagnosis.next_measurement, diagnosis.expected_rms_um):
        text += f"<h3>To tell {_e(lower(one.names[0]))} from {_e(lower(one.names[1]))}</h3><p>{_e(one.verdict)}</p>"
        if one.rows:
            body = "".join("<tr>" + "".join(f"<td>{_e(cell)}" for cell in row) for row in one.rows)
            head = "<th>position / mm, °<th>arriving from<th>target<th>station<th>they differ by"
            text += f"<div class=wide><table><tr>{head}{body}</table></div>"
    text += _list(_e(str(one["text"])) for one in diagnosis.next_measurement if "separates" not in one)
    left = diagnosis.unexplained
    if left is not None and left.depends_on:
        names = listed([column(name) for name in left.depends_on])
        text += (
            f"<p>For what is left: more readings over {_e(names)} ({_e(side(left.carrier))}), one of them changing while all else "
            "stays as it is, forth and back, and twice.</p>"
        )
    if diagnosis.not_evaluated:
        items = [one.partition(": ") for one in missing(diagnosis.not_evaluated)]
        text += "<p>Columns the table did not have, and what could not be tried without them:</p>"
        text += _list(f"<b>{_e(columns)}</b>: {_e(told)}" for columns, _, told in items)
    if diagnosis.unidentifiable:
        text += (
            "<p>These readings could not show, however large (where instrument and targets sit takes it up, or nothing moved that "
            "would show it):</p>" + _list(_e(one) for one in grouped(diagnosis.unidentifiable))
        )
    return text or "<p>Nothing more is asked of these readings.</p>"


def _small_print(diagnosis: Answer) -> str:
    chances = "".join(f"; {_e(symbol(one.effect, one.where))} {probability(one.p_value)}" for one in diagnosis.causes)
    items = [
        "RMS a coordinate: root of the mean square of all coordinates that were read.",
        "A cause is judged by what it explains once everything that instrument, targets and the calibration's own uncertainty can take "
        "up has been taken out; every form tried is paid for.",
        f"Degrees of freedom {diagnosis.dof:,}; misfit {probability(diagnosis.p_value)}{chances}.",
        *(_e(capital(notice)) for notice in diagnosis.data.notices),
    ]
    aside = diagnosis.data.set_aside
    if aside:
        rows = [_e(text) for text in grouped_notes(aside)]
        items.append(f"Readings that were not used: {len(aside)}.{_list(rows)}")
    return f"<div class=small>{_list(items)}</div>"


def _figures(panels: Sequence[Panel]) -> str:
    return f"<div class=figures>{''.join(_figure(panel) for panel in panels)}</div>" if panels else ""


def _figure(panel: Panel, *, captioned: bool = True) -> str:
    return _embedded(
        alone(panel), f"{panel.title}: {panel.y} against {panel.x}", capital(panel.title) if captioned else ""
    )


def _symbol(cause: Cause) -> str:
    return f"<span class=symbol>{_e(symbol(cause.effect, cause.where))}</span>"
