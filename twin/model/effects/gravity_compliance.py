"""Joint compliance under gravity: deflection under the machine's own weight, its payloads and the load it carries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.messages import Message
from twin.compute.along import BatchFunction
from twin.machine.chain import gravity_load
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import (
    CENTRE_RANGE_MM,
    FARTHEST_MM,
    HEAVIEST_KG,
    LARGEST_RATIO,
    LOAD,
    LOAD_NUMBERS,
    MASS,
    NUMBERS,
    OWN_WEIGHT,
    SIDES,
    AlongAxis,
    Effect,
    Frame,
    Parameter,
    Payload,
    Side,
    along,
    channel,
    is_carrying,
    loads,
    loads_per_kg,
    max_payload_kg,
    side_of,
    sum_of,
)
from twin.model.effects.specification import (
    EXTENDED,
    Advice,
    Drawing,
    Forms,
    SharedColumns,
    Specification,
    State,
    all_axes,
)
from twin.numerics.functions import tabulated

UNKNOWN_PAYLOAD: Final = "payload"
"""Fixed parameter of a form with an unknown payload: each of its four loads has a free coefficient."""
CARRIED: Final = tuple(f"load_{name}" for name in LOAD_NUMBERS)
"""Fixed parameters of a form with a carried load: those of its entry."""
RATIO: Final = CARRIED[0]
_KEYS: Final = dict(zip(LOAD_NUMBERS, CARRIED, strict=True))
FREE_LOADS: Final = 5
"""Number of coefficients of a form with an unknown payload, with which those of an unknown carried load begin."""
UNLOADED: Final = 1e-6
"""N or N·m: loads below this are rounding errors."""


@final
class GravityCompliance(AlongAxis):
    """The axis deflects by its compliance times the force or torque of gravity along it.

    ``load`` gives the load along the axis by own weight, payloads and carried load at positions, N or N·m (`gravity_load`); the
    payloads, loads that the URDF does not contain, are not estimated.
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
        self.units = (("compliance", _unit(axis)),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, self._load(positions)),)


