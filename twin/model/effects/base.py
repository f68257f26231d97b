"""Base class of all effects: a pure function from axis positions to error components in the frame of one axis.

Masses that are missing from the machine description; they act through the compliances of the joints that carry them.

A payload has a constant mass. A carried load has the mass of the channel ``load_kg``, which is known for every reading or program.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final, Literal, NamedTuple, final

import numpy as np
import pinocchio as pin

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import UM, URAD
from twin.machine.error_names import DIRECTIONS
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
    """One parameter of the model."""

    name: str  # ``E_XX[2]`` for a curve's coefficient, ``E_C0Y`` for a squareness or location
    unit: str  # ``um``, ``urad``, or the unit that the effect defines
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
    repeats: ClassVar[bool] = False
    """Whether one place may have several, which are not one with the sum of their parameters (`numbered`)."""

    units: tuple[tuple[str, str], ...] = ()
    """Names and units of the attributes that are its parameters, in the order of `derivatives`."""
    linear: ClassVar[int] = 1
    """Number of its first parameters in which the default `components` is linear, with the other parameters held."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters, in the order of `derivatives`."""
        return tuple(self._number(name, unit, getattr(self, name)) for name, unit in self.units)

    @abstractmethod
    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """Return the derivative of `components` by each parameter: µm or µrad per unit of the parameter, by component index."""

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """Return the contribution to the frame, by component index in ``XYZABC``: µm for the first three, µrad for the others.

        This default applies to effects that are linear in their first parameters (`linear`). Positions of every axis are mm or
        degrees: arrays or CasADi expressions, all of one shape; also, where known, ``approach_<axis>`` (+1, −1, 0), ``time_s`` and
        ``T_<axis or sensor>_degC``; raises `InputError` if one that the effect needs is missing.
        """
        first, *others = zip(self.parameters[: self.linear], self.derivatives(positions), strict=False)
        total = {i: first[0].value * shape for i, shape in first[1].items()}
        for parameter, shapes in others:
            for i, shape in shapes.items():
                total[i] = total[i] + parameter.value * shape if i in total else parameter.value * shape
        return total

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters by the names used in an entry of a calibration file."""
        return {parameter.name.rpartition(".")[2]: float(parameter.value) for parameter in self.parameters}

    @property
    def reversal_value(self) -> float:
        """Reversal value of its axis, µm or µrad, that a program takes up by extra moves; the largest one if it varies."""
        return 0.0

    @property
    def normal_form(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Signs and shifts, sign · value + shift of each parameter, that give the same effect with the parameters usual for it."""
        return (1.0,) * len(self.parameters), (0.0,) * len(self.parameters)

    def _number(self, name: str, unit: str, value: float) -> Parameter:
        return Parameter(f"{self.name}.{name}", unit, value)


class AlongAxis(Effect):
    """An effect in the motion frame of an axis, in the direction of the axis's own motion."""

    def __init__(self, effect: str, axis: Axis) -> None:
        self.name = f"{effect}:{axis.name}"
        self.axis = axis
        self.frame = Frame(axis.name, "motion")

    @property
    def unit(self) -> str:
        """``um`` for a linear axis, ``urad`` for a rotary one."""
        return "um" if self.axis.linear else "urad"


