"""What a picture of a diagnosis shows, before it is drawn: which readings, against what, and what a cause says of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.diagnosis.candidates.catalogue import SPECIFICATIONS
from twin.diagnosis.result import Answer, Cause
from twin.diagnosis.wording.words import column, plain, side
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.effects import Effect
from twin.machine.effects.names import axis_of, motion
from twin.machine.effects.specification import Drawing
from twin.machine.effects.waves import APPROACH
from twin.machine.machine import DIRECTIONS, Machine
from twin.measurement.table import state_of

STOPS: Final = 24
"""Distinct positions up to which each is a group of its own."""
BINS: Final = 16
"""Groups of as many readings each, beyond."""
FEWEST: Final = 2
ALIKE: Final = 0.9
"""Rank correlation of two columns beyond which one picture is enough."""
SHOWN: Final = 0.2
"""Share of what the clearest column explains below which another is not drawn."""
SIDES: Final = ((-1.0, "from −"), (0.0, "unknown"), (1.0, "from +"))
"""Names of the sides that an axis comes from."""
MOST: Final = 3
"""Panels of the misfit."""
SMALL: Final = 0.02
"""Share of a cause's largest value below which a reading says nothing of it in its own unit."""
MANY_TURNS: Final = 4
"""Repeats over the range from which a periodic error is folded into one period."""
LEGIBLE: Final = 4.0
"""Times the sharpest direction's interval beyond which another direction is not drawn with it."""
HIDDEN: Final = 0.02
"""Share of the largest mean square below which a direction was not read."""


@final
@dataclass(frozen=True)
class Scale:
    """What a panel is drawn against.

    Attributes:
        label: in words with the unit.
        values: (n,).
        ticks: names of values, where it is no number.
    """

    label: str
    values: np.ndarray
    ticks: tuple[tuple[float, str], ...] = ()


@final
@dataclass(frozen=True)
class Series:
    """One set of readings in a panel.

    Attributes:
        name: in the legend.
        x, y: (k,).
        weight: (k,) of each reading in a mean.
        says: (k,) what the cause has there; None where nothing is claimed.
        smooth: whether that depends on x alone, so that it is a line and no mean.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    says: np.ndarray | None = None
    smooth: bool = False


@final
@dataclass(frozen=True)
class Panel:
    """One picture, before it is drawn.

    Attributes:
        title: what is shown.
        x: its label, with the unit.
        y: likewise.
        series: what is drawn.
        ticks: names of positions along x.
        limit: ± of y at least; None: as it comes.
    """

    title: str
    x: str
    y: str
    series: tuple[Series, ...]
    ticks: tuple[tuple[float, str], ...] = ()
    limit: float | None = None


def residual_panels(found: Answer, *, after: bool = False) -> list[Panel]:
    """The residuals against the columns they go with, clearest first; against every axis where they go with none.

    Args:
        found: the diagnosis.
        after: with the causes taken out, on the scale of before.
    """
    scales, data = scales_of(found), found.data
    before = directed(found, found.residual_um)
    values = directed(found, found.after_um) if after else before
    panels = []
    axes = [(f"{axis.name}_{axis.unit}", axis.side) for axis in found.calibration.machine.axes]
    for name, carrier in _telling(found, scales)[:MOST] or axes:
        rows = data.carrier == carrier if carrier in data.carrier else np.ones(len(data), dtype=bool)
        x = scales[name]
        if np.ptp(x.values[rows]) == 0.0:
            continue
        reach = {label: _reach(x.values[rows], part[rows]) for label, part in before.items()}
        sharpest = min(half for _, half in reach.values())
        shown = [label for label, (_, half) in reach.items() if half <= LEGIBLE * sharpest]
        series = tuple(_series(label, x.values[rows], values[label][rows]) for label in shown)
        where = side(carrier) if carrier in data.carrier else "all targets"
        rest = "" if len(shown) == len(values) else f", {' and '.join(shown)}, which was read best"
        only = f" {shown[0]}" if len(shown) == 1 else ""
        limit = max(reach[label][0] for label in shown)
        title = f"against {column(name)}, {where}{rest}"
        panels.append(Panel(title, x.label, f"read − foreseen{only} [µm]", series, x.ticks, limit))
    return panels


def _telling(found: Answer, scales: Mapping[str, Scale]) -> list[tuple[str, str]]:
    """(column, side) where the misfit shows; of columns that go together one, a cause's own if there is one."""
    own = {name for cause in found.causes for name in _columns_of(found, cause)}
    unexplained = found.unexplained
    wanted = [(name, unexplained.carrier) for name in unexplained.depends_on] if unexplained is not None else []
    least = SHOWN * max((trend.explains for trend in found.trends), default=0.0)
    wanted += [(trend.column, trend.carrier) for trend in found.trends if trend.explains >= least]
    chosen: list[tuple[str, str]] = []
    for name, carrier in wanted:
        alike = [one for one in scales if name in scales and (one == name or _together(scales[one], scales[name]))]
        if alike and not any(one in alike for one, _ in chosen):
            chosen.append((next((one for one in alike if one in own), name), carrier))
    return chosen


