"""The one thing every effect is: a pure function from axis positions to error components in one axis's frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, final

from twin._common.errors import InputError
from twin._common.units import UM, URAD
from twin.machine.machine import DIRECTIONS, ErrorFrame


@final
@dataclass(frozen=True)
class Frame:
    """The frame an effect acts in: which axis, and its motion or its location."""

    axis: str
    role: Literal["motion", "location"]


@final
@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    Attributes:
        name: ``E_XX[2]`` for a curve's coefficient, ``E_C0Y`` for a squareness or location.
        unit: ``um``, ``urad``, or what the effect says.
        value: in that unit.
    """

    name: str
    unit: str
    value: float


class Effect(ABC):
    """One effect of the model.

    Effects add: the six components of a frame are the sums over the effects that act in it, then
    ``Trans(e_X, e_Y, e_Z) · Exp([e_A, e_B, e_C])`` (contract §1).
    """

    name: str
    """ISO 230-1 name (``E_XX``, ``E_C0Y``, ``E_X0C``), or the effect's own."""

    @property
    @abstractmethod
    def frame(self) -> Frame:
        """Where it acts."""

    @abstractmethod
    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """Its contribution, by component index in ``XYZABC``: µm for the first three, µrad for the others.

        Args:
            positions: position of every axis, mm or degrees: arrays or CasADi expressions, all of one shape; where they are known also
                ``approach_<axis>`` (+1, −1, 0), ``time_s`` and ``T_<axis or sensor>_degC``.

        Raises:
            InputError: the effect needs a channel that is not given.
        """

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The numbers it is made of, in the order of `derivatives`."""

    @abstractmethod
    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """Derivative of `components` by each parameter: µm or µrad a unit of the parameter, by component index."""


def channel(positions: Mapping[str, Any], name: str, effect: str) -> Any:
    """A channel beside the positions.

    Raises:
        InputError: it is not given.
    """
    if name not in positions:
        raise InputError(f"{effect} needs {name}", expected=f"{name} with every position", value="nothing")
    return positions[name]


def assemble(effects: Sequence[Effect], frames: Sequence[ErrorFrame], positions: Mapping[str, Any]) -> list[list[Any]]:
    """All error frames at the given positions: ``[frame][component]``, metres and radians; 0.0 where nothing acts."""
    index = {(frame.axis, frame.role): i for i, frame in enumerate(frames)}
    total: list[list[Any]] = [[0.0] * 6 for _ in frames]
    for effect in effects:
        row = total[index[effect.frame.axis, effect.frame.role]]
        for component, value in effect.components(positions).items():
            row[component] = row[component] + value * (UM if component < 3 else URAD)
    return total


def unit_of(name: str) -> str:
    """The unit of an ISO 230-1 name: ``um`` of a translation, ``urad`` of a rotation."""
    return "um" if split_name(name)[0] < 3 else "urad"


def split_name(name: str) -> tuple[int, bool, str]:
    """Take an ISO 230-1 name apart: component index in ``XYZABC``, whether it is of the average line, axis name.

    ``E_C0Y`` → (5, True, "Y"); ``E_XX`` → (0, False, "X").
    """
    rest = name.removeprefix("E_")
    average = rest[1] == "0"
    return DIRECTIONS.index(rest[0]), average, rest[2:] if average else rest[1:]
