"""Improvements of a part: errors to be measured again, and another place or orientation of the part in the working volume.

An error that is measured again is taken as known exactly: the machines drawn keep what is independent of it (conditional normal
distribution). Of a moved part, the program is moved with it: its points keep their places on the part, and the axes reach them at other
positions. Places are compared on the calibrated machine; at the best one, both places are compared on the same drawn machines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, final

import numpy as np

from twin._common.units import MM, UM
from twin.compensation.programs.execute import Execution
from twin.part.features import Tolerance
from twin.part.made import TEMPERATURE, Cut, Draw, Made, Maker, PartPlace
from twin.part.zones import FeaturePoints

Values = Callable[[Tolerance, Mapping[str, FeaturePoints], Mapping[str, FeaturePoints]], Mapping[str, np.ndarray]]
"""Function from a tolerance, surfaces and axes to its values, (machines,) µm, by feature (`twin.part.forecast.Judge.values_um`)."""
_Found = tuple[float, float, tuple[int, float] | None, np.ndarray]
"""Score, angle, turning rotary axis with its sign, and place of the part's zero."""
SETUP: Final = "set-up"
AT_MOST: Final = 3
"""Number of errors that are proposed to be measured again."""
CERTAIN: Final = 0.95
COMPARED: Final = 300
"""Machines on which two places are compared."""
POINTS: Final = 60
"""Points of a cut that are moved."""
GRID: Final = (6, 6, 3)
ROUNDS: Final = 3
TURNS_DEG: Final = (0.0, 90.0, 180.0, 270.0)
PATH_POINTS: Final = 4000
"""Points of the program that are tried for reach; all of them at the place that is returned."""
WORTH: Final = 0.9
"""Largest share of the worst tolerance's value at which another place is worth a word."""
TURNED: Final = 1e-9


@final
@dataclass(frozen=True)
class Remeasured:
    """Errors that would be known exactly, and what a tolerance's uncertainty would be then.

    Attributes:
        errors: their names; `SETUP`: the part's place on the table.
        upper_um, probability: as in `Conformity`.
    """

    errors: tuple[str, ...]
    upper_um: float
    probability: float


@final
@dataclass(frozen=True)
class PlaceGain:
    """Effect of another place on one tolerance, with the program as it is.

    Attributes:
        title: of the tolerance.
        here_um, there_um: value on the calibrated machine.
        gain_um: lower and upper limit (95 %) of the gain; NaN without uncertainty.
        probabilities: of conformity here and there; NaN without uncertainty.
    """

    title: str
    here_um: float
    there_um: float
    gain_um: tuple[float, float]
    probabilities: tuple[float, float]


@final
@dataclass(frozen=True)
class BetterPlace:
    """A better place of the part.

    Attributes:
        shift_mm: of the part's zero from where it is, along the axes of the work frame.
        turn_deg: of the part about the work frame's z axis, about its zero.
        axis: rotary axis that turns with the part; empty if the program is turned instead.
        gains: by tolerance.
    """

    shift_mm: tuple[float, float, float]
    turn_deg: float
    axis: str
    gains: tuple[PlaceGain, ...]


def remeasured(
    maker: Maker, values: Values, tolerance: Tolerance, made: Made, zero_mm: np.ndarray
) -> Remeasured | None:
    """Return the errors whose uncertainty matters most to a tolerance; None without uncertainty.

    They are added, the largest first, until the tolerance is held with 95 %, up to three of them.
    """
    groups = _groups(maker)
    if not groups:
        return None
    names, factors = [*groups], [*groups.values()]
    bases = [np.linalg.svd(factor, full_matrices=False)[2][: np.linalg.matrix_rank(factor)].T for factor in factors]
    setup, count = np.diag(maker.part.setup.standard), sum(base.shape[1] for base in bases)
    each = Draw(
        np.hstack([*bases, np.zeros((len(bases[0]), 7))]),
        np.hstack([np.zeros((6, count)), setup, np.zeros((6, 1))]),
        np.append(np.zeros(count + 6), maker.part.temperature.u_K),
    )
    place = PartPlace.at(zero_mm)
    size = np.max([*_values(maker, values, tolerance, made.cuts, place, each, mean=False).values()], axis=0)
    ends = np.cumsum([*(base.shape[1] for base in bases), 6])
    parts = [float(np.linalg.norm(part)) for part in np.split(size, ends)]
    order = np.argsort(parts)[::-1]
    zone, chosen = tolerance.zone * MM / UM, []
    found = None
    for i in order[:AT_MOST]:
        if not parts[i] > 0.0:
            break
        chosen.append((*names, SETUP, TEMPERATURE)[i])
        draw = _without(maker.draw, groups, chosen)
        left = np.max([*_values(maker, values, tolerance, made.cuts, place, draw).values()], axis=0)[1:]
        found = Remeasured(tuple(chosen), float(np.quantile(left, CERTAIN)), float(np.mean(left <= zone)))
        if found.probability >= CERTAIN:
            break
    return found


