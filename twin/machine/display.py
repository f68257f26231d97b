"""The errors of a machine at a glance: every error motion as a strip with its 95 % band, every other number with its interval.

For the displays of a calibration and of an identification. A band that nobody knows is not drawn and is said to be unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from twin.display import (
    UNKNOWN,
    Cell,
    Html,
    card,
    chips,
    graph,
    joined,
    measured,
    note,
    pairs,
    plain,
    readable,
    several,
    span,
    strip,
    table,
)
from twin.display.numbers import COVERAGE_FACTOR, ceiling
from twin.machine.control import ControlSection
from twin.machine.effects import AxisLocation, Effect, ErrorMotion, Squareness, split_name, unit_of
from twin.machine.machine import DIRECTIONS, Machine
from twin.numerics.covariance import Covariance

POINTS: Final = 121
"""Of a strip."""
DRAWN: Final = "*"
"""Behind what is drawn, not measured."""


def standard_uncertainty(effect: Effect, covariance: Covariance, q: np.ndarray) -> np.ndarray:
    """Standard uncertainty (k = 1) of an error motion: √(fᵀ Σ f) with the functions f of its curve (JCGM 100, eq. 13).

    Args:
        effect: the error motion.
        covariance: of the calibration's numbers.
        q: positions, mm or degrees, of any shape.

    Returns:
        µm or µrad, of that shape; NaN where any of its numbers has no uncertainty.
    """
    return combined_uncertainty([effect], covariance, {effect.frame.axis: q}, split_name(effect.name)[0], np.shape(q))


def combined_uncertainty(
    effects: Sequence[Effect], covariance: Covariance, state: Mapping[str, Any], component: int, shape: tuple[int, ...]
) -> np.ndarray:
    """Standard uncertainty (k = 1) of what effects make together of one error component.

    Args:
        effects: the effects.
        covariance: of the calibration's numbers.
        state: where, and under what conditions.
        component: 0 to 5.
        shape: of the result.

    Returns:
        µm or µrad; NaN where any of their numbers has no uncertainty.
    """
    names = [parameter.name for effect in effects for parameter in effect.parameters]
    if not set(names) <= set(covariance.names):
        return np.full(shape, np.nan)
    rates = [rate.get(component, 0.0) for effect in effects for rate in effect.derivatives(state)]
    rate = np.stack([np.broadcast_to(one, shape) for one in rates])
    variance = np.einsum("k...,kl,l...->...", rate, covariance.of(names).matrix, rate)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def motion_html(motion: ErrorMotion, covariance: np.ndarray | None, *, source: str, illustrative: bool) -> Html:
    """One error motion with axes.

    Args:
        motion: the error motion.
        covariance: (k, k) of its coefficients; None where it is not known.
        source: where its numbers come from.
        illustrative: whether they are drawn, not measured.
    """
    names = tuple(parameter.name for parameter in motion.parameters)
    known = Covariance.none() if covariance is None else Covariance(names, covariance)
    axis, q = motion.frame.axis, np.linspace(*motion.domain, 201)
    across = "mm" if axis[0] in "XYZUVW" else "°" if axis[0] in "ABC" else "mm or °"  # letters as of ISO 841
    half = COVERAGE_FACTOR * standard_uncertainty(motion, known, q)
    drawn = graph(
        q, _values(motion, q), half, f"{axis} ({across})", f"{motion.name} ({readable(unit_of(motion.name))})"
    )
    band = "band: 95 % interval" if covariance is not None else f"uncertainty {UNKNOWN}: no covariance of its own"
    small = f"{motion.basis.name}, {several(len(names), 'coefficient')}"
    return card(motion.name, drawn, note(band), note(source), small=small, illustrative=illustrative)


def about_html(
    source: str, path: Path | None, control: ControlSection | None, drawn: Sequence[str], unknown: Sequence[str]
) -> Html:
    """Where a calibration comes from, and what it does not know.

    Args:
        source: in words.
        path: its file.
        control: what it says of the machine's control.
        drawn: names of what is illustrative.
        unknown: names of what has no uncertainty.
    """
    rows = [("where from", source), ("file", "" if path is None else str(path))]
    if control is not None:
        tables = ", ".join(f"{one.file.name} ({one.format})" for one in control.tables)
        rows.append(("control", f"these errors are {control.errors_are} by its tables {tables}"))
    rows.append((f"{DRAWN} drawn, not measured", ", ".join(drawn)))
    rows.append((f"uncertainty {UNKNOWN} of", ", ".join(unknown)))
    return pairs(rows)


def errors_html(
    machine: Machine, effects: Sequence[Effect], covariance: Covariance, drawn: Collection[str] = ()
) -> Html:
    """All errors of a machine.

    Args:
        machine: the machine.
        effects: its errors.
        covariance: of their numbers.
        drawn: names of those that are illustrative.
    """
    motions = {effect.name: effect for effect in effects if isinstance(effect, ErrorMotion)}
    known = any(np.isfinite(_curve(effect, covariance)[1]).all() for effect in motions.values())
    named = {split_name(name)[2] for name in motions}
    rows = [_row(machine, name, motions, covariance, drawn, known) for name in machine.names if name in named]
    grid = table(["axis", *(f"E_{d}…" for d in DIRECTIONS)], rows)
    parts = [grid]
    if rows:
        said = "largest value over the range"
        said += (
            f" ± half of its widest 95 % interval (±{UNKNOWN}: no covariance)" if known else f"; uncertainty {UNKNOWN}"
        )
        text = f"Error motions by ISO 230-1: {said}. The strips of an axis have one scale for µm, one for µrad."
        parts.append(note(text, loud=not known))
    for kind, title in ((Squareness, "squareness"), (AxisLocation, "axis location")):
        parts.append(_numbers([effect for effect in effects if isinstance(effect, kind)], covariance, title, drawn))
    others = [e for e in effects if not isinstance(e, ErrorMotion | Squareness | AxisLocation)]
    parts.append(_others(others, covariance))
    return joined(*parts)


def _row(
    machine: Machine,
    axis_name: str,
    motions: Mapping[str, ErrorMotion],
    covariance: Covariance,
    drawn: Collection[str],
    known: bool,
) -> list[Cell]:
    """One axis: where it goes and what its strips' edges mean, then its six error motions."""
    axis = machine.by_name[axis_name]
    six = [motions.get(f"E_{direction}{axis_name}") for direction in DIRECTIONS]
    curves = [None if effect is None else _curve(effect, covariance) for effect in six]
    lengths, angles = (
        ceiling(
            max((float(np.max(np.abs(value) + np.nan_to_num(half))) for value, half in filter(None, of)), default=0.0)
        )
        for of in (curves[:3], curves[3:])
    )
    cells: list[Cell] = [
        joined(f"{axis_name}, {span(*axis.domain, axis.unit)}", note(f"edges ±{lengths:g} µm, ±{angles:g} µrad"))
    ]
    for effect, curve, limit in zip(six, curves, [lengths] * 3 + [angles] * 3, strict=True):
        if effect is None or curve is None:
            cells.append(note("not given"))
            continue
        value, half = curve
        peak, unit = float(value[int(np.argmax(np.abs(value)))]), unit_of(effect.name)
        text = (
            measured(peak, float(np.max(half)) / COVERAGE_FACTOR, unit) if known else f"{plain(peak)} {readable(unit)}"
        )
        says = f"{effect.name} over {axis_name}: largest {text}"
        shown = f"{effect.name}{DRAWN if effect.name in drawn else ''}"
        cells.append(joined(shown, strip(value, half, limit, says), Html(f"<small>{text}</small>")))
    return cells


