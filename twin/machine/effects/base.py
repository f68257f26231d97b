"""Base class of all effects: a pure function from axis positions to error components in the frame of one axis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal, final

import numpy as np
import pinocchio as pin

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import UM, URAD
from twin.machine.machine import Axis, ErrorFrame, Machine

Vector = tuple[float, float, float]


@final
@dataclass(frozen=True)
class Frame:
    """Frame in which an effect acts: the axis, and whether it is its motion frame or its location frame."""

    axis: str
    role: Literal["motion", "location"]


@final
@dataclass(frozen=True)
class Parameter:
    """One parameter of the model.

    Attributes:
        name: ``E_XX[2]`` for a curve's coefficient, ``E_C0Y`` for a squareness or location.
        unit: ``um``, ``urad``, or the unit that the effect defines.
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
    frame: Frame
    """Frame in which it acts."""
    history: ClassVar[bool] = False
    """Whether its value at a reading depends on earlier readings."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters, in the order of `derivatives`."""

    @abstractmethod
    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """Return the derivative of `components` by each parameter: µm or µrad per unit of the parameter, by component index."""

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """Return the contribution to the frame, by component index in ``XYZABC``: µm for the first three, µrad for the others.

        This default applies to effects that are proportional to their first parameter; other effects override it.

        Args:
            positions: position of every axis, mm or degrees: arrays or CasADi expressions, all of one shape; also, where
                known, ``approach_<axis>`` (+1, −1, 0), ``time_s`` and ``T_<axis or sensor>_degC``.

        Raises:
            InputError: a channel that the effect needs is missing.
        """
        size = self.parameters[0].value
        return {i: size * shape for i, shape in self.derivatives(positions)[0].items()}

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters by the names used in an entry of a calibration file."""
        return {parameter.name.rpartition(".")[2]: float(parameter.value) for parameter in self.parameters}

    def _number(self, name: str, unit: str, value: float) -> Parameter:
        return Parameter(f"{self.name}.{name}", unit, value)


class AlongAxis(Effect):
    """An effect in the motion frame of an axis, in the direction of the axis's own motion.

    Args:
        effect: name of the effect (contract §5).
        axis: the axis.
    """

    def __init__(self, effect: str, axis: Axis) -> None:
        self.name = f"{effect}:{axis.name}"
        self.axis = axis
        self.frame = Frame(axis.name, "motion")

    @property
    def unit(self) -> str:
        """``um`` for a linear axis, ``urad`` for a rotary one."""
        return "um" if self.axis.linear else "urad"


def along(axis: Axis, value: Any) -> dict[int, Any]:
    """Return a displacement of ``value`` (µm or µrad) along the axis's motion as components of its error frame."""
    start = 0 if axis.linear else 3
    return {start + i: value * part for i, part in enumerate(axis.direction) if part != 0.0}


@final
class RecordingState(dict[str, Any]):
    """State of one pose inside the ranges that answers any request for a channel and records its name.

    Args:
        machine: the machine.

    Attributes:
        asked: names of the requested channels, in the order of the requests.
    """

    def __init__(self, machine: Machine) -> None:
        # An arbitrary pose: no effect is zero at 0.37 of a range.
        places = {
            axis.name: 137.0
            if axis.lower is None or axis.upper is None
            else axis.lower + 0.37 * (axis.upper - axis.lower)
            for axis in machine.axes
        }
        super().__init__({name: np.array([place]) for name, place in places.items()})
        self.asked: list[str] = []

    def __contains__(self, name: object) -> bool:
        return True

    def __missing__(self, name: str) -> np.ndarray:
        if name not in self.asked:
            self.asked.append(name)
        return np.array([27.0])


def channel(positions: Mapping[str, Any], name: str, effect: str) -> Any:
    """Return a channel that an effect needs besides the positions.

    Raises:
        InputError: the channel is missing.
    """
    if name not in positions:
        raise InputError(f"{effect} needs {name}", expected=f"{name} with every position", value="none")
    return positions[name]


def assemble(effects: Sequence[Effect], frames: Sequence[ErrorFrame], positions: Mapping[str, Any]) -> list[list[Any]]:
    """Return all error frames at the given positions: ``[frame][component]``, metres and radians; 0.0 where no effect acts."""
    return summed([(effect.frame, effect.components(positions)) for effect in effects], frames)


def summed(terms: Iterable[tuple[Frame, Mapping[int, Any]]], frames: Sequence[ErrorFrame]) -> list[list[Any]]:
    """Return all error frames, as by `assemble`, from frame and components (µm, µrad) of each effect."""
    index = {(frame.axis, frame.role): i for i, frame in enumerate(frames)}
    total: list[list[Any]] = [[0.0] * 6 for _ in frames]
    for at, components in terms:
        row = total[index[at.axis, at.role]]
        for component, value in components.items():
            row[component] = row[component] + value * (UM if component < 3 else URAD)
    return total


@lru_cache(maxsize=256)  # asked for every candidate of a diagnosis; a machine is immutable
def rest_orientation(machine: Machine, joint: int) -> np.ndarray:
    """Return the orientation (3, 3) of a joint in the base frame with all axes at zero."""
    data = machine.model.createData()
    pin.forwardKinematics(machine.model, data, pin.neutral(machine.model))
    return read_only(np.array(data.oMi[joint].rotation))


def base_vector(turn: np.ndarray, direction: str) -> Vector:
    """Return a direction of the base frame in a frame whose orientation in the base is ``turn``."""
    x, y, z = (float(v) if abs(v) > 1e-12 else 0.0 for v in turn["XYZ".index(direction)])
    return x, y, z


def motion_joint(machine: Machine, axis: str) -> int:
    """Return the index of the joint of an axis's motion frame."""
    return next(frame.joint for frame in machine.frames if (frame.axis, frame.role) == (axis, "motion"))