def numbered(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects with the second one of a place, if they repeat, named ``pitch_error:X[2]``, and so on."""
    counts: dict[str, int] = {}
    named = []
    for effect in effects:
        name = effect.name.partition("[")[0]
        counts[name] = counts.get(name, 0) + 1
        if effect.repeats:
            effect = copy(effect)
            effect.name = name if counts[name] == 1 else f"{name}[{counts[name]}]"
        named.append(effect)
    return tuple(named)


def along(axis: Axis, value: Any) -> dict[int, Any]:
    """Return a displacement of ``value`` (µm or µrad) along the axis's motion as components of its error frame."""
    start = 0 if axis.linear else 3
    return {start + i: value * part for i, part in enumerate(axis.direction) if part != 0.0}


def along_scale(axis: Axis, positions: Mapping[str, Any], by: Any) -> tuple[dict[int, Any], dict[int, Any]]:
    """Return what a scale in µm/m and an offset in µm, both in proportion to ``by``, displace along a linear axis, each per unit."""
    return along(axis, 1e-3 * positions[axis.name] * by), along(axis, by)


@final
class RecordingState(dict[str, Any]):
    """State of one pose inside the ranges that answers any request for a channel and records its name in ``asked``."""

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
    """Return a channel that an effect needs besides the positions. Raises `InputError`: the channel is missing."""
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


def rest_placement(machine: Machine, joint: int) -> pin.SE3:
    """Return the placement of a joint in the base frame with all axes at zero."""
    data = machine.model.createData()
    pin.forwardKinematics(machine.model, data, pin.neutral(machine.model))
    return pin.SE3(data.oMi[joint])


@lru_cache(maxsize=256)  # asked for every candidate of a diagnosis; a machine is immutable
def rest_orientation(machine: Machine, joint: int) -> np.ndarray:
    """Return the orientation (3, 3) of a joint in the base frame with all axes at zero."""
    return read_only(np.array(rest_placement(machine, joint).rotation))


def base_vector(turn: np.ndarray, direction: str) -> Vector:
    """Return a direction of the base frame in a frame whose orientation in the base is ``turn``."""
    x, y, z = (float(v) if abs(v) > 1e-12 else 0.0 for v in turn["XYZ".index(direction)])
    return x, y, z


def motion_joint(machine: Machine, axis: str) -> int:
    """Return the index of the joint of an axis's motion frame."""
    return next(frame.joint for frame in machine.frames if (frame.axis, frame.role) == (axis, "motion"))


# --- ISO 230-1 names of error motions, squareness and location: their parts, units and descriptions


def split_name(name: str) -> tuple[int, bool, str]:
    """Split an ISO 230-1 name: component index in ``XYZABC``, whether it describes the average line, axis name.

    ``E_C0Y`` → (5, True, "Y"); ``E_XX`` → (0, False, "X").
    """
    rest = name.removeprefix("E_")
    average = rest[1] == "0"
    return DIRECTIONS.index(rest[0]), average, rest[2:] if average else rest[1:]


def unit_of(name: str) -> str:
    """Return the unit of an ISO 230-1 name: ``um`` for a translation, ``urad`` for a rotation."""
    return "um" if split_name(name)[0] < 3 else "urad"


def axis_of(where: str) -> str:
    """Return the axis of a place, or the place itself if it has none: ``E_ZY by Z`` → Y."""
    first = where.split(" ")[0]
    return split_name(first)[2] if first.startswith("E_") else first


def direction_of(name: str) -> str:
    """Return the direction along or about which an ISO 230-1 name acts: x, y or z."""
    return "xyz"[split_name(name)[0] % 3]


def motion_in_words(name: str) -> str:
    """Describe an error motion in words: ``E_ZY`` → error of Y in z; ``E_BX`` → tilt of X about y."""
    component, average, axis = split_name(name)
    direction = direction_of(name)
    if average:
        return (
            Message("axis of {axis} displaced along {direction}", axis=axis, direction=direction)
            if component < 3
            else Message("axis of {axis} tilted about {direction}", axis=axis, direction=direction)
        )
    if DIRECTIONS[component] == axis:
        return Message("position of {axis}", axis=axis) if component < 3 else Message("angle of {axis}", axis=axis)
    return (
        Message("error of {axis} in {direction}", axis=axis, direction=direction)
        if component < 3
        else Message("tilt of {axis} about {direction}", axis=axis, direction=direction)
    )


# --- Masses that are missing from the machine description; they act through the compliances of the joints that carry them

Side = Literal["tool", "work"]
SIDES: Final[tuple[Side, ...]] = ("tool", "work")
NUMBERS: Final = ("mass", "centre_x_mm", "centre_y_mm", "centre_z_mm")
"""Parameters of a payload: contract §5."""
MASS: Final = NUMBERS[0]
OWN_WEIGHT: Final = "own_weight"
"""Parameter of a payload: the share of the deflection under the machine's own weight that its control leaves; 1 if not given."""
LOAD: Final = "load_kg"
"""Channel with the mass of a carried load, kg."""
LOAD_NUMBERS: Final = ("mass_ratio", *NUMBERS[1:])
"""Parameters of a carried load; ``mass_ratio`` is the mass that acts per kg of ``load_kg``, 1 if that mass is right."""
HEAVIEST_KG: Final = 1e5
FARTHEST_MM: Final = 1e4
"""Largest mass and distance accepted in a calibration file."""
LARGEST_RATIO: Final = 10.0
"""Largest mass that acts per kg of a carried load accepted in a calibration file."""
CENTRE_RANGE_MM: Final = 500.0
"""Search range of a payload's centre of gravity along each axis of the frame that carries it, ± mm."""


@final
@dataclass(frozen=True)
class Payload:
    """A mass that is missing from the URDF, fixed to the tool frame (spindle nose, flange) or to the work frame."""

    side: Side
    mass_kg: float  # mass; of a carried load the mass that acts per kg of the channel ``load_kg``
    centre_mm: tuple[float, float, float]  # centre of gravity in that frame
    carried: bool = False

    @classmethod
    def of(cls, side: Side, numbers: Mapping[str, float], *, carried: bool = False) -> Payload:
        """Create a payload from its `numbers`; the ``mass_ratio`` of a carried load is 1 if it is not given."""
        mass = numbers.get(LOAD_NUMBERS[0], 1.0) if carried else numbers[MASS]
        x, y, z = (float(numbers[name]) for name in NUMBERS[1:])
        return cls(side, float(mass), (x, y, z), carried)

    @classmethod
    def of_shares(cls, side: Side, heaviest: float, shares: Sequence[float] | np.ndarray) -> Payload:
        """Create a payload from its mass as a fraction of ``heaviest`` and its centre as fractions of the search range."""
        share, x, y, z = (float(value) for value in shares)
        return cls(side, heaviest * share, (CENTRE_RANGE_MM * x, CENTRE_RANGE_MM * y, CENTRE_RANGE_MM * z))

    @property
    def plausible(self) -> bool:
        """Whether the mass is positive and the centre within the search range."""
        return self.mass_kg > 0.0 and max(map(abs, self.centre_mm)) <= CENTRE_RANGE_MM * (1.0 + 1e-9)

    @property
    def numbers(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(LOAD_NUMBERS if self.carried else NUMBERS, (self.mass_kg, *self.centre_mm), strict=True))

    @property
    def weights(self) -> np.ndarray:
        """Factors (9,) of the loads of `twin.machine.chain.gravity_load`, kg and kg·m."""
        weights, first = np.zeros(9), 1 + 4 * SIDES.index(self.side)
        weights[first : first + 4] = self.mass_kg * np.array([1.0, *(1e-3 * value for value in self.centre_mm)])
        return weights

    def checked(self) -> Payload:
        """Return the payload itself; raise `InputError` if its mass or its centre is outside its limits."""
        if self.carried and not 0.0 <= self.mass_kg <= LARGEST_RATIO:
            raise InputError(
                f"mass_ratio of the load on the {self.side} side",
                expected=f"0 to {LARGEST_RATIO:g}, 1 if {LOAD} is right",
                value=self.mass_kg,
            )
        if not 0.0 <= self.mass_kg <= HEAVIEST_KG:
            raise InputError(f"mass of payload {self.side}", expected=f"0 to {HEAVIEST_KG:g} kg", value=self.mass_kg)
        far = max(self.centre_mm, key=abs)
        if abs(far) > FARTHEST_MM:
            expected = f"within {FARTHEST_MM:g} mm of the frame"
            raise InputError(f"centre of payload {self.side}", expected=expected, value=far)
        return self


def loads(payloads: Sequence[Payload]) -> np.ndarray:
    """Return the factors (9,) of the loads of `twin.machine.chain.gravity_load`: 1 for the machine's own weight, and the payloads'."""
    constant = (payload.weights for payload in payloads if not payload.carried)
    return np.asarray(np.eye(9)[0] + sum(constant, np.zeros(9)))


def loads_per_kg(payloads: Sequence[Payload], side: Side) -> np.ndarray:
    """Return the factors (9,) of the loads of `twin.machine.chain.gravity_load` per kg of the load carried on one side."""
    return np.asarray(
        sum((payload.weights for payload in payloads if payload.carried and payload.side == side), np.zeros(9))
    )


def is_carrying(state: Mapping[str, np.ndarray]) -> bool:
    """Return whether the readings have a carried load, in any row."""
    return LOAD in state and bool(np.any(state[LOAD]))


def sum_of(payloads: Sequence[Payload]) -> Payload:
    """Return one payload with the mass and the first moments of several of one kind on one side."""
    mass = sum(payload.mass_kg for payload in payloads)
    x, y, z = (sum(payload.mass_kg * payload.centre_mm[i] for payload in payloads) / mass for i in range(3))
    return Payload(payloads[0].side, mass, (x, y, z), payloads[0].carried)


def side_of(axis: Axis) -> Side:
    """Return the side whose payload an axis carries."""
    return "tool" if axis.side == "tool" else "work"


SEARCHED: Final = 10.0
"""Largest payload of the search as a multiple of the mass of the moving parts."""


def moving_mass_kg(machine: Machine) -> float:
    """Return the mass of the moving parts in the URDF, kg: robots and tables carry no more than about their own weight."""
    return float(sum(machine.model.inertias[joint].mass for joint in range(1, machine.model.njoints)))


def max_payload_kg(machine: Machine) -> float:
    """Return the largest payload of the search, kg.

    Beyond the mass of the moving parts, it is no mass: the control corrects a part of the deflection under own weight (`OWN_WEIGHT`),
    but not that of a load.
    """
    return SEARCHED * moving_mass_kg(machine)


# --- Shifts of the whole tool side along a direction of the base frame ----------------------------


class ToolSide(NamedTuple):
    """The tool side and one direction of the base frame."""

    frame: Frame  # the error frame on the tool side that is nearest the base
    direction: str  # ``X``, ``Y`` or ``Z`` of the base frame
    vector: Vector  # that direction in the frame


class ToolSideShift(Effect):
    """Shift of the tool side along a direction of the base frame, proportional to the first parameter."""

    def __init__(self, name: str, side: ToolSide) -> None:
        self.name = name
        self.frame = side.frame
        self.side = side

    def _shifted(self, shape: Any) -> dict[int, Any]:
        """Return a shift of ``shape`` along the direction, by component."""
        return {i: part * shape for i, part in enumerate(self.side.vector) if part != 0.0}


class Lag(NamedTuple):
    """A first-order lag of the machine's past."""

    channel: str  # name of the channel that holds its output
    time_constant: float  # s
    starts_settled: bool  # whether it is equal to its input at the first reading, or zero


class HistoryShift(ToolSideShift):
    """A shift of the tool side that depends on what the machine did before.

    Its derivatives by the parameters follow from readings in the order of time. At single poses, as those of a program, they are given
    as the channels `factor_channels`.
    """

    history = True
    time_constant: float
    """Time constant of the lag, s, of an effect that has one."""
    starts_settled: ClassVar[bool]
    """Whether that lag is equal to its input at the first reading, or zero."""

    @property
    def lags(self) -> tuple[Lag, ...]:
        """Return its lags; by default one, whose output is the derivative by the first parameter."""
        return (Lag(self.factor_channels[0], self.time_constant, self.starts_settled),)

    @abstractmethod
    def driven(self, positions: Mapping[str, Any]) -> tuple[Any, ...]:
        """Return the inputs of `lags`."""

    @property
    def factor_channels(self) -> tuple[str, ...]:
        """Names of the channels that hold the derivative by each parameter."""
        return tuple(f"factor:{parameter.name}" for parameter in self.parameters)

    @abstractmethod
    def factors(self, state: Mapping[str, Any]) -> Sequence[np.ndarray]:
        """Return the derivative of the shift by each parameter at readings, in any order of time: µm per unit of the parameter.

        The channels of the readings are (n,) or single values.
        """

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs the channels of `factors`, or `factor_channels`."""
        given = [positions.get(name) for name in self.factor_channels]
        factors = self.factors(positions) if given[0] is None else given
        return tuple(self._shifted(factor) for factor in factors)


def directions(machine: Machine) -> tuple[str, ...]:
    """Return the directions of the base frame; empty if no axis is on the tool side."""
    return ("X", "Y", "Z") if _first(machine) is not None else ()


def tool_side(machine: Machine, direction: str) -> ToolSide | None:
    """Return the tool side with a direction of the base frame; None if no axis is on it or the direction is unknown."""
    first = _first(machine)
    if first is None or direction not in tuple("XYZ"):
        return None
    return ToolSide(first[0], direction, base_vector(first[1], direction))


def _first(machine: Machine) -> tuple[Frame, np.ndarray] | None:
    """Return the tool side's error frame nearest the base and the base's directions in it (rows) with all axes at zero, or None."""
    supports = machine.model.supports[machine.model.frames[machine.tool_frame].parentJoint].tolist()
    sides = [frame for frame in machine.frames if machine.by_name[frame.axis].side == "tool"]
    if not sides:
        return None
    first = min(sides, key=lambda frame: supports.index(frame.joint))
    return Frame(first.axis, first.role), rest_orientation(machine, first.joint)
