"""A measured shift without a known cause, as a smooth function of columns of the measured table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.errors import InputError
from twin._common.records import APPROACH
from twin.model.effects.base import Effect, Frame, Parameter, channel
from twin.model.effects.harmonic import Waves, label, terms
from twin.model.effects.thermal_response import ThermalResponse
from twin.numerics.functions import cos, sin

DIRECTIONS: Final = "xyz"
ROTATION_ROUNDING: Final = 1e-12
"""Elements of a rotation matrix below this are rounding errors."""


@final
@dataclass(frozen=True, eq=False)
class FrameRotation:
    """Rotation from the axes along which a shift is given to those of the error frame: constant + cosine·cos θ + sine·sin θ."""

    constant: np.ndarray  # (3, 3) constant part
    axis: str | None  # name of the rotary axis whose angle is θ; None if the rotation is constant
    cosine: np.ndarray  # cosine, sine: (3, 3) parts that vary with θ; zero if the rotation is constant
    sine: np.ndarray

    def column(self, positions: Mapping[str, Any], direction: int) -> dict[int, Any]:
        """Return one direction in the error frame, by component; components that are always zero are omitted."""
        constant, cosine, sine = (
            np.where(np.abs(part[:, direction]) > ROTATION_ROUNDING, part[:, direction], 0.0)
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
    """Shift of one side of the machine, along fixed directions of a frame, as a function of columns of the table; cause unknown.

    The shift along each of x, y, z is Σ c_k f_k, in µm, with the functions f_k of `Waves`. It is smooth and finite everywhere, but was
    measured only within `ranges`.

    Args:
        where: the side and the columns: ``tool by X_mm, Y_mm``.
        along: frame whose axes the directions are: ``base``, or ``tool`` or ``work``, the frame to which the targets of that side are
            fixed.
        coefficients: µm by direction and function (`label`): ``x[3,1]``; absent ones are zero.
        turning: rotation from the axes of ``along`` to the error frame it acts in.
    """

    def __init__(
        self,
        where: str,
        along: Literal["base", "tool", "work"],
        columns: Sequence[Waves],
        coefficients: Mapping[str, float],
        frame: Frame,
        turning: FrameRotation,
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
        """Return the names of all coefficients that the columns can have, by direction, in the order of their functions."""
        labels = [label(columns, term) for term in terms(columns)]
        return [[f"{direction}[{name}]" for name in labels] for direction in DIRECTIONS]

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Lowest and highest value measured, by column; columns whose functions need no range are omitted."""
        return {column.column: column.range for column in self.columns if column.range is not None}

    @property
    def directed(self) -> tuple[str, ...]:
        """Names of the axes whose direction of approach it depends on."""
        return tuple(column.column.removeprefix(APPROACH) for column in self.columns if column.kind == "direction")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`; needs a channel for each column (``approach_<axis>``, ``T_<sensor>_degC``)."""
        functions = self._functions(positions)
        components: dict[int, Any] = {}
        for i in range(3):
            own = [
                (value, k)
                for (j, k), value in zip(self._at, self.coefficients.values(), strict=True)
                if j == i and value != 0.0
            ]
            if own:
                shift = sum(value * functions[k] for value, k in own)
                for component, part in self._turning.column(positions, i).items():
                    components[component] = components.get(component, 0.0) + part * shift
        return components or {0: 0.0 * functions[0]}

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
        """Return the shift (n, 3) in µm along the axes of ``along``, at arrays of positions and channels."""
        functions = self._functions(positions)
        shift = np.zeros((len(np.atleast_1d(functions[0])), 3))
        for (i, k), value in zip(self._at, self.coefficients.values(), strict=True):
            shift[:, i] += value * functions[k]
        return shift

    def outside(self, positions: Mapping[str, Any]) -> dict[str, Any]:
        """Return, by column with a range, whether (n,) values leave it by more than rounding. Other columns are omitted."""
        outside = {}
        for column in self.columns:
            name = channel_name(column.column)
            if column.range is not None and name in positions:
                outside[column.column] = column.outside(np.asarray(positions[name], dtype=float))
        return outside

    def _functions(self, positions: Mapping[str, Any]) -> list[Any]:
        own = [column.values(channel(positions, channel_name(column.column), self.name)) for column in self.columns]
        if len(own) == 1:
            return own[0]
        functions = []
        for i, j in self._terms:
            functions.append(own[1][j - 1] if i == 0 else own[0][i - 1] if j == 0 else own[0][i - 1] * own[1][j - 1])
        return functions


def check_ranges(
    effects: Sequence[Empirical | ThermalResponse],
    state: Mapping[str, Any],
    lines: np.ndarray | None = None,
    file: str | Path | None = None,
) -> None:
    """Raise `InputError` where positions or channels (n,) leave the range of an effect; it names column, value and range.

    Missing ones are not checked, and NaN counts as within every range. ``lines`` (n,) is the line of each in the file.
    """
    for effect in effects:
        for column, outside in effect.outside(state).items():
            if np.any(outside):
                row = int(np.argmax(outside))
                low, high = effect.ranges[column]
                raise InputError(
                    f"{column} is outside the range over which {effect.name.replace(':', ' ', 1)} was measured",
                    expected=f"{low:g} to {high:g}, or a calibration without that effect",
                    value=float(np.atleast_1d(state[channel_name(column)])[row]),
                    file=file,
                    line=None if lines is None else int(lines[row]),
                )


def channel_name(column: str) -> str:
    """Return the name that effects use for a column of the table: ``X_mm`` → ``X``; ``approach_X`` and ``T_bed_degC`` unchanged."""
    if column.startswith(APPROACH) or column.endswith("_degC"):
        return column
    return column.removesuffix("_mm").removesuffix("_deg")
