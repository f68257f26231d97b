"""HTML overview of a machine's errors: every error motion as a strip with its 95 % band, every other parameter with its interval.

Used to display a calibration and an identification. If the uncertainty is unknown, no band is drawn and the text states it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from twin.controls import ControlSection
from twin.display import UNKNOWN, Cell, Html, chips, joined, measured, note, plain, readable, span, table
from twin.display.markup import part
from twin.display.numbers import COVERAGE_FACTOR, ceiling
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Machine
from twin.model.effects import AxisLocation, Effect, ErrorMotion, Squareness, split_name, unit_of
from twin.numerics.covariance import Covariance

POINTS: Final = 121
"""Number of points of a strip."""
DRAWN: Final = "*"
"""Mark after the name of an illustrative error (not measured)."""


def standard_uncertainty(effect: Effect, covariance: Covariance, q: np.ndarray) -> np.ndarray:
    """Return the standard uncertainty (k = 1) of an error motion: √(fᵀ Σ f) with the functions f of its curve (JCGM 100, eq. 13).

    At positions q, mm or degrees, of any shape; µm or µrad, NaN if the covariance of any of its parameters is unknown.
    """
    return combined_uncertainty([effect], covariance, {effect.frame.axis: q}, split_name(effect.name)[0], np.shape(q))


def combined_uncertainty(
    effects: Sequence[Effect], covariance: Covariance, state: Mapping[str, Any], component: int, shape: tuple[int, ...]
) -> np.ndarray:
    """Return the standard uncertainty (k = 1) of the sum of some effects in one error component (index 0 to 5) at states of a shape.

    µm or µrad; NaN if the covariance of any of their parameters is unknown.
    """
    names = [parameter.name for effect in effects for parameter in effect.parameters]
    if not set(names) <= set(covariance.names):
        return np.full(shape, np.nan)
    rates = [rate.get(component, 0.0) for effect in effects for rate in effect.derivatives(state)]
    rate = np.stack([np.broadcast_to(values, shape) for values in rates])
    variance = np.einsum("k...,kl,l...->...", rate, covariance.of(names).matrix, rate)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def about_rows(
    source: str, path: Path | None, control: ControlSection | None, drawn: Sequence[str], unknown: Sequence[str]
) -> list[tuple[str, Cell]]:
    """Return the origin of a calibration, its control tables and the names of its illustrative (drawn) and uncertain errors."""
    rows: list[tuple[str, Cell]] = [("source", source), ("file", "" if path is None else str(path))]
    if control is not None:
        tables = ", ".join(f"{table.file.name} ({table.format})" for table in control.tables)
        if tables:
            rows.append(("control", f"these errors are {control.errors_are} by its tables {tables}"))
        held = ", ".join(f"{kinematic.file.name} ({kinematic.format})" for kinematic in control.kinematics)
        rows.append(("kinematics of the control, in tool centre point mode", held))
        live = ", ".join(entry.file.name for entry in control.live)
        if live:
            rows.append(("control", f"these errors are {control.errors_are} by its kinematics module, of {live}"))
    rows.append((f"{DRAWN} illustrative, not measured", ", ".join(drawn)))
    rows.append((f"uncertainty {UNKNOWN} of", ", ".join(unknown)))
    return rows


def errors_html(
    machine: Machine, effects: Sequence[Effect], covariance: Covariance, drawn: Collection[str] = ()
) -> Html:
    """Return tables of all errors of a machine, of which those ``drawn`` are illustrative."""
    motions = {effect.name: effect for effect in effects if isinstance(effect, ErrorMotion)}
    known = any(np.isfinite(_curve(effect, covariance)[1]).all() for effect in motions.values())
    named = {split_name(name)[2] for name in motions}
    rows = [_row(machine, name, motions, covariance, drawn, known) for name in machine.names if name in named]
    grid = table(["axis", *(f"E_{d}…" for d in DIRECTIONS)], rows)
    parts = [grid]
    if rows:
        caption = "largest value over the range"
        caption += (
            f" ± half of its widest 95 % interval (±{UNKNOWN}: no covariance)" if known else f"; uncertainty {UNKNOWN}"
        )
        text = f"Error motions by ISO 230-1: {caption}. All strips of an axis have the same scale for µm and the same for µrad."
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
    """Return the row of one axis: its range, the scale of its strips and its six error motions."""
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
        cells.append(joined(shown, _strip(value, half, limit, says), Html(f"<small>{text}</small>")))
    return cells


def _curve(effect: ErrorMotion, covariance: Covariance) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of a strip and the half widths of their 95 % intervals."""
    q = np.linspace(*effect.domain, POINTS)
    return _values(effect, q), COVERAGE_FACTOR * standard_uncertainty(effect, covariance, q)


def _strip(values: np.ndarray, half: np.ndarray, limit: float, says: str) -> Html:
    """Return a curve (n,) at equal steps as a narrow strip with a zero line and its 95 % band of half widths (n,), NaN if unknown.

    The upper edge is at ``limit``, the lower at its negative; the caller states the scale.
    """
    x = np.linspace(0.0, 100.0, len(values))

    def points(edges: Sequence[np.ndarray]) -> str:
        y = [18.0 - 17.0 * np.clip(edge / limit, -1.0, 1.0) for edge in edges]
        places = [*zip(x, y[0], strict=True), *(zip(x[::-1], y[1][::-1], strict=True) if len(y) > 1 else ())]
        return " ".join(f"{across:.2f},{up:.2f}" for across, up in places)

    band = points([values + half, values - half]) if np.isfinite(half).all() else ""
    return part("strip", points([values]), band, says)


def _values(effect: ErrorMotion, q: np.ndarray) -> np.ndarray:
    (found,) = effect.components({effect.frame.axis: q}).values()
    return np.asarray(np.broadcast_to(found, q.shape), dtype=float)


def uncertainty_of(name: str, covariance: Covariance) -> float:
    """Return the standard uncertainty (k = 1) of one parameter; NaN if unknown."""
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
    rows: list[tuple[Cell, ...]] = []
    for effect in effects:
        numbers = chips(
            f"{p.name.removeprefix(effect.name).strip(':[] .')} {measured(p.value, uncertainty_of(p.name, covariance), p.unit)}"
            for p in effect.parameters
        )
        rows.append((effect.name, effect.frame.axis, numbers if effect.parameters else "according to its tables"))
    return table(["other effect", "acts in the frame of", "parameters (± 95 %)"], rows)