def _groups(maker: Maker) -> dict[str, np.ndarray]:
    """Return the rows of the covariance's factor by error."""
    uncertainty = maker.kinematics(0.0)[1]
    rows: dict[str, list[int]] = {}
    for i, parameter in enumerate(uncertainty.parameters):
        rows.setdefault(parameter.partition("[")[0], []).append(i)
    return {name: uncertainty.factor[some] for name, some in rows.items()}


def _without(draw: Draw, groups: Mapping[str, np.ndarray], known: Sequence[str]) -> Draw:
    """Return the machines with some errors, the set-up or the temperature at their values."""
    errors, factors = draw.errors, [groups[name] for name in known if name in groups]
    if factors:
        rows = np.concatenate(factors)
        errors = errors - np.linalg.pinv(rows) @ (rows @ errors)
    setup, warmer = draw.setup * (SETUP not in known), draw.warmer_K * (TEMPERATURE not in known)
    return Draw(errors, setup, warmer)


def _values(
    maker: Maker,
    values: Values,
    tolerance: Tolerance,
    cuts: Mapping[str, Sequence[Cut]],
    place: PartPlace,
    draw: Draw,
    *,
    mean: bool = True,
) -> Mapping[str, np.ndarray]:
    """Return the values of a tolerance on drawn machines by feature, with the part at its place."""
    surface = {}
    for name in (*tolerance.features, *tolerance.datums):
        feature = maker.part.features[name]
        surface[name] = (
            FeaturePoints.joined([maker.displaced(feature, cut, place, draw, mean=mean) for cut in cuts[name]])
            if name in cuts
            else maker.elsewhere(feature, draw.errors.shape[1])
        )
    return values(tolerance, surface, maker.axes(surface))