def _ranks(values: np.ndarray) -> np.ndarray:
    """Ranks from one on; equals share theirs."""
    _, of, count = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(count) - 0.5 * (count - 1))[of])


def _together(a: Scale, b: Scale) -> bool:
    """Whether two columns are in one order, near enough that a picture cannot tell them apart."""
    if np.ptp(a.values) == 0.0 or np.ptp(b.values) == 0.0:
        return False
    return bool(abs(np.corrcoef(_ranks(a.values), _ranks(b.values))[0, 1]) > ALIKE)


def cause_panels(found: Answer, cause: Cause) -> list[Panel]:
    """A cause against what it goes with: in its own unit where it is one error motion, else as shifts of the targets.

    Args:
        found: the diagnosis.
        cause: one of its causes.
    """
    effect = cause.effects[0] if len(cause.effects) == 1 else None
    parts = _single(effect, found) if effect is not None else None
    if effect is not None and parts is not None:
        return _own_unit(found, cause, effect, *parts)
    rows = _concerned(found, cause)
    if not np.any(rows):
        return []
    title = plain(cause.effect, cause.where)
    if not drawing_of(cause).by_state:
        return [_as_said(title, cause.pattern_um[rows], found.after_um[rows], found.precision[rows])]
    says, left = directed(found, cause.pattern_um), directed(found, found.after_um)
    x = _against(found, cause)[0]
    series = tuple(_series(name, x.values[rows], (part + left[name])[rows], part[rows]) for name, part in says.items())
    return [Panel(title, x.label, "shift of the targets [µm]", series, x.ticks)]


def _concerned(found: Answer, cause: Cause) -> np.ndarray:
    """(n,) readings a cause does something to, or would in another round."""
    size = np.linalg.norm(np.nan_to_num(cause.pattern_um), axis=1)
    rows = size > 1e-3 * max(float(size.max(initial=0.0)), 1e-12)
    shared = drawing_of(cause).shared
    if not shared:
        return rows
    names = found.data.station if shared == "station" else found.data.target
    return np.isin(names, names[rows])


def _as_said(title: str, says: np.ndarray, left: np.ndarray, precision: np.ndarray) -> Panel:
    """Every coordinate that was read, against what the cause says of it."""
    read = np.isfinite(says) & np.isfinite(left)
    x, y = says[read], (says + left)[read]
    some = np.abs(x) > SMALL * np.abs(x).max(initial=0.0)
    weight = np.einsum("nii->ni", precision)[read][some]
    one = Series("", x[some], y[some], weight, x[some], smooth=True)
    return Panel(title, "shift this cause foresees [µm]", "shift as read [µm]", (one,))


def scales_of(found: Answer) -> dict[str, Scale]:
    """Every column a residual can be drawn against, by its name in the table."""
    data, machine = found.data, found.calibration.machine
    scales = {}
    for i, axis in enumerate(machine.axes):
        unit = "mm" if axis.linear else "°"
        scales[f"{axis.name}_{axis.unit}"] = Scale(f"{axis.name} [{unit}]", np.asarray(data.positions[:, i]))
        if np.any(data.approach[:, i]):
            sides = np.asarray(data.approach[:, i], dtype=float)
            ticks = tuple((at, name) for at, name in SIDES if at != 0.0 or not np.all(sides))
            scales[f"approach_{axis.name}"] = Scale(f"side {axis.name} came from [+/−]", sides, ticks)
    if np.all(np.isfinite(data.time_s)):
        since = np.asarray(data.time_s) - float(np.min(data.time_s))
        unit, seconds = ("h", 3600.0) if float(np.ptp(since)) > 7200.0 else ("min", 60.0)
        scales["time_s"] = Scale(f"time from the first reading [{unit}]", since / seconds)
    rounds = list(dict.fromkeys(data.round))
    names = tuple((float(i), str(name)) for i, name in enumerate(rounds)) if len(rounds) <= 12 else ()
    scales["round"] = Scale("round [number]", np.array([float(rounds.index(name)) for name in data.round]), names)
    for name, values in data.temperature_degC.items():
        if np.all(np.isfinite(values)):
            of = f"{name}'s scale" if name in machine.names else name
            scales[f"T_{name}_degC"] = Scale(f"temperature of {of} [°C]", np.asarray(values))
    for name, values in data.channels.items():
        if np.all(np.isfinite(values)):
            what, _, unit = name.partition("_")
            scales[name] = Scale(f"{what} [{unit.replace('_', '/')}]", np.asarray(values))
    return scales


