"""The diagnosis as one HTML file that reads as an argument: expected, seen, tried, found, doubted, gained, to be measured next."""

from __future__ import annotations

import base64
import html
import io
from typing import Any, Final

import numpy as np

from twin.diagnosis.result import Cause, Diagnosis, readable_unit

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
"""Okabe and Ito's: told apart by everybody."""
VERDICTS: Final = {
    "consistent": ("Nothing is wrong that these data could show", "#e8f3ea"),
    "explained": ("Something is wrong, and it is known what", "#fdf2df"),
    "ambiguous": ("Something is wrong, and it could be one of several things", "#fdf2df"),
    "unexplained": ("Something is wrong that no known cause explains", "#fbe4de"),
}
STYLE: Final = """
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:0 auto;padding:1rem 1.5rem 4rem;color:#1b1b1b;background:#fff}
h1{font-size:1.7rem;margin:.2rem 0}h2{font-size:1.2rem;margin:2.2rem 0 .4rem;border-bottom:1px solid #ccc}
.verdict{padding:1rem 1.3rem;border-radius:.5rem}.verdict p{margin:.3rem 0}
table{border-collapse:collapse;width:100%;margin:.6rem 0}td,th{border-bottom:1px solid #ddd;padding:.25rem .6rem;text-align:left}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}img{max-width:100%}.small{color:#555;font-size:.9rem}
@media print{body{max-width:none}h2{break-after:avoid}img,table{break-inside:avoid}}
"""


