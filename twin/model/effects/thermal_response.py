"""Response of the tool side to temperatures and spindle speed: what `twin thermal` fitted to measured displacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin._common.records import SPEED, TIME, is_temperature
from twin.machine.machine import Machine
from twin.model.effects.base import HistoryShift, Lag, ToolSide, channel, directions, tool_side
from twin.numerics.functions import lagged

NAME: Final = "thermal_response"
ROUNDING: Final = 1e-6
"""Largest excess over a range that is rounding, K or 1/min."""


class ResponseTerm(NamedTuple):
    """One term: its coefficient times the first-order lag of its input."""

    columns: tuple[
        str, ...
    ]  # ``T_<sensor>_degC``, whose mean above the reference is the input, or ``spindle_rpm`` alone
    time_constant: float  # s; 0 without lag
    exponent: float  # of the speed relative to the highest; 0 for temperatures
    coefficient: float  # µm/K, or µm at the highest speed


@final
class ThermalResponse(HistoryShift):
    """Shift of the tool side along a direction of the base frame: an offset, plus the sum of `ResponseTerm`.

    Temperatures are settled at the first reading; a speed applies from the reading before on, the first from time zero on, as for
    `SpindleGrowth`. A single temperature given for a program is taken to have been constant. It is valid in its ranges only.

    Args:
        side: the tool side and the direction.
        offset: µm; its standard uncertainty is the RMS error of the model on later data.
        terms: the terms.
        reference_degC: temperature of each column at which its input is zero.
        ranges: lowest and highest value of each column in the data that were fitted; the highest speed is that of ``spindle_rpm``.
    """

    units = (("offset", "um"),)

    def __init__(
        self,
        side: ToolSide,
        offset: float,
        terms: Sequence[ResponseTerm],
        reference_degC: Mapping[str, float],
        ranges: Mapping[str, tuple[float, float]],
    ) -> None:
        super().__init__(f"{NAME}:{side.direction}", side)
        self.offset = offset
        self.terms = tuple(terms)
        self.reference_degC = dict(reference_degC)
        self.ranges = dict(ranges)

    @property
    def lags(self) -> tuple[Lag, ...]:
        """See `HistoryShift.lags`."""
        return tuple(
            Lag(f"lag:{self.name}[{j}]", term.time_constant, not term.exponent)
            for j, term in enumerate(self.terms)
            if term.time_constant
        )

    def driven(self, positions: Mapping[str, Any]) -> tuple[Any, ...]:
        """See `HistoryShift.driven`; needs the columns."""
        inputs = self._inputs(positions)
        return tuple(one for one, term in zip(inputs, self.terms, strict=True) if term.time_constant)

    @property
    def factor_channels(self) -> tuple[str, ...]:
        """See `HistoryShift.factor_channels`: the sum of the terms, µm."""
        return (f"factor:{self.name}",)

    def factors(self, state: Mapping[str, Any]) -> Sequence[np.ndarray]:
        """Return the sum of the terms at readings, in any order of time, µm; needs the columns, and ``time_s``."""
        inputs = [np.asarray(one, dtype=float) for one in self._inputs(state)]
        time = np.asarray(channel(state, TIME, self.name), dtype=float)
        shape = np.broadcast_shapes(time.shape, *(one.shape for one in inputs))
        at = np.broadcast_to(time, shape).reshape(-1)
        total = np.zeros(at.shape)
        for one, term in zip(inputs, self.terms, strict=True):
            value = np.broadcast_to(one, shape).reshape(-1)
            if term.time_constant and (term.exponent or at.size > 1):
                value = lagged(at, value, term.time_constant, "held" if term.exponent else "linear").value
            total += term.coefficient * value
        return (total.reshape(shape),)

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`; needs the columns and ``time_s``, or `factor_channels`, or the columns and outputs of `lags`."""
        lags = self.lags
        if positions.get(self.factor_channels[0]) is not None:
            return self._shifted(self.offset + positions[self.factor_channels[0]])
        if not lags or positions.get(lags[0].channel) is None:
            return self._shifted(self.offset + self.factors(positions)[0])
        outputs = iter(lags)
        total = self.offset
        for one, term in zip(self._inputs(positions), self.terms, strict=True):
            total = total + term.coefficient * (positions[next(outputs).channel] if term.time_constant else one)
        return self._shifted(total)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return ({i: 0.0 * value + self.side.vector[i] for i, value in self.components(positions).items()},)

    def outside(self, positions: Mapping[str, Any]) -> dict[str, Any]:
        """Return, by column, whether (n,) values leave its range by more than rounding."""
        return {
            column: (np.asarray(positions[column]) < low - ROUNDING) | (np.asarray(positions[column]) > high + ROUNDING)
            for column, (low, high) in self.ranges.items()
            if column in positions
        }

    def _inputs(self, positions: Mapping[str, Any]) -> list[Any]:
        inputs = []
        for term in self.terms:
            if term.exponent:
                share = channel(positions, SPEED, self.name) / max(self.ranges[SPEED][1], 1e-9)
                inputs.append(share**term.exponent)
            else:
                warm = [channel(positions, name, self.name) - self.reference_degC[name] for name in term.columns]
                inputs.append(sum(warm[1:], start=warm[0]) / len(warm))
        return inputs

    @property
    def entry(self) -> dict[str, Any]:
        """Return the entry of a calibration file, as `thermal_response` reads it."""
        return {
            "effect": NAME,
            "where": self.side.direction,
            "parameters": self.numbers,
            "ranges": {name: [float(bound) for bound in limits] for name, limits in self.ranges.items()},
            "reference_degC": {name: float(value) for name, value in self.reference_degC.items()},
            "terms": [
                {
                    "columns": list(term.columns),
                    "time_constant": float(term.time_constant),
                    "exponent": float(term.exponent),
                    "coefficient": float(term.coefficient),
                }
                for term in self.terms
            ],
        }


def thermal_response(
    machine: Machine,
    where: str,
    offset: float,
    terms: Sequence[ResponseTerm],
    reference_degC: Mapping[str, float],
    ranges: Mapping[str, tuple[float, float]],
) -> ThermalResponse:
    """Create the response along a direction; `InputError` for a place, a column without range or reference, an empty range."""
    side = tool_side(machine, where)
    if side is None:
        raise InputError(f"no such place for {NAME}", expected=f"one of {', '.join(directions(machine))}", value=where)
    if not terms:
        raise InputError(f"{NAME} {where} has no terms", expected="at least one")
    for term in terms:
        known = all(name in ranges for name in term.columns) and bool(term.columns)
        speed = term.columns == (SPEED,)
        warm = all(is_temperature(name) and name in reference_degC for name in term.columns)
        if not known or not (speed if term.exponent else warm):
            raise InputError(
                f"columns of a term of {NAME} {where}",
                expected=f"{SPEED} with an exponent, or T_<sensor>_degC with a reference; each with a range",
                value=", ".join(term.columns) or "none",
            )
    for name, (low, high) in ranges.items():
        if not low < high:
            raise InputError(f"range of {name} in {NAME} {where}", expected="a lower and a higher value", value=low)
    return ThermalResponse(side, offset, terms, reference_degC, ranges)