def _series(name: str, x: np.ndarray, y: np.ndarray, says: np.ndarray | None = None) -> Series:
    keep = np.isfinite(y)
    return Series(name, x[keep], y[keep], np.ones(np.count_nonzero(keep)), None if says is None else says[keep])


def directed(found: Answer, values_um: np.ndarray) -> dict[str, np.ndarray]:
    """Readings' coordinates as (n,) shifts in the base's directions; along the beam where lengths were read and nothing else."""
    read = np.isfinite(values_um)
    values = np.where(read, values_um, 0.0)
    nothing = np.where(read.any(axis=1), 0.0, np.nan)
    base = np.einsum("nij,ni->nj", found.directions, values)
    along_axes = np.abs(found.directions[read[:, 0], 0]).max(axis=1, initial=0.0).min(initial=1.0) >= 0.99
    if not (read[:, 1:].any() or along_axes):
        return {"along the beam": values[:, 0] + nothing}
    square = np.mean(np.einsum("nij->nj", found.directions**2), axis=0)
    seen = square > HIDDEN * max(float(square.max()), 1e-30)
    return {f"in {'xyz'[j]}": base[:, j] + nothing for j in range(3) if seen[j]}


def _single(effect: Effect, found: Answer) -> tuple[int, np.ndarray] | None:
    """The one component an effect has, and its (n,) value at each reading; None where it has several."""
    machine = found.calibration.machine
    parts = effect.components(state_of(found.data, machine))
    largest = {i: float(np.abs(np.asarray(v, dtype=float)).max(initial=0.0)) for i, v in parts.items()}
    most = max(largest.values(), default=0.0)
    strong = [i for i, size in largest.items() if size > 1e-6 * most]
    if most == 0.0 or len(strong) != 1:
        return None
    return strong[0], np.broadcast_to(np.asarray(parts[strong[0]], dtype=float), len(found.data))


def _own_unit(found: Answer, cause: Cause, effect: Effect, component: int, values: np.ndarray) -> list[Panel]:
    """The error motion itself: what each reading says of it by weighted least squares, and what that counts."""
    shift = np.where(np.isfinite(cause.pattern_um), cause.pattern_um, 0.0)
    left = np.where(np.isfinite(found.after_um), found.after_um, 0.0)
    size = np.linalg.norm(shift, axis=1)
    rows = (np.abs(values) > SMALL * np.abs(values).max()) & (size > 0.0)
    if not np.any(rows):
        return []
    lever = np.einsum("nij,nj->ni", found.precision[rows], shift[rows] / values[rows, None])
    weight = np.sum(lever * shift[rows], axis=1) / values[rows]
    read = values[rows] + np.sum(lever * left[rows], axis=1) / weight
    frame, mark = effect.frame.axis, "0" if effect.frame.role == "location" else ""
    name = f"E_{DIRECTIONS[component]}{mark}{frame}"
    unit = "µm" if component < 3 else "µrad"
    drawn = drawing_of(cause)
    label = f"shift of the tool side along {cause.where[0].lower()}" if drawn.of_base else f"{motion(name)}, {name}"
    panels = []
    for x in _against(found, cause):
        at = x.values[rows]
        if np.ptp(at) == 0.0:
            continue
        series = tuple(
            Series(told, at[of], read[of], weight[of], values[rows][of], not drawn.spread)
            for told, of in ((told, of[rows]) for told, of in _split(found, cause))
            if np.count_nonzero(of) >= FEWEST
        )
        panels.append(Panel(plain(cause.effect, cause.where), x.label, f"{label} [{unit}]", series, x.ticks))
    return panels


def drawing_of(cause: Cause) -> Drawing:
    """How a cause is drawn."""
    return SPECIFICATIONS[cause.effect].drawing


