"""A joint that gives way under the load gravity puts on it: the machine's own weight, and what it carries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin.compute.batch import BatchFunction
from twin.machine.chain import gravity_load
from twin.machine.effects import places
from twin.machine.effects.base import AlongAxis, Frame, Parameter, along
from twin.machine.effects.payload import MASS, SIDES, SOUGHT_MM, Payload, heaviest_kg, loads, side_of
from twin.machine.effects.specification import EXTENDED, Advice, Drawing, Forms, Specification, State, Together
from twin.machine.machine import Axis, Machine
from twin.numerics.functions import given

FREE: Final = "payload"
"""In place of the parameters of a payload: it may be any, a number of its own to each of its four loads."""
UNLOADED: Final = 1e-6
"""N or N·m: rounding of a load that is none."""


@final
class GravityCompliance(AlongAxis):
    """The axis moves by compliance times the force or torque gravity exerts along it.

    Args:
        axis: the axis.
        load: N or N·m along the axis at given positions (`twin.machine.chain.gravity_load`), of own weight and payloads.
        compliance: µm/N or µrad/(N·m).
        payloads: what the machine carries beside what the URDF says; given, no estimates.
    """

    def __init__(
        self,
        axis: Axis,
        load: Callable[[Mapping[str, Any]], Any],
        compliance: float,
        payloads: tuple[Payload, ...] = (),
    ) -> None:
        super().__init__("gravity_compliance", axis)
        self.compliance = compliance
        self.payloads = payloads
        self._load = load

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The compliance."""
        return (self._number("compliance", _unit(self.axis), self.compliance),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, self._load(positions)),)


def _unit(axis: Axis) -> str:
    return "um/N" if axis.linear else "urad/(N.m)"


@lru_cache(maxsize=16)  # an effect is built for every step of an estimate; a machine never changes
def loads_of(machine: Machine) -> Callable[[Mapping[str, Any]], Mapping[str, Sequence[Any]]]:
    """Of every axis the nine loads of `gravity_load`, at positions as effects are given them (arrays or expressions)."""
    function = gravity_load(machine)
    batch, names = BatchFunction(function), machine.names

    def found(positions: Mapping[str, Any]) -> Mapping[str, Sequence[Any]]:
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


def payloads_of(axis: Axis, fixed: Mapping[str, float]) -> tuple[Payload, ...]:
    """The payload that a form was refined with; none if it was not."""
    return (Payload.of(side_of(axis), fixed),) if fixed.get(MASS) else ()


def _free_payload(machine: Machine, axis: Axis, values: np.ndarray) -> tuple[Payload, ...]:
    """The payload that a joint would need by itself, from (5,) numbers of its own and its free loads; none if its mass is nothing."""
    if values[0] == 0.0 or values[1] == 0.0:
        return ()
    shares = [values[1] / values[0], *(values[2:] / values[1])]
    return (Payload.of_shares(side_of(axis), heaviest_kg(machine), shares),)


def _forms(machine: Machine, where: str, state: State, known: Sequence[Payload] | None) -> Forms:
    """A joint that gives way: under its own weight and the payloads that a calibration has, or, if it has none, under any.

    Any payload is four numbers to each joint: its mass and its first moments, times the joint's compliance, here as shares of the
    largest. That it is the same to all joints, and how heavy it can be, is seen to where several are found
    (`twin.diagnosis.selection.payload`). No such form where the joint's own weight does not load it: nothing distinguishes the two.
    """
    axis, told = machine.by_name[where], tuple(known or ())
    load = np.stack(loads_of(machine)(state)[where], axis=1)
    first = 1 + 4 * SIDES.index(side_of(axis))
    free = load[:, first : first + 4] * heaviest_kg(machine) * [1.0, *[1e-3 * SOUGHT_MM] * 3]
    functions = given(np.column_stack([load @ loads(told), load[:, 0], free]))
    trials: tuple[Mapping[str, float], ...] = ({},)
    if known is None and np.any(np.abs(load[:, 0]) > UNLOADED):
        trials = ({}, {FREE: 1.0})

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[GravityCompliance, ...]:
        carried = _free_payload(machine, axis, values) if FREE in fixed else payloads_of(axis, fixed) or told
        return (gravity_compliance(machine, where, float(values[0]), carried),)

    def units(fixed: Mapping[str, float]) -> tuple[GravityCompliance, ...]:
        return (gravity_compliance(machine, where, 1.0, payloads_of(axis, fixed) or told),)

    names = tuple((name, _unit(axis)) for name in ("compliance", "by mass", "by x", "by y", "by z"))
    columns = [(0,), (1, 2, 3, 4, 5)][: len(trials)]
    together = Together(functions, columns, Frame(where, "motion"), tuple(along(axis, 1.0).items()))
    return Forms(names, build, units, trials, together=together)


GRAVITY_COMPLIANCE: Final = Specification(
    name="gravity_compliance",
    kind="machine",
    title=lambda where: f"{where} gives way under the weight it carries",
    family="yielding under weight",
    advice=Advice(
        "Service: clamp, drive and bearing of {axis}; what it carries.",
        f"{EXTENDED}, for this load.",
        "Do not use it for another load.",
    ),
    evidence=lambda of: f"{of.where} gives way under gravity",
    parameters=("compliance",),
    # The softest there is: 5 kN·m/rad is the stiffness of the gear in a small robot's wrist, 1 N/µm that of a weak slide.
    largest={"urad/(N.m)": 200.0, "um/N": 1.0},
    one_way=True,
    places=places.axes,
    make=lambda machine, where, numbers, payloads: gravity_compliance(machine, where, numbers["compliance"], payloads),
    forms=_forms,
    drawn=Drawing(spread=True),
)

PAYLOAD: Final = Specification(
    name="payload",
    kind="machine",
    title=lambda where: f"a load on the {where} side that the machine's description does not have",
    family="loads that the description does not have",
    advice=Advice(
        "Set-up: what was mounted on the {where} side when it was measured; weigh it.",
        f"{EXTENDED}, for this load.",
        "Do not use it for another load.",
    ),
    evidence=lambda of: f"the {of.where} side carries a mass that the URDF does not have: joints give way under it",
    parameters=("mass", "centre_x_mm", "centre_y_mm", "centre_z_mm"),
    places=lambda machine: SIDES,
    expected=lambda machine: "tool or work",
    candidates=lambda machine, state: ([], []),
)