def diagnosis_html(diagnosis: Diagnosis) -> str:
    """One self-contained page; needs matplotlib (extra ``plots``).

    Args:
        diagnosis: what `twin.diagnosis.diagnose` found.
    """
    title, colour = VERDICTS[diagnosis.verdict]
    machine = diagnosis.calibration.machine
    parts = [
        f"<p class=small>{_e(machine.name)} · {_e(diagnosis.data.source)} · {diagnosis.points} points</p>",
        f'<div class=verdict style="background:{colour}"><h1>{_e(title)}</h1>{_headline(diagnosis)}</div>',
    ]
    if diagnosis.calibration.illustrative:
        parts.append("<p><b>ILLUSTRATIVE:</b> the calibration that was judged is drawn, not measured.</p>")
    parts.append("<h2>What was expected, what was seen</h2>" + _seen(diagnosis))
    for cause in diagnosis.causes:
        parts.append(f"<h2>{_e(_name(cause))}</h2>" + _cause(diagnosis, cause))
    if diagnosis.unexplained is not None:
        parts.append(f"<h2>What is left</h2><p>{_e(_capital(diagnosis.unexplained.evidence))}.</p>" + _left(diagnosis))
    if diagnosis.gain is not None:
        parts.append("<h2>What changes when it is modelled</h2>" + _gain(diagnosis))
    if diagnosis.next_measurement:
        items = "".join(f"<li>{_e(str(one['text']))}</li>" for one in diagnosis.next_measurement)
        parts.append(f"<h2>What to measure next</h2><ul>{items}</ul>")
    parts.append("<h2>What was tried</h2>" + _tried(diagnosis))
    if diagnosis.data.set_aside:
        items = "".join(f"<li>line {note.line}: {_e(note.text)}</li>" for note in diagnosis.data.set_aside)
        parts.append(f"<h2>Rows that were not used</h2><ul class=small>{items}</ul>")
    return (
        f'<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">'
        f"<title>{_e(title)}: {_e(machine.name)}</title><style>{STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )


def _headline(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "consistent":
        return (
            f"<p>The machine does what its model says, within the scatter of the readings "
            f"({diagnosis.rms_um:.3g} µm seen, {diagnosis.expected_rms_um:.3g} µm expected).</p>"
        )
    lines = [f"<p><b>{_e(_name(cause))}</b>: {_e(cause.evidence)}.</p>" for cause in diagnosis.causes]
    for cause in diagnosis.causes:
        if cause.equivalent:
            rivals = ", ".join(f"{effect} {where}" for effect, where in cause.equivalent)
            lines.append(f"<p>{_e(_name(cause))} cannot be told from: {_e(rivals)}. See what to measure next.</p>")
    if diagnosis.unexplained is not None:
        lines.append(f"<p>{_e(_capital(diagnosis.unexplained.evidence))}.</p>")
    if diagnosis.gain is not None and diagnosis.gain.tool_before_um > 0.0:
        gain = diagnosis.gain
        lines.append(
            f"<p>At the tool it makes {gain.tool_before_um:.3g} µm; compensated with it in the model, "
            f"{gain.tool_after_um:.2g} µm are left of it.</p>"
        )
    return "".join(lines)


def _seen(diagnosis: Diagnosis) -> str:
    text = (
        f"<p>Stations and targets were fitted and nothing else. The readings scatter by {diagnosis.expected_rms_um:.3g} µm "
        f"({_e(diagnosis.scatter)}); what is left of them is {diagnosis.rms_um:.3g} µm RMS a coordinate. Chance that scatter "
        f"alone does that: {_p(diagnosis.p_value)}.</p>"
    )
    names = [name for name, values in _columns(diagnosis).items() if np.ptp(values) > 0.0][:6]
    return text + _picture(diagnosis, names, "residual, before")


def _cause(diagnosis: Diagnosis, cause: Cause) -> str:
    rows = "".join(
        f"<tr><td>{_e(q.name)}<td class=n>{q.value:.4g}<td class=n>± {1.96 * q.u:.2g}<td>{_e(readable_unit(q.unit))}"
        for q in cause.parameters
    )
    text = (
        f"<p>{_e(_capital(cause.evidence))}. It accounts for {100 * cause.share:.0f} % of what is beyond the scatter; chance of that "
        f"by accident, all causes that were tried counted: {_p(cause.p_value)}. "
        + ("It belongs to the instrument and never enters a compensation." if cause.origin == "instrument" else "")
        + f"</p><table><tr><th>parameter<th class=n>value<th class=n>95 %<th>unit{rows}</table>"
    )
    return text + _pattern(diagnosis, cause)


def _pattern(diagnosis: Diagnosis, cause: Cause) -> str:
    """The cause's own part of the readings with all that is left of them, against its columns; a line where the cause says it is."""
    shift = np.nan_to_num(cause.pattern_um, nan=0.0)
    size = np.linalg.norm(shift, axis=1)
    touched = size > 1e-3 * max(float(size.max()), 1e-12)
    if not np.any(touched):
        return ""
    _, _, main = np.linalg.svd(shift[touched], full_matrices=False)
    unit = shift / np.where(touched, size, 1.0)[:, None]
    unit *= np.where(unit @ main[0] < 0.0, -1.0, 1.0)[:, None]
    says = np.sum(shift * unit, axis=1)
    seen = says + np.sum(np.nan_to_num(diagnosis.after_um, nan=0.0) * unit, axis=1)
    columns = _columns(diagnosis)
    names = _of_cause(diagnosis, cause)
    series = [("", touched)]
    if cause.effect == "reversal":
        i = diagnosis.calibration.machine.names.index(cause.where)
        series = [
            (f"from {side}", touched & (diagnosis.data.approach[:, i] == sign)) for side, sign in (("+", 1), ("−", -1))
        ]
    figure = _figure(len(names))
    for k, name in enumerate(names):
        axes = figure.add_subplot(1, len(names), k + 1)
        for j, (label, rows) in enumerate(series):
            x = columns[name][rows]
            _binned(axes, x, seen[rows], COLOURS[j], f"seen {label}".strip(), "o", 1.0)
            _binned(axes, x, says[rows], COLOURS[j], f"this cause {label}".strip(), "-", 0.6, bars=False)
        _dress(axes, name, "shift of the target / µm", legend=k == 0)
    return _embedded(figure, f"what {_name(cause)} says and what was seen")


def _left(diagnosis: Diagnosis) -> str:
    wanted = diagnosis.unexplained.depends_on if diagnosis.unexplained is not None else ()
    names = [name for name in _columns(diagnosis) if name in wanted or name.partition("_")[0] in wanted]
    return _picture(diagnosis, names, "residual, causes taken out", after=True) if names else ""


def _gain(diagnosis: Diagnosis) -> str:
    gain = diagnosis.gain
    if gain is None:
        return ""
    rows = [
        f"<tr><td>residuals, all data<td class=n>{gain.rms_before_um:.3g}<td class=n>{gain.rms_after_um:.3g}<td>µm RMS"
    ]
    if not np.isnan(gain.held_before_um):
        low, high = gain.held_ci95_um
        rows.append(
            f"<tr><td>on rounds that were not looked at (less by {low:.2g} to {high:.2g}, 95 %)"
            f"<td class=n>{gain.held_before_um:.3g}<td class=n>{gain.held_after_um:.3g}<td>µm RMS"
        )
    if gain.tool_before_um > 0.0:
        rows.append(
            f"<tr><td>at the tool over the volume, after compensation<td class=n>{gain.tool_before_um:.3g}"
            f"<td class=n>{gain.tool_after_um:.2g}<td>µm RMS"
        )
    return f"<table><tr><th><th class=n>without<th class=n>with<th>{''.join(rows)}</table>"


def _tried(diagnosis: Diagnosis) -> str:
    rows = "".join(
        f"<tr><td>{_e(effect)}<td>{_e(where)}<td class=n>{explained:.1f}<td class=n>{_p(p)}"
        for effect, where, explained, p in diagnosis.ranking
    )
    text = (
        "<p>Each alone, best first; the chance counts how many were tried.</p>"
        f"<table><tr><th>cause<th>where<th class=n>explains (chi²)<th class=n>chance{rows}</table>"
    )
    if diagnosis.unidentifiable:
        blind = ", ".join(f"{effect} {where}" for effect, where in diagnosis.unidentifiable)
        text += f"<p class=small>These data could not show, however large: {_e(blind)}.</p>"
    if diagnosis.not_evaluated:
        blind = ", ".join(f"{effect} {where} ({column})" for effect, where, column in diagnosis.not_evaluated)
        text += f"<p class=small>Not evaluated, for want of a column: {_e(blind)}.</p>"
    return text


def _columns(diagnosis: Diagnosis) -> dict[str, np.ndarray]:
    data, machine = diagnosis.data, diagnosis.calibration.machine
    found = {f"{axis.name}_{axis.unit}": np.asarray(data.positions[:, i]) for i, axis in enumerate(machine.axes)}
    if np.all(np.isfinite(data.time_s)):
        found["time_s"] = np.asarray(data.time_s)
    rounds = list(dict.fromkeys(data.round))
    found["round"] = np.array([float(rounds.index(name)) for name in data.round])
    for name, values in data.temperature_degC.items():
        if np.all(np.isfinite(values)):
            found[f"T_{name}_degC"] = np.asarray(values)
    return found


def _of_cause(diagnosis: Diagnosis, cause: Cause) -> list[str]:
    """The columns in which its pattern shows."""
    names = list(_columns(diagnosis))
    axes = [axis.name for axis in diagnosis.calibration.machine.axes]
    parts = cause.where.replace(" by ", " ").split()
    found = [name for part in parts for name in names if name.partition("_")[0] in axes and part[-1] == name[0]]
    if cause.effect.startswith("thermal") or cause.effect == "station_drift":
        found += [name for name in names if name == "time_s" or name.startswith("T_")]
    if "round" in cause.where:
        found.append("round")
    return list(dict.fromkeys(found))[:3] or names[:3]


def _picture(diagnosis: Diagnosis, names: list[str], label: str, *, after: bool = False) -> str:
    """Residual components of the station's frame against columns, as binned means with their scatter."""
    columns = _columns(diagnosis)
    if not names:
        return ""
    figure = _figure(len(names))
    for k, name in enumerate(names):
        axes = figure.add_subplot(-(-len(names) // 3), min(len(names), 3), k + 1)
        values = diagnosis.after_um if after else diagnosis.residual_um
        for i, letter in enumerate("xyz"):
            _binned(axes, columns[name], values[:, i], COLOURS[i], letter, "o-", 1.0)
        _dress(axes, name, f"{label} / µm", legend=k == 0)
    return _embedded(figure, f"{label} against {', '.join(names)}")


def _figure(panels: int) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wide = min(panels, 3)
    figure = Figure(figsize=(3.6 * wide + 0.4, 2.7 * -(-panels // wide)), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    return figure


def _dress(axes: Any, name: str, label: str, *, legend: bool) -> None:
    axes.axhline(0.0, color="#999", lw=0.6)
    axes.set_xlabel(name.replace("_", " / ").replace("deg", "°") if name != "round" else "round, from 0")
    axes.set_ylabel(label)
    if legend:
        axes.legend(fontsize=7)


def _embedded(figure: Any, text: str) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    code = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{_e(text)}" src="data:image/png;base64,{code}">'


def _binned(
    axes: Any, x: np.ndarray, y: np.ndarray, colour: str, label: str, style: str, alpha: float, *, bars: bool = True
) -> None:
    keep = np.isfinite(y)
    x, y = x[keep], y[keep]
    distinct = np.unique(np.round(x, 3))
    if len(distinct) <= 24:
        group = np.searchsorted(distinct, np.round(x, 3))
        centre = distinct
    else:
        edges = np.quantile(x, np.linspace(0.0, 1.0, 17))
        group = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, 15)
        size = np.maximum(np.bincount(group, minlength=16), 1)
        centre = np.bincount(group, x, minlength=16) / size
    size = np.bincount(group, minlength=len(centre))
    mean = np.bincount(group, y, minlength=len(centre)) / np.maximum(size, 1)
    square = np.bincount(group, y**2, minlength=len(centre)) / np.maximum(size, 1)
    error = np.sqrt(np.maximum(square - mean**2, 0.0) / np.maximum(size - 1, 1))
    some = size > 1
    if not bars:
        axes.plot(centre[some], mean[some], style, lw=1.5, color=colour, label=label, alpha=alpha)
        return
    axes.errorbar(
        centre[some], mean[some], 2.0 * error[some], fmt=style, ms=3, lw=1, color=colour, label=label, alpha=alpha
    )


def _name(cause: Cause) -> str:
    return (
        f"{cause.effect.replace('_', ' ')} {cause.where}".capitalize()
        if cause.where == "—"
        else (f"{_capital(cause.effect.replace('_', ' '))} {cause.where}")
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _p(value: float) -> str:
    return "below 1e-99" if value < 1e-99 else f"{value:.2g}"


def _e(text: str) -> str:
    return html.escape(text)
