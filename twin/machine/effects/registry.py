"""Effects beside the named error motions, as a calibration file has them: ``effects:`` entries to and from `Effect`.

    effects:
      - {effect: reversal, where: Y, parameters: {size: 5.1}}

Names, places and parameters are those of the contract's table (§5). A payload is no effect by itself: it is part of the load of every
`gravity_compliance` in the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
import pinocchio as pin

from twin._common.errors import InputError, nearest
from twin.compute.batch import BatchFunction
from twin.machine.chain import gravity_load
from twin.machine.effects import (
    CrossAxis,
    Effect,
    Frame,
    GravityCompliance,
    Harmonic,
    Payload,
    PitchError,
    Reversal,
    ReversalCurve,
    SteadyDrift,
    TableLoad,
    ThermalDrift,
    ThermalExpansion,
    ThermalGrowth,
    ZeroOffset,
)
from twin.machine.effects.load import PAYLOAD_NUMBERS, SIDES, loads
from twin.machine.machine import Axis, Machine

Vector = tuple[float, float, float]
PAYLOAD: Final = "payload"
HEAVIEST_KG: Final = 1e5
FARTHEST_MM: Final = 1e4


def tool_base_frame(machine: Machine) -> tuple[Frame, np.ndarray] | None:
    """The error frame nearest the base on the tool side, and the base's directions in it (rows), at rest; None if there is none."""
    supports = machine.model.supports[machine.model.frames[machine.tool_frame].parentJoint].tolist()
    sides = [frame for frame in machine.frames if machine.by_name[frame.axis].side == "tool"]
    if not sides:
        return None
    first = min(sides, key=lambda frame: supports.index(frame.joint))
    return Frame(first.axis, first.role), at_rest(machine, first.joint)


def at_rest(machine: Machine, joint: int) -> np.ndarray:
    """(3, 3) a joint's orientation in the base frame with all axes at zero."""
    data = machine.model.createData()
    pin.forwardKinematics(machine.model, data, pin.neutral(machine.model))
    return np.asarray(data.oMi[joint].rotation)


def base_vector(turn: np.ndarray, direction: str) -> Vector:
    """A direction of the base in a frame that is turned by ``turn`` against it."""
    x, y, z = (float(v) if abs(v) > 1e-12 else 0.0 for v in turn["XYZ".index(direction)])
    return x, y, z


@lru_cache(maxsize=16)  # an effect is built for every step of an estimate; a machine never changes
def loads_of(machine: Machine) -> Callable[[Mapping[str, Any]], Mapping[str, Sequence[Any]]]:
    """Of every axis the nine loads of `gravity_load`, at positions as effects are given them (arrays or expressions)."""
    function = gravity_load(machine)
    batch, names = BatchFunction(function), machine.names

    def found(positions: Mapping[str, Any]) -> Mapping[str, Sequence[Any]]:
        import casadi as ca

        parts = [positions[one.name] * one.scale for one in machine.axes]
        if any(isinstance(part, ca.SX) for part in parts):
            every = function(ca.vertcat(*parts))
            return {name: ca.horzsplit(every[k, :]) for k, name in enumerate(names)}
        (values,) = batch(np.stack([np.asarray(part, dtype=float) for part in parts], axis=1))
        return {name: list(values[:, k :: len(names)].T) for k, name in enumerate(names)}

    return found


def gravity_compliance(
    machine: Machine, axis: str, compliance: float, payloads: Sequence[Payload] = ()
) -> GravityCompliance:
    """The effect on a machine that carries some payloads."""
    weights, every = loads(payloads), loads_of(machine)

    def load(positions: Mapping[str, Any]) -> Any:
        return sum(weight * one for weight, one in zip(weights, every(positions)[axis], strict=True) if weight != 0.0)

    return GravityCompliance(machine.by_name[axis], load, compliance, tuple(payloads))


def payload_named(where: str, numbers: Mapping[str, float]) -> Payload:
    """A payload of the contract's table.

    Args:
        where: ``tool`` or ``work``.
        numbers: its parameters by name.

    Raises:
        InputError: no such place or parameter; a parameter that is missing, or that no payload can have.
    """
    side = next((one for one in SIDES if one == where), None)
    if side is None:
        raise InputError(
            "no such place for payload", expected="tool or work", value=where, nearest=nearest(where, SIDES)
        )
    found = Payload.of(side, dict(zip(PARAMETERS[PAYLOAD], _numbers(PAYLOAD, where, numbers), strict=True)))
    if not 0.0 <= found.mass_kg <= HEAVIEST_KG:
        raise InputError(f"mass of payload {where}", expected=f"0 to {HEAVIEST_KG:g} kg", value=found.mass_kg)
    far = max(found.centre_mm, key=abs)
    if abs(far) > FARTHEST_MM:
        raise InputError(f"centre of payload {where}", expected=f"within {FARTHEST_MM:g} mm of the frame", value=far)
    return found


