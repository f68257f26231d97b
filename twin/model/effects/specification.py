"""Specification of an effect: name, places, parameters, candidate forms, texts and plot, one frozen instance per effect.

All code that lists, reads, fits, bounds, names, explains or plots effects uses the specification; no code branches on an effect's
name. The effects of a machine are in `twin.model.effects.MACHINE_EFFECTS`; those of an instrument, and mistakes in the calibration,
are specified where their columns are made (`twin.diagnosis.candidates`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from types import MappingProxyType
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin._common.messages import Message, Number
from twin.display.numbers import capital
from twin.machine.machine import Machine
from twin.model.effects.base import Effect, Frame, Payload, ToolSide, tool_side
from twin.numerics.curves import CurveSpace
from twin.numerics.functions import Functions

Kind = Literal["machine", "calibration", "instrument"]
Varies = Literal["never", "with time", "with the frame"]
State = Mapping[str, np.ndarray]
EXTENDED: Final = "Compensate with the extended calibration"
EXTENDING: Final = "compensate with the extended calibration"
NOT_TWICE: Final = "Do not correct this error both in the control and in the calibration: it would be corrected twice."
NOTHING: Final = "Do not compensate or repair the machine because of this."
REST: Final = "Use the other results: this error has been removed from the data."


@final
@dataclass(frozen=True)
class Advice:
    """Advice on a cause: identifiers of messages with the places ``{axis}`` and ``{where}``, its axis and its place."""

    look: str  # where to look, and who should
    do: str  # what to do until it is repaired
    never: str  # what to avoid because it makes things worse


@final
@dataclass(frozen=True)
class FittedCause:
    """Fitted values of one cause, for the evidence sentence."""

    where: str
    size: float  # the linear parameter with the largest ratio of value to uncertainty
    unit: str
    numbers: Mapping[str, float]
    effects: Sequence[Effect] = ()  # the effects built from the fit

    @property
    def measure(self) -> str:
        """Size with its unit."""
        return Number(f"{self.size:.3g} {self.unit}")


@final
@dataclass(frozen=True)
class Drawing:
    """Description of the plot of a cause."""

    # place → columns of the table, or axes, for the horizontal axis, where present; if None, the axes named in the place
    columns: Callable[[str], tuple[str, ...]] | None = None
    # parameters of the cause → period over which the position is folded, mm or degrees; 0 for none
    period: Callable[[Mapping[str, float]], float] = lambda numbers: 0.0
    # place → what the readings are grouped by: ``approach_X``, or an axis (three groups); empty for no groups
    split: Callable[[str], str] = lambda where: ""
    # place → columns of the table, or axes, on which the cause depends, if other than those of the horizontal axis
    depends_on: Callable[[str], tuple[str, ...]] = lambda where: ()
    # quantity on the horizontal axis if it is not a column: ``distance`` from the instrument, or ``report``, the difference between the
    # position reported by the control and the command
    size_of: Literal["", "distance", "report"] = ""
    # whether shifts of the targets are plotted against the quantity they depend on instead of the predicted shift
    by_state: bool = False
    # whether readings at one position differ with another position or temperature, so that no line joins them
    spread: bool = False
    # column whose value is common to the readings that the cause changes: ``station`` or ``target``
    shared: Literal["", "station", "target"] = ""
    of_base: bool = False  # whether it shifts the tool side along a direction of the base frame
    beyond: bool = False  # whether it becomes visible when the other rotary axes turn


@final
@dataclass(frozen=True, eq=False)
class SharedColumns:
    """Columns of all trials, computed together."""

    functions: Functions
    columns: Sequence[tuple[int, ...]]  # for each trial the indices of the functions that are its columns
    frame: Frame  # frame in which they act
    parts: tuple[tuple[int, float], ...]  # error components of the frame in which they act, each with its factor


@final
@dataclass(frozen=True, eq=False)
class Forms:
    """The candidate forms of an effect at one place that the data can show."""

    names: tuple[tuple[str, str], ...]  # (name, unit) of its linear parameters
    # linear and fixed parameters → the effects that extend the model
    build: Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]]
    # fixed parameters → one effect per linear parameter, with that parameter set to 1, which gives the columns; may be None if
    # ``together`` is set
    units: Callable[[Mapping[str, float]], tuple[Effect, ...]] | None
    trials: tuple[Mapping[str, float], ...] = (MappingProxyType({}),)  # values of the fixed parameters that are tried
    tests: float | None = None  # number of independent tests this amounts to; the number of trials if None
    # the columns of all trials at once, which is faster; None if ``units`` is fast enough
    together: SharedColumns | None = None
    space: CurveSpace | None = None
    is_drift: bool = False  # whether a trial is a time constant, with a straight line in time as its limit


@final
@dataclass(frozen=True, kw_only=True)
class Specification:
    """Specification of one effect."""

    name: str
    kind: Kind  # whether it belongs to the machine, to its calibration file or to the instrument
    title: Callable[[str], str]  # place → plain description without symbols, in lower case
    advice: Advice
    evidence: Callable[[FittedCause], str]  # fitted values → what the effect does, a sentence without a full stop
    family: str = ""  # plain name of the kind of effect, in the plural where there is one; the name in words if empty
    parameters: tuple[str, ...] = ()  # their names in a calibration file
    # names of the parameters in an entry → the names that it must have; ``parameters`` if None
    required: Callable[[Sequence[str]], tuple[str, ...]] | None = None
    # name → unit of the numbers in an entry that are stated and not estimated; every fit reports them. Effects at one place that differ
    # in them are causes of their own, such as harmonics.
    fixed: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    # unit → largest magnitude of a parameter that is physically plausible; a fit beyond it is not an answer
    limits: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    # unit → smallest magnitude that is plausible, of units whose parameters cannot be zero (periods, time constants)
    least: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    non_negative: bool = False  # whether its parameter cannot be negative
    # machine → places where it can act; a channel that is part of the place is left out
    places: Callable[[Machine], tuple[str, ...]] = lambda machine: ()
    open_places: bool = False  # whether `places` is incomplete and `make` checks the place
    # machine → description of the places for an error; the list of them if None
    expected: Callable[[Machine], str] | None = None
    # place → columns of the table that it needs besides the positions
    channels: Callable[[str], tuple[str, ...]] = lambda where: ()
    # machine, place, parameters and payloads → the effect; None if it cannot occur in a calibration file
    make: Callable[[Machine, str, Mapping[str, float], Sequence[Payload]], Effect] | None = None
    # machine, place, state, and the payloads of the calibration (None if it has no compliances) → the candidate forms; if None, the
    # single form of `make` with its one parameter
    forms: Callable[[Machine, str, State, Sequence[Payload] | None], Forms] | None = None
    # machine and state → places that these data can show, and (place, what is missing) of the others; if None, `places` whose
    # `channels` exist
    candidates: Callable[[Machine, State], tuple[list[str], list[tuple[str, str]]]] | None = None
    # names of the non-linear parameters, which are tried at a set of values and then fitted; of a drift the time constant
    nonlinear: tuple[str, ...] = ()
    # the one of them that is a period along the axis of its place, mm: at the measured positions another may fit as well
    period: str = ""
    # effect, its parameters after a step of the fit, and the largest value tried → the effect with parameters within their limits
    constrain: Callable[[Any, Sequence[float], float], Effect] | None = None
    # whether two readings of one point can differ: with time, or from one alignment of the instrument to another
    varies: Varies = "never"
    curve: bool = False  # whether it is a function of one axis's position, to be validated on held-out positions
    # the simpler effect of which it is a variant with more parameters; it must predict better than that effect
    variant_of: str = ""
    constant: bool = False
    rare: bool = False  # whether it is a mistake that is rarely made, with a smaller share of the false alarms
    # whether its parameter is 1 wherever it is present (a mistake that is made completely or not at all)
    all_or_nothing: bool = False
    # largest number of causes of it at one place, of those that can imitate any curve together; 0: no limit
    most: int = 0
    flexible: bool = False  # whether its many parameters can absorb a part of any other effect
    # of an error of the instrument, the measurement that separates it from errors of the machine; the identifier of a message
    decided_by: str = "repeat the first round without touching the instrument or the targets"
    # number of its forms that are used to estimate the noise; 0: other effects have the same forms; None: the widest
    plain_forms: int | None = None
    drawing: Drawing = field(default_factory=Drawing)

    @property
    def plural(self) -> str:
        """Plain name of the kind of effect, a message."""
        return Message(self.family or self.name.replace("_", " "))

    def bound(self, units: Sequence[str]) -> float:
        """Return the largest plausible magnitude of the linear parameters, all of one unit; infinite if unknown."""
        return min((self.limits.get(unit, inf) for unit in units[:1]), default=inf)

    def is_plausible(self, value: float, unit: str) -> bool:
        """Return whether the magnitude of a parameter is within its limits; a unit without limits allows any."""
        return self.least.get(unit, 0.0) <= abs(value) <= self.limits.get(unit, inf)

    def numbers_of(self, where: str, numbers: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters of an entry in a file, in order; raise `InputError` if one is missing or unknown."""
        required = self.parameters if self.required is None else self.required(tuple(numbers))
        if set(numbers) != set(required):
            raise InputError(
                f"parameters of {self.name} {where}",
                expected=", ".join(required),
                value=", ".join(numbers) or "none",
                nearest=next(
                    (near for name in numbers if name not in required and (near := closest_name(name, required))), None
                ),
            )
        return {name: float(numbers[name]) for name in required}

    def no_place(self, machine: Machine, where: str) -> InputError:
        """Return the error for an unknown place, which lists the possible ones."""
        places = self.places(machine)
        expected = f"one of {', '.join(places)}" if self.expected is None else self.expected(machine)
        return InputError(
            f"no such place for {self.name}", expected=expected, value=where, nearest=closest_name(where, places)
        )

    def tool_side(self, machine: Machine, where: str, direction: str) -> ToolSide:
        """Return the tool side with a direction of the base frame; raise `InputError` if the machine has no such place."""
        side = tool_side(machine, direction)
        if side is None:
            raise self.no_place(machine, where)
        return side

    def candidate_places(self, machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
        """Return the places where these data can show it, and (place, missing column) of the others."""
        if self.candidates is not None:
            return self.candidates(machine, state)
        found, missing = [], []
        for where in self.places(machine):
            lacking = [name for name in self.channels(where) if name not in state]
            if lacking:
                missing += [(where, name) for name in lacking]
            else:
                found.append(where)
        return found, missing


def title_of(known: Specification | None, effect: str, where: str) -> str:
    """Return the name of an effect at a place in words; made of its name if it has no specification."""
    return f"{capital(effect.replace('_', ' '))} {where}" if known is None else capital(known.title(where))


# --- Places where effects can act on a machine: functions shared by the specifications ------------


def all_axes(machine: Machine) -> tuple[str, ...]:
    """Return the names of all axes."""
    return machine.names


def linear_axes(machine: Machine) -> tuple[str, ...]:
    """Return the names of the linear axes."""
    return tuple(axis.name for axis in machine.axes if axis.linear)


def rotary_axes(machine: Machine) -> tuple[str, ...]:
    """Return the names of the rotary axes."""
    return tuple(axis.name for axis in machine.axes if not axis.linear)


def approach_column(where: str) -> tuple[str, ...]:
    """Return the column with an axis's direction of approach."""
    return (f"approach_{where}",)


def linear_forms(
    names: tuple[tuple[str, str], ...],
    make: Callable[[Sequence[float], Mapping[str, float]], Effect],
    trials: tuple[Mapping[str, float], ...] = (MappingProxyType({}),),
    **more: Any,
) -> Forms:
    """Return the forms of an effect that is linear in parameters (name, unit); ``make``: these and the fixed ones → the effect."""
    units = np.eye(len(names)).tolist()
    return Forms(
        names,
        lambda values, fixed: (make([float(value) for value in values], fixed),),
        lambda fixed: tuple(make(unit, fixed) for unit in units),
        trials,
        **more,
    )


def single_parameter_form(names: tuple[str, str], make: Callable[[float], Effect]) -> Forms:
    """Return the single form of an effect that is proportional to one parameter (name, unit), which ``make`` takes."""
    return linear_forms((names,), lambda values, fixed: make(values[0]))