def _split(found: Answer, cause: Cause) -> list[tuple[str, np.ndarray]]:
    """Readings that a cause treats differently, named: by side of approach, or by where another axis stands."""
    data, machine = found.data, found.calibration.machine
    by = drawing_of(cause).split(cause.where)
    if by.startswith(APPROACH):
        sides = data.approach[:, machine.names.index(by.removeprefix(APPROACH))]
        return [("from +", sides > 0), ("from −", sides < 0)]
    if not by:
        return [("", np.ones(len(data), dtype=bool))]
    q = np.asarray(data.positions[:, machine.names.index(by)])
    low, high = float(q.min()), float(q.max())
    edges = np.linspace(low, high, 4)
    of = np.clip(np.searchsorted(edges, q, side="right") - 1, 0, 2)
    unit = machine.by_name[by].unit
    return [(f"{by} {edges[k]:.0f}…{edges[k + 1]:.0f} {unit}", of == k) for k in range(3)]


def _against(found: Answer, cause: Cause) -> list[Scale]:
    """What a cause is drawn against: what it depends on."""
    machine, where, drawn = found.calibration.machine, cause.where, drawing_of(cause)
    if drawn.size_of:
        return [_sized(found, where, drawn.size_of)]
    scales = scales_of(found)
    wanted = () if drawn.columns is None else _named(drawn.columns(where), machine)
    if known := [scales[name] for name in wanted if name in scales]:
        return known
    axes = [name for part in where.split(" ") if (name := axis_of(part)) in machine.by_name]
    if drawn.beyond and axes:
        axes = [*(axis.name for axis in machine.axes if not axis.linear and axis.name != axes[0]), axes[0]]
    own = [scales[name] for name in _named(dict.fromkeys(axes or machine.names), machine)][:2]
    period = drawn.period({q.name: q.value for q in cause.parameters})
    if period and axes:
        unit = "mm" if machine.by_name[axes[0]].linear else "°"
        return [_folded(own[0], axes[0], period, unit)]
    return own


def _sized(found: Answer, where: str, size_of: str) -> Scale:
    """What is no column of the table: the distance from the instrument, or how far a report is from its command."""
    if size_of == "distance":
        distance = np.linalg.norm(np.nan_to_num(found.data.point_mm), axis=1)
        return Scale("distance from the instrument [m]", 1e-3 * distance)
    machine = found.calibration.machine
    i = machine.names.index(where)
    off = np.nan_to_num(found.data.readback[:, i] - found.data.positions[:, i])
    unit, scale = ("µm", 1e3) if machine.axes[i].linear else ("°", 1.0)
    return Scale(f"{where} as reported less as commanded [{unit}]", off * scale)


def _columns_of(found: Answer, cause: Cause) -> list[str]:
    """Names of the columns a cause goes with."""
    if also := drawing_of(cause).depends_on(cause.where):
        return _named(also, found.calibration.machine)
    labels = [scale.label for scale in _against(found, cause)]
    return [name for name, scale in scales_of(found).items() if scale.label in labels]


def _named(names: Iterable[str], machine: Machine) -> list[str]:
    """Columns of the table: positions of axes by their names, others as they are."""
    return [f"{name}_{machine.by_name[name].unit}" if name in machine.by_name else name for name in names]


def _folded(whole: Scale, name: str, period: float, unit: str) -> Scale:
    """A position within one period, where there are many."""
    if float(np.ptp(whole.values)) < MANY_TURNS * period:
        return whole
    return Scale(f"{name} within its period of {period:.4g} {unit} [{unit}]", np.mod(whole.values, period))


def groups_of(x: np.ndarray) -> np.ndarray:
    """(n,) which readings belong together: the same stop, or neighbours."""
    distinct = np.unique(np.round(x, 3))
    if len(distinct) <= STOPS:
        return np.searchsorted(distinct, np.round(x, 3))
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)


def means(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, groups: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By group: middle, mean, and the half width of the mean's 95 % interval from the readings' own scatter."""
    count = np.bincount(groups)
    total = np.maximum(np.bincount(groups, weight), 1e-300)
    centre = np.bincount(groups, x) / np.maximum(count, 1)
    mean = np.bincount(groups, weight * y) / total
    spread = np.bincount(groups, weight * (y - mean[groups]) ** 2) / total
    # How many readings of equal weight would say as much (Kish).
    effective = total**2 / np.maximum(np.bincount(groups, weight**2), 1e-300)
    half = COVERAGE_FACTOR * np.sqrt(spread / np.maximum(effective - 1.0, 1.0))
    some = count >= FEWEST
    return centre[some], mean[some], half[some]


def _reach(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """How far from zero means and their intervals reach, and half of what an interval is wide (median)."""
    keep = np.isfinite(y)
    if np.count_nonzero(keep) < FEWEST:
        return 0.0, np.inf
    _, mean, half = means(x[keep], y[keep], np.ones(np.count_nonzero(keep)), groups_of(x[keep]))
    return float(np.max(np.abs(mean) + half, initial=0.0)), float(np.median(half)) if len(half) else np.inf