@final
class AddedLoad(AlongAxis):
    """The axis deflects further, by its known compliance, under a mass that is missing from the machine description.

    In a calibration it is no effect of its own: the mass joins the load of the compliance (`carrying`), without an uncertainty.

    Args:
        load: positions → the (4,) loads along the axis by 1 kg and by a first moment of 1 kg·m in x, y, z (`gravity_load`); for a
            carried load those by the mass of each reading and by that mass 1 m away.
        weights: (4,) mass, kg, and first moments, kg·m; both per kg of a carried load.
        u: standard uncertainty of the compliance; ``relative_u`` is the fraction of it.
        beside: the deflections of joints that carry the load too and whose compliance is not known; they are part of the doubt only.
    """

    def __init__(
        self,
        compliant: GravityCompliance,
        load: Callable[[Mapping[str, Any]], Sequence[Any]],
        side: Side,
        weights: np.ndarray,
        *,
        carried: bool = False,
        u: float = 0.0,
        beside: Sequence[AddedLoad] = (),
    ) -> None:
        super().__init__("payload", compliant.axis)
        self.name = f"{CARRIED_LOAD.name if carried else PAYLOAD.name}:{side}"
        self.side: Side = side
        self.weights = weights
        self.carried = carried
        self.relative_u = u / abs(compliant.compliance) if compliant.compliance else 0.0
        self.beside = tuple(beside)
        self._compliance = compliant.compliance
        self._load = load

    @property
    def payload(self) -> Payload:
        """The mass and its centre."""
        mass = float(self.weights[0])
        x, y, z = (1e3 * float(moment) / mass for moment in self.weights[1:])
        return Payload(self.side, mass, (x, y, z), self.carried)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Mass and first moments; every joint of the side has the same."""
        mass, moment = (("mass_ratio", "1"), "m") if self.carried else (("mass", "kg"), "kg.m")
        names = (mass, *((f"moment_{letter}", moment) for letter in "xyz"))
        return tuple(
            self._number(name, unit, float(value)) for (name, unit), value in zip(names, self.weights, strict=True)
        )

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return tuple(along(self.axis, self._compliance * load) for load in self._load(positions))

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        size = sum(weight * load for weight, load in zip(self.weights, self._load(positions), strict=True))
        return along(self.axis, self._compliance * size)


def carrying(machine: Machine, extra: Sequence[Effect], known: int, added: AddedLoad) -> list[Effect]:
    """Return effects whose compliances on the side of an added load carry it.

    The first ``known`` do not contain it yet; a payload that they already carry is combined with it. The compliances after them were
    found together with the load.
    """
    carrying: list[Effect] = list(extra)
    whole = added.payload
    for k, one in enumerate(carrying):
        if not isinstance(one, GravityCompliance) or side_of(one.axis) != added.side:
            continue
        own = tuple(other for other in one.payloads if (other.side, other.carried) == (added.side, added.carried))
        if k < known:
            whole = sum_of((*own, added.payload))
        others = tuple(other for other in one.payloads if other not in own)
        carrying[k] = gravity_compliance(machine, one.axis.name, one.compliance, (*others, whole))
    return carrying


def _unit(axis: Axis) -> str:
    return "um/N" if axis.linear else "urad/(N.m)"


@lru_cache(maxsize=16)  # an effect is built in every step of an estimate; a machine is immutable
def loads_of(machine: Machine) -> Callable[[Mapping[str, Any]], Mapping[str, Sequence[Any]]]:
    """Return a function: positions (arrays or expressions) → for every axis the nine loads of `gravity_load`."""
    function = gravity_load(machine)
    batch, names = BatchFunction(function), machine.names

    @lru_cache(maxsize=32)  # every joint asks for its loads at the same positions
    def loads_at_rows(rows: bytes) -> np.ndarray:
        (values,) = batch(np.frombuffer(rows).reshape(-1, len(names)))
        return read_only(values)

    def loads_at(positions: Mapping[str, Any]) -> Mapping[str, Sequence[Any]]:
        parts = [positions[axis.name] * axis.scale for axis in machine.axes]
        if any(isinstance(part, ca.SX) for part in parts):
            every = function(ca.vertcat(*parts))
            return {name: ca.horzsplit(every[k, :]) for k, name in enumerate(names)}
        values = loads_at_rows(np.stack([np.asarray(part, dtype=float) for part in parts], axis=1).tobytes())
        return {name: list(values[:, k :: len(names)].T) for k, name in enumerate(names)}

    return loads_at


def gravity_compliance(
    machine: Machine, axis: str, compliance: float, payloads: Sequence[Payload] = ()
) -> GravityCompliance:
    """Create the effect for one axis of a machine with the given payloads; with a carried load it needs ``load_kg``."""
    weights, every = loads(payloads), loads_of(machine)
    per_kg = loads_per_kg(payloads, side_of(machine.by_name[axis]))

    def load(positions: Mapping[str, Any]) -> Any:
        units = every(positions)[axis]
        total = sum(weight * unit for weight, unit in zip(weights, units, strict=True) if weight != 0.0)
        if not np.any(per_kg):
            return total
        carried = sum(weight * unit for weight, unit in zip(per_kg, units, strict=True) if weight != 0.0)
        return total + channel(positions, LOAD, f"gravity_compliance:{axis}") * carried

    return GravityCompliance(machine.by_name[axis], load, compliance, tuple(payloads))


def refined_form(payload: Payload | None, carried: Payload | None) -> dict[str, float]:
    """Return the fixed parameters of a form refined with a payload, with a carried load, or with both."""
    found = dict.fromkeys((*NUMBERS, *CARRIED), 0.0) | ({} if payload is None else payload.numbers)
    return found | ({} if carried is None else {_KEYS[name]: value for name, value in carried.numbers.items()})


def payloads_of(axis: Axis, fixed: Mapping[str, float]) -> tuple[Payload, ...]:
    """Return the payload and the carried load with which a form was refined; empty if it was refined with none."""
    side, payloads = side_of(axis), []
    if fixed.get(MASS):
        payloads.append(Payload.of(side, fixed))
    if fixed.get(RATIO):
        payloads.append(Payload.of(side, {name: fixed[key] for name, key in _KEYS.items()}, carried=True))
    return tuple(payloads)


def combined(payloads: Sequence[Payload], added: Sequence[Payload]) -> tuple[Payload, ...]:
    """Return payloads with others added; those of one kind on one side become one."""
    kinds: dict[tuple[Side, bool], list[Payload]] = {}
    for one in (*payloads, *added):
        kinds.setdefault((one.side, one.carried), []).append(one)
    return tuple(some[0] if len(some) == 1 else sum_of(some) for some in kinds.values())


def _free_payload(machine: Machine, axis: Axis, values: np.ndarray) -> tuple[Payload, ...]:
    """Return the payload and the carried load that one joint alone implies, from its compliance and free loads (5 or 9,)."""
    side, free_payload = side_of(axis), []
    if values[0] and values[1] / values[0] > 0.0:
        shares = [values[1] / values[0], *np.clip(values[2:5] / values[1], -1.0, 1.0)]
        free_payload.append(Payload.of_shares(side, max_payload_kg(machine), shares))
    if len(values) > FREE_LOADS and values[0] and values[FREE_LOADS] / values[0] > 0.0:
        shares = [values[FREE_LOADS] / values[0], *np.clip(values[FREE_LOADS + 1 :] / values[FREE_LOADS], -1.0, 1.0)]
        free_payload.append(replace(Payload.of_shares(side, 1.0, shares), carried=True))
    return tuple(free_payload)


def _forms(machine: Machine, where: str, state: State, known: Sequence[Payload] | None) -> Forms:
    """Return the forms of a compliance: under own weight and the calibration's payloads, or, if it has none, with an unknown payload.

    An unknown payload has four coefficients at each joint: its mass and its first moments times the joint's compliance, as fractions
    of the largest. `twin.diagnosis.payload` makes it the same for all joints and bounds its mass. The form with an unknown
    payload is omitted if the joint's own weight does not load it: compliance and payload would be confounded. If the readings carry
    different loads, one form has that load at the origin of its frame, and the free form has four coefficients for it as well.
    """
    axis, payloads = machine.by_name[where], tuple(known or ())
    load = np.stack(loads_of(machine)(state)[where], axis=1)
    first, size = 1 + 4 * SIDES.index(side_of(axis)), np.array([1.0, *[1e-3 * CENTRE_RANGE_MM] * 3])
    free = load[:, first : first + 4] * size
    mass = state[LOAD][:, None] if is_carrying(state) else np.zeros((len(load), 1))
    plain = load @ loads(payloads) + mass[:, 0] * (load @ loads_per_kg(payloads, side_of(axis)))
    at_origin = load[:, 0] + mass[:, 0] * load[:, first]
    functions = tabulated(np.column_stack([plain, at_origin, load[:, 0], free * max_payload_kg(machine), free * mass]))
    trials: list[Mapping[str, float]] = [{}]
    columns: list[tuple[int, ...]] = [(0,)]
    varied = known is None and bool(np.ptp(mass) > 0.0)
    if varied and np.any(np.abs(load[:, first]) > UNLOADED):
        trials.append(refined_form(None, Payload(side_of(axis), 1.0, (0.0, 0.0, 0.0), carried=True)))
        columns.append((1,))
    if known is None and np.any(np.abs(load[:, 0]) > UNLOADED):
        trials.append({UNKNOWN_PAYLOAD: 1.0})
        columns.append(tuple(range(2, 3 + (8 if varied else 4))))

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[GravityCompliance, ...]:
        free = UNKNOWN_PAYLOAD in fixed
        added = _free_payload(machine, axis, values) if free else combined(payloads, payloads_of(axis, fixed))
        return (gravity_compliance(machine, where, float(values[0]), added),)

    def units(fixed: Mapping[str, float]) -> tuple[GravityCompliance, ...]:
        return (gravity_compliance(machine, where, 1.0, combined(payloads, payloads_of(axis, fixed))),)

    by = ("mass", "x", "y", "z", "load", "load x", "load y", "load z")
    names = tuple((name, _unit(axis)) for name in ("compliance", *(f"by {one}" for one in by)))
    together = SharedColumns(functions, columns, Frame(where, "motion"), tuple(along(axis, 1.0).items()))
    return Forms(names, build, units, tuple(trials), together=together)


SIDE_NAMES: Final = {"tool": Message("tool"), "work": Message("work")}

GRAVITY_COMPLIANCE: Final = Specification(
    name="gravity_compliance",
    kind="machine",
    title=lambda where: Message("deflection of {where} under gravity", where=where),
    family="deflection under gravity",
    advice=Advice(
        "Service: clamp, drive and bearings of {axis}; the load it carries.",
        f"{EXTENDED}, with this load or with the load that you give.",
        "Do not use that calibration with another load that is not given.",
    ),
    evidence=lambda fit: Message("{where} deflects under gravity", where=fit.where),
    parameters=("compliance",),
    # Upper limits of compliance: 5 kN·m/rad is the stiffness of the gear in a small robot's wrist, 1 N/µm that of a weak slide.
    limits={"urad/(N.m)": 200.0, "um/N": 1.0},
    non_negative=True,
    places=all_axes,
    make=lambda machine, where, numbers, payloads: gravity_compliance(machine, where, numbers["compliance"], payloads),
    forms=_forms,
    drawing=Drawing(spread=True),
)

PAYLOAD: Final = Specification(
    name="payload",
    kind="machine",
    title=lambda where: Message(
        "load on the {where} side that is missing from the machine description", where=SIDE_NAMES[where]
    ),
    family="loads missing from the machine description",
    advice=Advice(
        "Set-up: what was mounted on the {where} side during the measurement; weigh it.",
        f"{EXTENDED}, with this load only.",
        "Do not use that calibration with another load.",
    ),
    evidence=lambda fit: Message(
        "the {where} side carries a mass that is missing from the URDF; joints deflect under it",
        where=SIDE_NAMES[fit.where],
    ),
    parameters=NUMBERS,
    required=lambda names: (*NUMBERS, *([OWN_WEIGHT] if OWN_WEIGHT in names else [])),
    limits={"kg": HEAVIEST_KG, "mm": FARTHEST_MM},
    non_negative=True,
    places=lambda machine: SIDES,
    expected=lambda machine: "tool or work",
    candidates=lambda machine, state: ([], []),
)

CARRIED_LOAD: Final = replace(
    PAYLOAD,
    name="carried_load",
    title=lambda where: Message("deflection under the load that the {where} side carries", where=SIDE_NAMES[where]),
    family="deflection under the carried load",
    advice=Advice(
        "Set-up: the masses in the column load_kg, and how the load was held on the {where} side.",
        f"{EXTENDED} and give the mass that is carried.",
        "Do not hold a load at another place without entering its centre of gravity in the calibration.",
    ),
    evidence=lambda fit: Message(
        "joints deflect under the mass in the column {column}, carried on the {where} side",
        column=LOAD,
        where=SIDE_NAMES[fit.where],
    ),
    parameters=LOAD_NUMBERS,
    required=lambda names: LOAD_NUMBERS if LOAD_NUMBERS[0] in names else NUMBERS[1:],
    limits={"1": LARGEST_RATIO, "mm": FARTHEST_MM},
    channels=lambda where: (LOAD,),
    drawing=Drawing(columns=lambda where: (LOAD,), spread=True),
)