def _curve(effect: ErrorMotion, covariance: Covariance) -> tuple[np.ndarray, np.ndarray]:
    """Values of a strip, and half widths of their 95 % intervals."""
    q = np.linspace(*effect.domain, POINTS)
    return _values(effect, q), COVERAGE_FACTOR * standard_uncertainty(effect, covariance, q)


def _values(effect: ErrorMotion, q: np.ndarray) -> np.ndarray:
    (found,) = effect.components({effect.frame.axis: q}).values()
    return np.asarray(np.broadcast_to(found, q.shape), dtype=float)


def uncertainty_of(name: str, covariance: Covariance) -> float:
    """Standard uncertainty (k = 1) of one number; NaN where it is not known."""
    return float(np.sqrt(covariance.of([name]).matrix[0, 0])) if name in covariance.names else float("nan")


def _numbers(effects: Sequence[Effect], covariance: Covariance, title: str, drawn: Collection[str]) -> Html:
    if not effects:
        return Html("")
    texts = []
    for effect in effects:
        (number,) = effect.parameters
        mark = DRAWN if effect.name in drawn else ""
        texts.append(
            f"{effect.name}{mark} {measured(number.value, uncertainty_of(number.name, covariance), number.unit)}"
        )
    return joined(note(f"{title} (± 95 %)"), chips(texts))


def _others(effects: Sequence[Effect], covariance: Covariance) -> Html:
    rows = [(effect.name, effect.frame.axis, _told(effect, covariance)) for effect in effects]
    return table(["other effect", "acts at", "numbers (± 95 %)"], rows)


def _told(effect: Effect, covariance: Covariance) -> Cell:
    if not effect.parameters:
        return "as its tables say"
    return chips(
        f"{p.name.removeprefix(effect.name).strip(':[] .')} {measured(p.value, uncertainty_of(p.name, covariance), p.unit)}"
        for p in effect.parameters
    )