@final
class PlaceSearch:
    """Search for the best place of a part in the working volume of a machine, for a program that has been executed."""

    def __init__(self, maker: Maker, values: Values, made: Made, run: Execution, zero_mm: np.ndarray) -> None:
        self._maker, self._values, self._run, self._zero = maker, values, run, zero_mm
        self._every = made.cuts
        self._cuts = {name: [cut.thinned(POINTS) for cut in cuts] for name, cuts in made.cuts.items()}
        machine = maker.machine
        self._linear = list(machine.linear)
        limits = machine.limits / machine.scale[:, None]
        domains = np.array(maker.calibration.domains())
        self._low = np.maximum(limits[:, 0], domains[:, 0]) - 1e-9
        self._high = np.minimum(limits[:, 1], domains[:, 1]) + 1e-9
        count = len(run.positions)
        linear = run.positions[:, self._linear]
        rows = {*np.linspace(0, count - 1, min(count, PATH_POINTS)).astype(int).tolist()}
        rows |= {*linear.argmin(axis=0).tolist(), *linear.argmax(axis=0).tolist()}
        self._path = np.array(sorted(rows))

    def best(self) -> BetterPlace | None:
        """Return the best place found; None if none is better by `WORTH`."""
        here = self._scores(0.0, None, self._zero[None])[0]
        best: _Found = float(here), 0.0, None, self._zero
        for turn_deg in TURNS_DEG:
            for axis in self._turning(turn_deg):
                places = self._grid(turn_deg, axis)
                if not len(places):
                    continue
                best = self._better(best, turn_deg, axis, places)
                spacing = np.ptp(places, axis=0) / (np.array(GRID) - 1.0)
                for _ in range(ROUNDS if best[1] == turn_deg else 0):
                    spacing = spacing / 2.0
                    near = best[3] + np.array([*product((-1.0, 0.0, 1.0), repeat=3)]) * spacing
                    near = near[near[:, 2] >= self._zero[2] - 1e-9]
                    near = near[self._reached(turn_deg, axis, near, self._path)]
                    best = self._better(best, turn_deg, axis, near)
        score, turn_deg, axis, place = best
        every = np.arange(len(self._run.positions))
        if not score <= WORTH * here or not self._reached(turn_deg, axis, place[None], every)[0]:
            return None
        return self._described(turn_deg, axis, place)

    def _better(
        self,
        best: _Found,
        turn_deg: float,
        axis: tuple[int, float] | None,
        places: np.ndarray,
    ) -> _Found:
        if not len(places):
            return best
        scores = self._scores(turn_deg, axis, places)
        i = int(np.argmin(scores))
        return (float(scores[i]), turn_deg, axis, places[i]) if scores[i] < best[0] else best

    def _turning(self, turn_deg: float) -> Iterator[tuple[int, float] | None]:
        """Yield the rotary axis that carries the part about the work frame's z, with its sign, or None: only the program is turned."""
        if turn_deg == 0.0:
            yield None
            return
        nominal, machine = self._maker.nominal(0.0), self._maker.machine
        q = self._run.positions[self._path[:: max(1, len(self._path) // 20)]]
        before = nominal.forward(q).rotation
        wanted = _about_z(turn_deg) @ before
        for k, sign in product(machine.rotary, (1.0, -1.0)):
            moved = q.copy()
            moved[:, k] += sign * turn_deg
            if np.abs(nominal.forward(moved).rotation - wanted).max() < TURNED:
                yield k, sign
                return
        if np.abs(before[:, 2, 2]).min() > 1.0 - TURNED:
            yield None

    def _moved(
        self, q: np.ndarray, length: float, turn_deg: float, axis: tuple[int, float] | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions (n, axes) and matrices such that the tip is at its place on a part whose zero is at c.

        With (n, axes) positions p and (n, 3, 3) matrices M: the linear axes stand at p + M c. Third: (n, 3) tips relative to the zero.
        """
        nominal = self._maker.nominal(length)
        tip = (nominal.forward(q).point_mm - self._zero) @ _about_z(turn_deg).T
        moved = q.copy()
        if axis is not None:
            k, sign = axis
            moved[:, k] += sign * turn_deg
            low, high = self._low[k], self._high[k]
            moved[:, k] = np.where(moved[:, k] > high, moved[:, k] - 360.0, moved[:, k])
            moved[:, k] = np.where(moved[:, k] < low, moved[:, k] + 360.0, moved[:, k])
        point, by = nominal.travel(moved)
        matrices = np.linalg.inv(by[:, :, self._linear])
        moved[:, self._linear] += np.einsum("nij,nj->ni", matrices, tip - point)
        return moved, matrices, tip

    def _reached(
        self, turn_deg: float, axis: tuple[int, float] | None, places: np.ndarray, rows: np.ndarray
    ) -> np.ndarray:
        """Return (c,) whether the program's points ``rows`` are within the axis ranges with the part's zero at places (c, 3)."""
        found = np.ones(len(places), dtype=bool)
        for some in np.array_split(rows, max(1, len(rows) // 100_000)):
            moved, matrices, _ = self._moved(self._run.positions[some], 0.0, turn_deg, axis)
            # The tip of a longer tool is elsewhere, but its axes stand where they stand.
            fixed = np.delete(np.arange(moved.shape[1]), self._linear)
            found &= bool(((moved[:, fixed] >= self._low[fixed]) & (moved[:, fixed] <= self._high[fixed])).all())
            for i, c in enumerate(places):
                if found[i]:
                    linear = moved[:, self._linear] + matrices @ c
                    found[i] = bool(((linear >= self._low[self._linear]) & (linear <= self._high[self._linear])).all())
        return found

    def _grid(self, turn_deg: float, axis: tuple[int, float] | None) -> np.ndarray:
        """Return places (c, 3) of the part's zero, not below its height, at which the program is within reach."""
        moved, matrices, _ = self._moved(self._run.positions[self._path], 0.0, turn_deg, axis)
        linear = moved[:, self._linear]
        low, high = (self._low[self._linear] - linear).max(axis=0), (self._high[self._linear] - linear).min(axis=0)
        if np.any(low > high):
            return np.zeros((0, 3))
        back = np.linalg.inv(matrices.mean(axis=0))
        corners = np.array([*product(*np.column_stack([low, high]))]) @ back.T
        lowest, highest = corners.min(axis=0), corners.max(axis=0)
        lowest[2] = max(lowest[2], self._zero[2])
        if highest[2] < lowest[2]:
            return np.zeros((0, 3))
        steps = [np.linspace(*ends, count) for ends, count in zip(zip(lowest, highest, strict=True), GRID, strict=True)]
        places = np.array([*product(*steps)])
        return places[self._reached(turn_deg, axis, places, self._path)]

    def _scores(self, turn_deg: float, axis: tuple[int, float] | None, places: np.ndarray) -> np.ndarray:
        """Return (c,) the largest value of a tolerance at places (c, 3), as a share of its zone, on the calibrated machine."""
        surface, none = {}, Draw.none()
        features = self._maker.part.features
        for name, feature in features.items():
            if name not in self._cuts:
                surface[name] = self._maker.elsewhere(feature, len(places))
                continue
            parts = []
            for cut in self._cuts[name]:
                moved, place = self._at(cut, turn_deg, axis, places)
                points = self._maker.displaced(feature, moved, place, none)
                one = self._maker.displaced(feature, cut, PartPlace.at(self._zero), none)
                parts.append(one.with_deviation(points.deviation_um.reshape(len(places), -1).T))
            surface[name] = FeaturePoints.joined(parts)
        axes = self._maker.axes(surface)
        shares = [
            np.max([*self._values(tolerance, surface, axes).values()], axis=0) / (tolerance.zone * MM / UM)
            for tolerance in self._maker.part.tolerances
        ]
        return np.asarray(np.max(shares, axis=0))

    def _at(
        self, cut: Cut, turn_deg: float, axis: tuple[int, float] | None, places: np.ndarray
    ) -> tuple[Cut, PartPlace]:
        """Return a cut at all places (c, 3), one after another, and these."""
        moved, matrices, _ = self._moved(cut.q, cut.length_mm, turn_deg, axis)
        q = np.tile(moved, (len(places), 1, 1))
        q[:, :, self._linear] += np.einsum("nij,cj->cni", matrices, places)
        rows = np.tile(np.arange(len(cut.q)), len(places))
        many = Cut(cut.found.part(rows), q.reshape(len(rows), -1), cut.sides[rows], cut.axis[rows], cut.length_mm)
        return many, PartPlace(np.repeat(places, len(cut.q), axis=0), _about_z(turn_deg))

    def _described(self, turn_deg: float, axis: tuple[int, float] | None, place: np.ndarray) -> BetterPlace:
        maker = self._maker
        draw = maker.draw.first(COMPARED)
        moved = {
            name: [self._at(cut, turn_deg, axis, place[None])[0] for cut in cuts] for name, cuts in self._every.items()
        }
        there, here = PartPlace(place, _about_z(turn_deg)), PartPlace.at(self._zero)
        gains = []
        for tolerance in maker.part.tolerances:
            before, after = (
                np.max([*_values(maker, self._values, tolerance, cuts, at, draw).values()], axis=0)
                for cuts, at in ((self._every, here), (moved, there))
            )
            zone, known = tolerance.zone * MM / UM, len(before) > 1
            low, high = np.quantile((before - after)[1:], [0.025, 0.975]) if known else (np.nan, np.nan)
            shares = [float(np.mean(one[1:] <= zone)) if known else np.nan for one in (before, after)]
            gains.append(
                PlaceGain(
                    tolerance.title,
                    float(before[0]),
                    float(after[0]),
                    (float(low), float(high)),
                    (shares[0], shares[1]),
                )
            )
        shift = place - self._zero
        named = "" if axis is None else maker.machine.names[axis[0]]
        return BetterPlace((float(shift[0]), float(shift[1]), float(shift[2])), turn_deg, named, tuple(gains))


def _about_z(angle_deg: float) -> np.ndarray:
    """Return the rotation matrix about z."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
