"""What is known of an effect beside its formula: one frozen specification in each effect's own file.

Whatever lists, reads, tries, bounds, names, explains or draws effects asks the specification; nothing branches on an effect's name. The
effects of a machine are in `twin.machine.effects.MACHINE_EFFECTS`; those of an instrument, and mistakes in the calibration, are
specified where their columns are made (`twin.diagnosis.causes`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from types import MappingProxyType
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.errors import InputError, nearest
from twin.machine.effects.base import Effect, Frame
from twin.machine.effects.payload import Payload
from twin.machine.machine import Machine
from twin.numerics.curves import CurveSpace
from twin.numerics.functions import Functions

Kind = Literal["machine", "calibration", "instrument"]
Varies = Literal["never", "with time", "with the frame"]
State = Mapping[str, np.ndarray]
EXTENDED: Final = "Compensate with the extended calibration"
EXTENDING: Final = "compensate with the extended calibration"
NOT_TWICE: Final = "Not both in the control and in the calibration: it would be corrected twice."
NOTHING: Final = "Compensate nothing and repair nothing on the machine because of this."
REST: Final = "Use the rest: it has been taken out of the account."


@final
@dataclass(frozen=True)
class Advice:
    """What follows from a cause; ``{axis}`` and ``{where}`` stand for its axis and its place.

    Attributes:
        look: where to look, and who.
        do: until it is put right.
        never: what would make it worse.
    """

    look: str
    do: str
    never: str


@final
@dataclass(frozen=True)
class Found:
    """What a fit found of one cause, for the sentence that says so.

    Attributes:
        where: its place.
        size: the linear parameter that is largest against its uncertainty.
        unit: of that, as people write it.
        numbers: all parameters by name.
        effects: the effects that were made of it.
    """

    where: str
    size: float
    unit: str
    numbers: Mapping[str, float]
    effects: Sequence[Effect] = ()

    @property
    def measure(self) -> str:
        """Size and unit."""
        return f"{self.size:.3g} {self.unit}"


@final
@dataclass(frozen=True)
class Drawing:
    """How a cause is drawn.

    Attributes:
        columns: place → columns of the table, or axes, that it is drawn against, as far as they are there; the axes the place names
            if None.
        period: numbers of the cause → period that the position is folded into, mm or degrees; 0 for none.
        split: place → what the readings are drawn apart by: ``approach_X``, or an axis, in three parts; empty for nothing.
        also: place → columns of the table, or axes, that the cause goes with, if not those it is drawn against.
        size_of: what stands on the horizontal axis where it is no column: the distance from the instrument, or how far the report of
            the control is from the command.
        by_state: whether shifts of the targets are drawn against what it depends on, not against what the cause says of them.
        spread: whether readings at one position differ by another position or temperature, so that no line joins them.
        shared: the column in which readings have a name in common with those that the cause changes: ``station`` or ``target``.
        of_base: whether it shifts the tool side along a direction of the base.
        beyond: whether it shows as the rotary axes beyond its own turn.
    """

    columns: Callable[[str], tuple[str, ...]] | None = None
    period: Callable[[Mapping[str, float]], float] = lambda numbers: 0.0
    split: Callable[[str], str] = lambda where: ""
    also: Callable[[str], tuple[str, ...]] = lambda where: ()
    size_of: Literal["", "distance", "report"] = ""
    by_state: bool = False
    spread: bool = False
    shared: Literal["", "station", "target"] = ""
    of_base: bool = False
    beyond: bool = False


@final
@dataclass(frozen=True, eq=False)
class Together:
    """The columns of all trials, worked out together.

    Attributes:
        functions: of the state.
        columns: of each trial, which of the functions its columns are.
        frame: the frame they act in.
        parts: the error components of it that they act in, with the share of each.
    """

    functions: Functions
    columns: Sequence[tuple[int, ...]]
    frame: Frame
    parts: tuple[tuple[int, float], ...]


@final
@dataclass(frozen=True, eq=False)
class Forms:
    """The forms that an effect can take at one place, where the data show it.

    Attributes:
        names: (name, unit) of its linear parameters.
        build: linear parameters and fixed ones → the effects that extend the model.
        units: fixed parameters → one effect a linear parameter, that parameter being one: what a column is; None where ``together`` is.
        trials: values of the fixed parameters that are tried.
        tests: how many independent ones that is; the number of trials if None.
        together: the same columns for all trials, quicker; None where ``units`` are quick enough.
        space: the functions that the columns of a curve are.
        drifts: whether a trial is a time constant, and a straight line in time is its limit.
    """

    names: tuple[tuple[str, str], ...]
    build: Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]]
    units: Callable[[Mapping[str, float]], tuple[Effect, ...]] | None
    trials: tuple[Mapping[str, float], ...] = (MappingProxyType({}),)
    tests: float | None = None
    together: Together | None = None
    space: CurveSpace | None = None
    drifts: bool = False


@final
@dataclass(frozen=True, kw_only=True)
class Specification:
    """One effect.

    Attributes:
        name: contract §5.
        kind: whether it sits in the machine, in the file that describes it, or in what measured it.
        title: place → what it is called where nobody knows the symbols, in lower case.
        family: what all of its kind are called; the name in words if empty.
        advice: what follows from it.
        evidence: what a fit found → what it does, a sentence without a full stop.
        parameters: their names in a calibration file.
        wanted: names that were given → the names there have to be; ``parameters`` if None.
        largest: unit → magnitude of its linear parameters beyond which no machine and no instrument has it.
        one_way: whether it never is negative.
        places: machine → where it can act; where a channel is part of the place, without it.
        open_places: whether there are more, and `make` judges them.
        expected: machine → those in words; the list of them if None.
        channels: place → columns of the table that it needs beside the positions.
        make: machine, place, parameters and payloads → the effect; None for what no calibration file has.
        forms: machine, place, state, and the payloads of the calibration (None where it says nothing of compliances) → the forms that
            are tried; those of `make` with its one parameter if None.
        candidates: machine and state → places that are tried on these data, and (place, what is missing) of the others; `places` by
            their `channels` if None.
        bent: non-linear parameters: they are tried at some values and then fitted.
        kept: effect, its parameters as a step of the fit has them, and the largest value that was tried → the effect with parameters
            that it can have.
        varies: whether it can make two readings of one point differ: with time, or from one alignment of the instrument to another.
        curve: whether it is a function of one axis's position: asked to foretell positions that were left out.
        more_of: the effect that it is a variant of, with more parameters; what it foretells must be more than that.
        constant: whether it is a constant of the machine.
        seldom: whether one look tells that it is there: a mistake, no effect of the contract's table.
        whole: whether it is there altogether or not at all: its parameter is one.
        pliable: whether its many numbers take up a little of anything.
        plain_forms: how many of its forms count as plain; 0: those of others say as much; None: the widest.
        drawn: how it is drawn.
    """

    name: str
    kind: Kind
    title: Callable[[str], str]
    advice: Advice
    evidence: Callable[[Found], str]
    family: str = ""
    parameters: tuple[str, ...] = ()
    wanted: Callable[[Sequence[str]], tuple[str, ...]] | None = None
    largest: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    one_way: bool = False
    places: Callable[[Machine], tuple[str, ...]] = lambda machine: ()
    open_places: bool = False
    expected: Callable[[Machine], str] | None = None
    channels: Callable[[str], tuple[str, ...]] = lambda where: ()
    make: Callable[[Machine, str, Mapping[str, float], Sequence[Payload]], Effect] | None = None
    forms: Callable[[Machine, str, State, Sequence[Payload] | None], Forms] | None = None
    candidates: Callable[[Machine, State], tuple[list[str], list[tuple[str, str]]]] | None = None
    bent: tuple[str, ...] = ()
    kept: Callable[[Any, Sequence[float], float], Effect] | None = None
    varies: Varies = "never"
    curve: bool = False
    more_of: str = ""
    constant: bool = False
    seldom: bool = False
    whole: bool = False
    pliable: bool = False
    plain_forms: int | None = None
    drawn: Drawing = field(default_factory=Drawing)

    @property
    def plural(self) -> str:
        """What all of its kind are called."""
        return self.family or self.name.replace("_", " ")

    def bound(self, units: Sequence[str]) -> float:
        """Magnitude its linear parameters can have; infinite where nothing is known.

        Args:
            units: of them; those that can be bounded have one unit.
        """
        return min((self.largest.get(unit, inf) for unit in units[:1]), default=inf)

    def numbers_of(self, where: str, numbers: Mapping[str, float]) -> dict[str, float]:
        """Parameters of an entry in a file, in order.

        Raises:
            InputError: one that is missing, or that it does not have.
        """
        wanted = self.parameters if self.wanted is None else self.wanted(tuple(numbers))
        if set(numbers) != set(wanted):
            raise InputError(
                f"parameters of {self.name} {where}",
                expected=", ".join(wanted),
                value=", ".join(numbers) or "nothing",
                nearest=next((near for one in numbers if one not in wanted and (near := nearest(one, wanted))), None),
            )
        return {name: float(numbers[name]) for name in wanted}

    def no_place(self, machine: Machine, where: str) -> InputError:
        """The error that says where it can act."""
        places = self.places(machine)
        expected = f"one of {', '.join(places)}" if self.expected is None else self.expected(machine)
        return InputError(
            f"no such place for {self.name}", expected=expected, value=where, nearest=nearest(where, places)
        )

    def tried_at(self, machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
        """Places at which these data can show it, and (place, column that is missing) of the others."""
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
