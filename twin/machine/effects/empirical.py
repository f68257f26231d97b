"""A shift without a known cause: what was measured and has no name, as a smooth function of columns of the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.errors import InputError
from twin.machine.effects.base import Effect, Frame, Parameter, channel
from twin.machine.effects.waves import APPROACH, Waves, label, terms
from twin.numerics.elementary import cos, sin

DIRECTIONS: Final = "xyz"
SEEN: Final = 1e-12
"""Elements of a rotation below this are rounding."""


@final
@dataclass(frozen=True, eq=False)
class Turning:
    """The rotation from the axes a shift is given along to those of the error frame: constant + cosine·cos θ + sine·sin θ.

    Attributes:
        constant: (3, 3).
        axis: name of the rotary axis whose angle is θ; None where nothing turns.
        cosine, sine: (3, 3); zero where nothing turns.
    """

    constant: np.ndarray
    axis: str | None
    cosine: np.ndarray
    sine: np.ndarray

    def column(self, positions: Mapping[str, Any], direction: int) -> dict[int, Any]:
        """One direction in the error frame, by component; components that are always zero are left out."""
        constant, cosine, sine = (
            np.where(np.abs(part[:, direction]) > SEEN, part[:, direction], 0.0)
            for part in (self.constant, self.cosine, self.sine)
        )
        if self.axis is None:
            return {i: float(constant[i]) for i in range(3) if constant[i]}
        angle = positions[self.axis] * (pi / 180.0)
        return {
            i: float(constant[i]) + float(cosine[i]) * cos(angle) + float(sine[i]) * sin(angle)
            for i in range(3)
            if constant[i] or cosine[i] or sine[i]
        }


@final
class Empirical(Effect):
    """One side of the machine shifts with columns of the table, along fixed directions of a frame, without a known cause.

    The shift along each of x, y, z is Σ c_k f_k with the functions f_k of `twin.machine.effects.waves`. It is smooth and finite
    everywhere, but known only within `ranges`.

    Args:
        where: its place: ``tool by X_mm, Y_mm``.
        along: axes of which frame: ``base``, or ``tool`` or ``work``, the frame that the targets of that side are fixed to.
        columns: one or two columns with their functions.
        coefficients: µm by direction and function (`twin.machine.effects.waves.label`): ``x[3,1]``; what is absent is zero.
        frame: the error frame it acts in.
        turning: from the axes of ``along`` to that frame.
    """

    def __init__(
        self,
        where: str,
        along: Literal["base", "tool", "work"],
        columns: Sequence[Waves],
        coefficients: Mapping[str, float],
        frame: Frame,
        turning: Turning,
    ) -> None:
        self.name = f"empirical:{where}"
        self.where = where
        self.along = along
        self.columns = tuple(columns)
        self.coefficients = dict(coefficients)
        self.frame = frame
        self._turning = turning
        known = {key: (i, k) for i, per in enumerate(self.names(columns)) for k, key in enumerate(per)}
        self._terms = terms(self.columns)
        self._at = [known[key] for key in self.coefficients]

    @staticmethod
    def names(columns: Sequence[Waves]) -> list[list[str]]:
        """Names of all coefficients that some columns can have, by direction, in the order of their functions."""
        own = [label(columns, term) for term in terms(columns)]
        return [[f"{direction}[{one}]" for one in own] for direction in DIRECTIONS]

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """By column, the lowest and the highest value measured; columns whose functions need none are left out."""
        return {one.column: one.range for one in self.columns if one.range is not None}

    @property
    def directed(self) -> tuple[str, ...]:
        """Names of the axes whose direction of approach matters."""
        return tuple(one.column.removeprefix(APPROACH) for one in self.columns if one.kind == "direction")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`; needs its columns (``approach_<axis>``, ``T_<sensor>_degC``)."""
        functions = self._functions(positions)
        found: dict[int, Any] = {}
        for i in range(3):
            own = [
                (value, k)
                for (j, k), value in zip(self._at, self.coefficients.values(), strict=True)
                if j == i and value != 0.0
            ]
            if own:
                shift = sum(value * functions[k] for value, k in own)
                for component, part in self._turning.column(positions, i).items():
                    found[component] = found.get(component, 0.0) + part * shift
        return found or {0: 0.0 * functions[0]}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficients."""
        return tuple(Parameter(f"{self.name}.{key}", "um", value) for key, value in self.coefficients.items())

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        functions = self._functions(positions)
        turned = [self._turning.column(positions, i) for i in range(3)]
        return tuple({component: part * functions[k] for component, part in turned[i].items()} for i, k in self._at)

    def shift(self, positions: Mapping[str, Any]) -> np.ndarray:
        """(n, 3) µm along the axes of ``along``, at arrays of positions and channels."""
        functions = self._functions(positions)
        found = np.zeros((len(np.atleast_1d(functions[0])), 3))
        for (i, k), value in zip(self._at, self.coefficients.values(), strict=True):
            found[:, i] += value * functions[k]
        return found

    def outside(self, positions: Mapping[str, Any]) -> dict[str, Any]:
        """By column with a range that is given here: whether it is left by more than rounding, (n,) of arrays."""
        found = {}
        for one in self.columns:
            name = state_name(one.column)
            if one.range is not None and name in positions:
                found[one.column] = one.outside(np.asarray(positions[name], dtype=float))
        return found

    def _functions(self, positions: Mapping[str, Any]) -> list[Any]:
        own = [one.values(channel(positions, state_name(one.column), self.name)) for one in self.columns]
        if len(own) == 1:
            return own[0]
        found = []
        for i, j in self._terms:
            found.append(own[1][j - 1] if i == 0 else own[0][i - 1] if j == 0 else own[0][i - 1] * own[1][j - 1])
        return found


def check_ranges(
    effects: Sequence[Empirical],
    state: Mapping[str, Any],
    lines: np.ndarray | None = None,
    file: str | Path | None = None,
) -> None:
    """Raise `InputError` where positions or channels leave the range of an empirical effect.

    Args:
        effects: the empirical effects.
        state: (n,) positions by axis and channels; what is not given is not checked, and NaN is in every range.
        lines: (n,) where each is in a file.
        file: its name.

    Raises:
        InputError: with column, value and range.
    """
    for effect in effects:
        for column, outside in effect.outside(state).items():
            if np.any(outside):
                row = int(np.argmax(outside))
                low, high = effect.ranges[column]
                raise InputError(
                    f"{column} is outside the range over which {effect.name.replace(':', ' ', 1)} was measured",
                    expected=f"{low:g} to {high:g}, or a calibration without that effect (its cause is unknown)",
                    value=float(np.atleast_1d(state[state_name(column)])[row]),
                    file=file,
                    line=None if lines is None else int(lines[row]),
                )


def state_name(column: str) -> str:
    """What effects know a column of the table by: ``X_mm`` → ``X``; ``approach_X`` and ``T_bed_degC`` as they are."""
    if column.startswith(APPROACH) or column.endswith("_degC"):
        return column
    return column.removesuffix("_mm").removesuffix("_deg")