def effect_named(
    effect: str, where: str, numbers: Mapping[str, float], machine: Machine, payloads: Sequence[Payload] = ()
) -> Effect:
    """An effect of the contract's table.

    Args:
        effect: its name.
        where: its place.
        numbers: its parameters by name.
        machine: the machine.
        payloads: what the machine carries beside what the URDF says.

    Raises:
        InputError: no such effect, place or parameter; a parameter that is missing.
    """
    if effect not in PARAMETERS or effect == PAYLOAD:
        known = [one for one in PARAMETERS if one != PAYLOAD]
        raise InputError(
            "no such effect",
            expected=f"one of {', '.join(known)}",
            value=effect,
            nearest=nearest(effect, known),
        )
    value = _numbers(effect, where, numbers)
    if effect in ("reversal", "zero_offset", "gravity_compliance"):
        axis = _axis(machine, effect, where)
        if effect == "gravity_compliance":
            return gravity_compliance(machine, where, value[0], payloads)
        return Reversal(axis, value[0]) if effect == "reversal" else ZeroOffset(axis, value[0])
    if effect == "reversal_curve":
        axis = _axis(machine, effect, where)
        if axis.lower is None or axis.upper is None:
            raise InputError("no such place for reversal_curve", expected="an axis of limited range", value=where)
        return ReversalCurve(axis, tuple(value))
    if effect in ("pitch_error", "thermal_expansion"):
        axis = _axis(machine, effect, where, linear=True)
        return PitchError(axis, *value) if effect == "pitch_error" else ThermalExpansion(axis, value[0])
    if effect in ("thermal_growth", "thermal_drift"):
        first = tool_base_frame(machine)
        direction, _, sensor = where.partition(" by ")
        if first is None or direction not in tuple("XYZ") or bool(sensor) != (effect == "thermal_growth"):
            expected = "X, Y or Z of the base" + (" by <sensor>" if effect == "thermal_growth" else "")
            raise InputError(f"no such place for {effect}", expected=expected, value=where)
        vector = base_vector(first[1], direction)
        if effect == "thermal_growth":
            return ThermalGrowth(first[0], direction, vector, sensor, value[0])
        if set(numbers) == set(STEADY):
            return SteadyDrift(first[0], direction, vector, value[0])
        return ThermalDrift(first[0], direction, vector, *value)
    if effect == "table_load":
        axis = _axis(machine, effect, where, linear=False)
        joint = next(frame.joint for frame in machine.frames if frame.axis == where and frame.role == "motion")
        return TableLoad(where, base_vector(at_rest(machine, joint), "X"), value[0])
    if effect == "harmonic":
        if where not in machine.motion_names or machine.by_name[where[3:]].linear:
            raise InputError(
                "no such place for harmonic",
                expected="an error motion of a rotary axis",
                value=where,
                nearest=nearest(where, [one for one in machine.motion_names if not machine.by_name[one[3:]].linear]),
            )
        return Harmonic(where, round(value[0]), value[1], value[2])
    name, _, by = where.partition(" by ")
    if name not in machine.motion_names or by not in machine.by_name:
        places = [f"{motion} by {axis}" for motion in machine.motion_names for axis in machine.by_name]
        raise InputError(
            "no such place for cross_axis",
            expected="an error motion by an axis: E_ZY by Z",
            value=where,
            nearest=nearest(where, places),
        )
    return CrossAxis(name, by, value[0])


PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "reversal": ("size",),
    "reversal_curve": ("c0", "c1"),
    "zero_offset": ("offset",),
    "gravity_compliance": ("compliance",),
    PAYLOAD: PAYLOAD_NUMBERS,
    "pitch_error": ("amplitude", "period", "phase"),
    "thermal_expansion": ("coefficient",),
    "thermal_growth": ("coefficient",),
    "thermal_drift": ("amplitude", "time_constant"),
    "table_load": ("tilt",),
    "harmonic": ("order", "cos", "sin"),
    "cross_axis": ("coefficient",),
}
"""Linear and non-linear parameters of every effect that is no curve, squareness or location; a ``reversal_curve`` may have more."""

STEADY = ("rate",)
"""Parameters of a ``thermal_drift`` in a straight line, µm/h: its time constant is longer than the record it was found in."""


def _parameters(effect: str, numbers: Mapping[str, float]) -> tuple[str, ...]:
    """Names of the parameters that an effect has to have, of the forms it can take the one that is meant."""
    if effect == "thermal_drift" and set(numbers) == set(STEADY):
        return STEADY
    if effect == "reversal_curve" and numbers:
        return tuple(f"c{k}" for k in range(len(numbers)))
    return PARAMETERS[effect]


def _numbers(effect: str, where: str, numbers: Mapping[str, float]) -> list[float]:
    wanted = _parameters(effect, numbers)
    if set(numbers) != set(wanted):
        raise InputError(
            f"parameters of {effect} {where}",
            expected=", ".join(wanted),
            value=", ".join(numbers) or "nothing",
            nearest=next((near for one in numbers if one not in wanted and (near := nearest(one, wanted))), None),
        )
    return [float(numbers[name]) for name in wanted]


def payload_entries(effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """The entries that `payload_named` reads back, of the payloads some effects have in their load."""
    carried = [payload for effect in effects if isinstance(effect, GravityCompliance) for payload in effect.payloads]
    return [
        {"effect": PAYLOAD, "where": payload.side, "parameters": payload.numbers} for payload in dict.fromkeys(carried)
    ]


def entry_of(effect: Effect) -> dict[str, Any]:
    """The entry that `effect_named` reads back."""
    name, _, where = effect.name.partition(":")
    numbers = {parameter.name.rpartition(".")[2]: float(parameter.value) for parameter in effect.parameters}
    if isinstance(effect, Harmonic):
        where = where.partition("[")[0]
        numbers = {"order": effect.order, **numbers}
    return {"effect": name, "where": where, "parameters": numbers}


def _axis(machine: Machine, effect: str, where: str, *, linear: bool | None = None) -> Axis:
    axis = machine.by_name.get(where)
    if axis is None or (linear is not None and axis.linear is not linear):
        fitting = [one.name for one in machine.axes if linear is None or one.linear is linear]
        raise InputError(
            f"no such place for {effect}",
            expected=f"one of {', '.join(fitting)}",
            value=where,
            nearest=nearest(where, fitting),
        )
    return axis
