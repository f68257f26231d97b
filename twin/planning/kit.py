"""Kit file: instruments, possible station positions, reflectors, and times of the operations.

The unknowns of the linear model of planned readings are those of `identify`: every error motion as orthonormal functions of its axis,
squareness, location errors, stations, targets. The prior is the expected size of each: the coefficients of a curve decrease as those of
the given calibration do (`twin.identification.fitting`); constants, stations and targets have their plausible size. The model is
linearised about the expected errors.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, final

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict, Field, field_validator
from pydantic_core import PydanticCustomError

from twin._common.arrays import read_only
from twin._common.bundled import find_bundled
from twin._common.errors import InputError, closest_name
from twin._common.units import DEG, MM
from twin._common.yaml_files import EntryPath, load_yaml
from twin.display.numbers import listed
from twin.display.results import Result
from twin.identification.network import (
    CHUNK,
    Network,
    Unknowns,
    axes_with_known_places,
    least_determined_offset,
    spaces_for,
)
from twin.identification.solve import all_unknowns, free_directions
from twin.identification.unidentified import Unidentified, inseparable
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Instrument, StationInstruments
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.simulate import Placement, Station, simulate, three_floats
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import split_name
from twin.model.motion_curve import Curve
from twin.numerics.curves import Basis, CurveSpace, bases_for
from twin.numerics.observability import NOT_DETERMINED, Determinability, determinability
from twin.numerics.spatial import rotation_exp
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import volume

SCHEMA: Final = "twin.kit/1"
ACCEPTANCE_DEG: Final = 30.0
"""Acceptance angle of a spherically mounted reflector, either side of its axis (Leica red ring reflector, data sheet)."""
DISTANCE_MM: Final = 2000.0
"""Distance of a default station from the middle of the working volume, mm."""
TRAVEL_MM_S: Final = 100.0
TRAVEL_DEG_S: Final = 15.0
CONTACT_S: Final = 6.0
"""Seconds for one contact of a touch probe: approach, touch and retraction."""


class _KitEntries(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


@final
class Seconds(_KitEntries):
    """Times of the operations in seconds."""

    point: Annotated[float, Field(gt=0)] = 15.0  # settling and reading
    # turning a reflector towards the instrument by hand when it is outside the acceptance angle
    aim: Annotated[float, Field(ge=0)] = 20.0
    target: Annotated[float, Field(ge=0)] = 30.0  # changing from one reflector to another
    station: Annotated[float, Field(ge=0)] = 900.0  # setting the instrument up in another place
    contact: Annotated[float, Field(gt=0)] = CONTACT_S  # one contact of a touch probe: approach, touch and retraction


class _StationEntry(_KitEntries):
    origin_mm: tuple[float, float, float]
    turn_deg: tuple[float, float, float] | None = None
    known: bool = False

    def station(self, middle: np.ndarray) -> Station:
        """Return the station; without ``turn_deg`` it faces the middle of the working volume."""
        if self.turn_deg is None:
            return station_facing(self.origin_mm, middle)
        return Station(self.origin_mm, three_floats(np.array(self.turn_deg) * DEG))


class _TargetEntry(_KitEntries):
    carrier: Literal["tool", "work"]
    place_mm: tuple[float, float, float]
    known: bool = False
    facing: tuple[float, float, float] | Literal["aimed"] = "aimed"
    acceptance_deg: Annotated[float, Field(gt=0, le=180)] = ACCEPTANCE_DEG

    @field_validator("facing", mode="before")
    @classmethod
    def _direction(cls, value: Any) -> Any:
        if value != "aimed" and not (isinstance(value, list) and len(value) == 3):
            expected = "aimed, or x, y, z on its carrier"
            raise PydanticCustomError("facing", "Input should be {expected}", {"expected": expected})
        return value

    def target(self) -> Target:
        """Return the target, with its facing as a unit vector."""
        facing = None
        if self.facing != "aimed":
            way = np.array(self.facing, dtype=float)
            facing = three_floats(way / np.linalg.norm(way))
        return Target(self.carrier, self.place_mm, self.known, facing, self.acceptance_deg * DEG)


class _KitFile(_KitEntries):
    schema_: Literal["twin.kit/1"] = Field(alias="schema")
    source: str = ""
    instruments: Annotated[tuple[str, ...], Field(min_length=1)] = ("tracker",)
    stations: Annotated[dict[str, _StationEntry], Field(min_length=1)]
    targets: Annotated[dict[str, _TargetEntry], Field(min_length=1)]
    seconds: Seconds = Seconds()
    speeds: dict[str, Annotated[float, Field(gt=0)]] = {}
    ranges: dict[str, tuple[float, float]] = {}
    stops_the_beam: Literal["machine", "nothing"] = "machine"


@final
@dataclass(frozen=True)
class Target:
    """A reflector."""

    carrier: Literal["tool", "work"]  # ``tool`` or ``work``
    place_mm: tuple[float, float, float]  # nominal position on its carrier; it need not be met to the millimetre
    known: bool  # whether an evaluation may treat the position as exactly known
    # (3,) unit vector of its axis on its carrier; None: it is turned towards the instrument by hand
    facing: tuple[float, float, float] | None
    acceptance_rad: float  # largest angle between its axis and the beam


@final
@dataclass(frozen=True, repr=False)
class Kit(Result):
    """Equipment for a measurement.

    Attributes:
        source: origin of the kit, in words.
        instruments: instruments to choose from.
        stations: possible stations by name.
        stations_known: names of the stations whose pose an evaluation may treat as exactly known.
        targets: reflectors by name.
        seconds: times of the operations.
        speeds: (axes,) travel speed, mm/s and degrees/s.
        ranges: (axes, 2) usable ranges, mm and degrees; one turn for an unlimited axis.
        opaque: whether the machine's shapes block the beam.

    Examples:
        >>> from dataclasses import replace
        >>> machine = twin.Machine.load("dmu50")
        >>> kit = twin.Kit.default(machine)
        >>> tuple(kit.stations), tuple(kit.targets)
        (('front', 'left', 'right', 'high'), ('T1', 'T2', 'T3', 'W1', 'W2', 'W3'))
        >>> left_only = replace(kit, stations={"left": kit.stations["left"]})
    """

    source: str
    instruments: tuple[Instrument, ...]
    stations: Mapping[str, Station]
    stations_known: frozenset[str]
    targets: Mapping[str, Target]
    seconds: Seconds
    speeds: np.ndarray
    ranges: np.ndarray
    opaque: bool

    @property
    def brief(self) -> str:
        """Origin, and names of instruments, stations and targets."""
        names = (
            listed([instrument.name for instrument in self.instruments]),
            listed(list(self.stations)),
            listed(list(self.targets)),
        )
        return f"{self.source}: {names[0]}; stations {names[1]}; targets {names[2]}"

    @property
    def known(self) -> frozenset[str]:
        """Names of the stations and targets that an evaluation treats as exactly known."""
        return self.stations_known | {name for name, target in self.targets.items() if target.known}

    @property
    def coordinates_per_reading(self) -> int:
        """Number of coordinates per reading, for the instrument that reads fewest."""
        return min(int(np.isfinite(instrument.read(np.ones((1, 3)))).sum()) for instrument in self.instruments)

    @property
    def setting(self) -> Placement:
        """Stations and target positions for a simulation."""
        return Placement(self.stations, {name: target.place_mm for name, target in self.targets.items()})

    def without_targets(self) -> Kit:
        """Return the kit without reflectors."""
        return replace(self, targets=MappingProxyType({}))

    @classmethod
    def load(cls, path: str | Path, machine: Machine) -> Kit:  # noqa: C901
        """Read a kit file (``schema: twin.kit/1``).

        Raises:
            InputError: the file does not fit the schema or the machine; with file, line and value.
        """
        file = Path(path)
        entries, lines = load_yaml(file, _KitFile, SCHEMA)

        def fail(place: EntryPath, what: str, expected: str, value: object, known: Iterable[str] = ()) -> InputError:
            meant = closest_name(str(value), known)
            return InputError(what, expected=expected, file=file, line=lines.get(place), value=value, nearest=meant)

        # Checks beyond the schema.
        by_name = {instrument.name: instrument for instrument in INSTRUMENTS}
        for i, name in enumerate(entries.instruments):
            if name not in by_name:
                raise fail(("instruments", i), "no such instrument", f"one of {', '.join(by_name)}", name, by_name)
        for key, named in (("speeds", entries.speeds), ("ranges", entries.ranges)):
            for name in named:
                if name not in machine.by_name:
                    known = machine.names
                    raise fail((key, name), "no such axis", f"one of {', '.join(known)}", name, known)
        ranges = full_ranges(machine)
        for name, (lower, upper) in entries.ranges.items():
            i = machine.names.index(name)
            if not ranges[i, 0] <= lower < upper <= ranges[i, 1]:
                expected = f"lower, upper within {ranges[i, 0]:g} … {ranges[i, 1]:g}"
                raise fail(("ranges", name), "the range is not within that of the machine", expected, [lower, upper])
            ranges[i] = lower, upper
        for name, entry in entries.targets.items():
            if entry.facing != "aimed" and np.linalg.norm(entry.facing) == 0.0:
                place = ("targets", name, "facing")
                raise fail(place, "facing is a zero vector", "aimed, or x, y, z on its carrier", entry.facing)
        middle = _middle(machine)
        return cls(
            source=entries.source or str(file),
            instruments=tuple(by_name[name] for name in entries.instruments),
            stations=MappingProxyType({name: one.station(middle) for name, one in entries.stations.items()}),
            stations_known=frozenset(name for name, one in entries.stations.items() if one.known),
            targets=MappingProxyType({name: one.target() for name, one in entries.targets.items()}),
            seconds=entries.seconds,
            speeds=np.array([entries.speeds.get(axis.name, _speed(axis.linear)) for axis in machine.axes]),
            ranges=ranges,
            opaque=entries.stops_the_beam == "machine",
        )

    @classmethod
    def default(cls, machine: Machine) -> Kit:
        """Return the default kit, used if no kit file is given.

        A laser tracker that may stand in front, on either side or high up; three reflectors below the spindle nose and three above
        the table.
        """
        middle = _middle(machine)
        corners = {
            "front": (0.0, -1.0, 0.1),
            "left": (-1.0, -0.35, 0.25),
            "right": (1.0, -0.35, 0.25),
            "high": (0.3, -0.8, 0.9),
        }
        stations = {}
        for name, way in corners.items():
            direction = np.array(way) / np.linalg.norm(way)
            stations[name] = station_facing(three_floats(np.round(middle + DISTANCE_MM * direction, -1)), middle)
        reflectors = {}
        for k in range(3):
            angle = np.radians(30.0 + 120.0 * k)
            across = np.array([np.cos(angle), np.sin(angle)])
            for letter, radius, height in (("T", 110.0, -40.0 - 35.0 * k), ("W", 170.0, 30.0 + 30.0 * k)):
                place = three_floats(np.round([*(radius * across), height]) + 0.0)
                carrier: Literal["tool", "work"] = "tool" if letter == "T" else "work"
                reflectors[f"{letter}{k + 1}"] = Target(carrier, place, False, None, ACCEPTANCE_DEG * DEG)
        return cls(
            source="assumed by twin: describe your equipment in a kit file",
            instruments=(INSTRUMENTS[0],),
            stations=MappingProxyType(stations),
            stations_known=frozenset(),
            targets=MappingProxyType(dict(sorted(reflectors.items()))),
            seconds=Seconds(),
            speeds=np.array([_speed(axis.linear) for axis in machine.axes]),
            ranges=full_ranges(machine),
            opaque=True,
        )


def bundled_kit(name: str | Path) -> Path:
    """Return the path of a kit file, by its path or by the bare name of one that comes with `twin`; `InputError` lists those."""
    return find_bundled(name, ".kit.yaml", "a kit file (schema twin.kit/1)")


def full_ranges(machine: Machine) -> np.ndarray:
    """Return the full ranges (axes, 2) in mm and degrees; one turn for an unlimited axis."""
    return np.array([axis.domain for axis in machine.axes])


def station_facing(origin_mm: tuple[float, float, float], point_mm: np.ndarray) -> Station:
    """Return an upright station at a position, its x axis towards a point."""
    away = point_mm - np.array(origin_mm)
    return Station(origin_mm, (0.0, 0.0, float(np.radians(np.round(np.degrees(np.arctan2(away[1], away[0])))))))


def _middle(machine: Machine) -> np.ndarray:
    """Return the mean position (3,) of tool and work over the volume, base frame, mm."""
    poses = volume(machine, 50)
    data = machine.model.createData()
    items: list[Any] = []
    for q in poses * machine.scale:
        pin.framesForwardKinematics(machine.model, data, machine.configuration(q))
        items += [data.oMf[machine.tool_frame].translation * 1e3, data.oMf[machine.work_frame].translation * 1e3]
    return np.asarray(np.mean(items, axis=0))


def _speed(linear: bool) -> float:
    return TRAVEL_MM_S if linear else TRAVEL_DEG_S


# --- Linear model of planned readings: their derivatives with respect to every unknown, and the prior

FALL: Final = 0.7
"""Ratio of prior variances of successive orthonormal functions of a curve: decreases more slowly than for a smooth curve."""
MOST_FUNCTIONS: Final = 13
"""Most functions of a curve, as in `identify`."""
EXPECTED_UM: Final = 5.0
"""RMS of a curve, µm or µrad, if no calibration has it: typical of a machine in good order."""
EXPECTED_FUNCTIONS: Final = 4
ROUNDING: Final = 1e-6
"""Share of a curve below which one of its coefficients is due to rounding."""
LEAST_UM: Final = 0.5
"""Smallest prior size of a curve, µm or µrad: errors a calibration leaves out are not zero."""


MOST_NAMED: Final = 5
"""Most unknowns named in a reason."""


@final
@dataclass(frozen=True)
class PlanModel:
    """Unknowns of a planned measurement and their prior."""

    machine: Machine
    plan: Measurements  # the readings
    instrument: Instrument
    unknowns: Unknowns  # unknowns of the machine
    setting: Placement  # setting, setup: stations and targets as planned
    setup: StationsAndTargets
    plausible: np.ndarray  # (p,) plausible size of every unknown; the coordinates used here are in these units
    free: np.ndarray  # (p, f) directions that the datum leaves free, in these units: the basis of the coordinates
    prior: np.ndarray  # (f, f) prior precision of the coordinates
    # (columns,) expected errors, µm and µrad, about which the model is linearised. An expected angle that is not zero makes target
    # positions on their carrier observable, which no reading determines exactly
    linearised_at: np.ndarray

    @classmethod
    def of(
        cls,
        machine: Machine,
        plan: Measurements,
        setting: Placement,
        instrument: Instrument,
        expected: Calibration,
        known: Collection[str] = (),
    ) -> PlanModel:
        """Return the model with the unknowns of axes, stations and targets, as in `identify`; axes at rest have none.

        A curve has no constant if the readings cannot separate it from a station or a location error. Curves that ``expected`` does not
        have get `EXPECTED_UM`; ``known``: names of the stations and targets that an evaluation treats as exactly known.
        """
        offsets: list[str] | None = None
        while True:
            model = cls._with_constants(machine, plan, setting, instrument, expected, known, offsets)
            unseen = (
                least_determined_offset(model.unknowns, model.determinability.remaining_variance)
                if model.unknowns.offsets
                else None
            )
            if unseen is None:
                return model
            offsets = [name for name in model.unknowns.offsets if name != unseen]

    @classmethod
    def _with_constants(
        cls,
        machine: Machine,
        plan: Measurements,
        setting: Placement,
        instrument: Instrument,
        expected: Calibration,
        known: Collection[str],
        offsets: list[str] | None,
    ) -> PlanModel:
        """Return the model with a constant in the curves named in ``offsets`` (`Unknowns`); None: in all that can have one."""
        turning = {split_name(c.name)[2] for c in expected.curves.values() if c.family.periodic}
        bases: dict[str, Basis] = {
            axis.name: bases_for(rotary=not axis.linear, endless=axis.lower is None or axis.name in turning)[0]
            for axis in machine.axes
        }
        spaces, constants = spaces_for(
            machine, plan.positions, bases=bases, most=MOST_FUNCTIONS, wanted=lambda name: True
        )
        evaluated = as_evaluated(plan, known)
        unknowns = Unknowns(
            machine,
            spaces,
            constants,
            axes_with_known_places(machine, evaluated),
            None if offsets is None else sorted(offsets),
        )
        setup = setup_of(evaluated, setting, instrument)
        plausible = np.concatenate([unknowns.plausible, setup.plausible])
        free = free_directions(unknowns.datum, len(unknowns), len(setup))
        precision = np.ones(len(plausible))
        linearised_at = np.zeros(len(unknowns))
        for space in spaces:
            columns = unknowns.of(space.name)
            precision[columns] = unknowns.plausible[columns] ** 2 / _sizes(space, expected) ** 2
            if space.name in expected.curves:
                linearised_at[columns] = _parts(space, expected.curves[space.name])
        for name, value in (*expected.squareness.items(), *expected.location.items()):
            linearised_at[unknowns.of(name)] = value
        prior = free.T @ (precision[:, None] * free)
        return cls(machine, plan, instrument, unknowns, setting, setup, plausible, free, prior, linearised_at)

    @cached_property
    def rows(self) -> np.ndarray:
        """Derivatives (n, 3, f) of the whitened readings with respect to the coordinates; zero for coordinates not measured."""
        readings, _ = simulate(
            self.plan,
            self.machine,
            Calibration.zero(self.machine),
            self.instrument,
            np.random.default_rng(0),
            setting=self.setting,
            noise=False,
        )
        network = Network(
            self.machine, readings, StationInstruments.same(self.instrument, readings.station), self.unknowns
        )
        rows = np.empty((len(readings), 3, self.free.shape[1]))
        for start in range(0, len(readings), CHUNK):
            piece = network.chunk(self.linearised_at, self.setup, np.arange(start, min(start + CHUNK, len(readings))))
            rows[piece.rows] = (piece.jacobian * self.plausible) @ self.free
        return rows

    def to_parameters(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the machine's unknowns (columns, …) in µm and µrad for coordinates (f, …)."""
        return np.asarray(self.plausible[: len(self.unknowns), None] * (self.free[: len(self.unknowns)] @ coordinates))

    def at_tool(self, positions: np.ndarray, tool_length_mm: float, without: Collection[str] = ()) -> np.ndarray:
        """Return the derivatives (n, 3, f), µm, of the tool point in the work frame by the coordinates, without some errors."""
        kinematics = Kinematics(self.machine, Calibration.zero(self.machine), tool_length_mm=tool_length_mm)
        by_error = kinematics.sensitivities(positions).error[:, :3]
        shapes = self.unknowns.shapes(np.asarray(positions))
        own = np.zeros((len(positions), 3, len(self.unknowns)))
        for k, parts in enumerate(shapes):
            if self.unknowns.columns[k].entity in without:
                continue
            for at, values in parts:
                own[:, :, k] += by_error[:, :, at] * values[:, None] * 1e6
        return np.asarray((own * self.plausible[: len(self.unknowns)]) @ self.free[: len(self.unknowns)])

    def tool_length(self, given_mm: float | None) -> float:
        """Return the tool length as given, else of the machine file, else 100 mm: at the spindle nose tilts would have no effect."""
        return given_mm if given_mm is not None else self.machine.tool_length_mm or 100.0

    @cached_property
    def determinability(self) -> Determinability:
        """Determinability of every unknown from the readings, relative to its plausible size."""
        flat = self.rows.reshape(-1, self.rows.shape[-1])
        triangle = np.linalg.qr(flat, mode="r") if len(flat) > flat.shape[1] else flat
        # Derivatives with respect to the coordinates, transformed back to the unknowns; zero outside the free directions.
        return determinability(
            triangle @ self.free.T / self.plausible,
            all_unknowns(self.unknowns, self.setup),
            free=self.free,
            measurements=int(np.count_nonzero(np.any(flat != 0.0, axis=1))),
        )

    @cached_property
    def hidden(self) -> tuple[Unidentified, ...]:
        """Errors of which not even the lowest order is determined; `identify` would leave them out."""
        unseen = dict(zip(self.determinability.names, self.determinability.remaining_variance, strict=True))
        # The machine's own unknowns come first.
        names = dict(zip(self.unknowns.columns, self.determinability.names, strict=False))
        hidden = []
        for name in self.unknowns.entities:
            space = self.curves.get(name)
            columns = [column for column in self.unknowns.columns if column.entity == name]
            lowest = [names[column] for column in (columns if space is None else columns[: len(space.groups()[0])])]
            worst = max(lowest, key=lambda one: unseen[one])
            if unseen[worst] > NOT_DETERMINED:
                direction = self.determinability.null_direction_of(worst)
                hidden.append(
                    inseparable(
                        name, self.machine, self.plan, self.setup, direction and direction.shortened(MOST_NAMED)
                    )
                )
        return tuple(hidden)

    @cached_property
    def curves(self) -> dict[str, CurveSpace]:
        """Curve spaces of the error motions by name."""
        return {space.name: space for space in self.unknowns.curves}


def _sizes(space: CurveSpace, expected: Calibration) -> np.ndarray:
    """Return the prior size (count − first,) of each orthonormal function of a curve, µm or µrad.

    As in an estimate (`twin.identification.fitting`): functions that the expected curve has are unconstrained; the variance of those
    beyond decreases by `FALL` per function, from the size that the expected ones have together.
    """
    count = space.count - space.first
    fall = FALL ** np.arange(count)
    curve = expected.curves.get(space.name)
    if curve is None:
        own = np.where(np.arange(count) < EXPECTED_FUNCTIONS, EXPECTED_UM / np.sqrt(EXPECTED_FUNCTIONS), 0.0)
    else:
        own = _parts(space, curve)
    held = np.flatnonzero(np.abs(own) > ROUNDING * max(np.abs(own).max(initial=0.0), LEAST_UM))
    has = int(held[-1]) + 1 if len(held) else 0
    # Functions that the estimate did not resolve were left out of the expected curve and give no information on the size.
    size = max(float(np.sum(own[:has] ** 2 / fall[:has])) / max(has - 1, 1), LEAST_UM**2)
    open_ = np.arange(count) < has
    return np.asarray(np.where(open_, expected.machine.plausible(space.name), np.sqrt(size * fall)))


def _parts(space: CurveSpace, curve: Curve) -> np.ndarray:
    """Return the coefficients (count − first,) of a curve in a space's orthonormal functions, without those fixed by the datum."""
    q, w = space.grid()
    return np.asarray(((w * curve(q)) @ space.functions(q))[space.first :])


def as_evaluated(plan: Measurements, known: Collection[str]) -> Measurements:
    """Return the plan as an evaluation will see it: poses and positions only where they are exactly known."""
    station = np.array([name in known for name in plan.station])[:, None]
    target = np.array([name in known for name in plan.target])[:, None]
    return replace(
        plan,
        station_pose=read_only(np.where(station, plan.station_pose, np.nan)),
        place_mm=read_only(np.where(target, plan.place_mm, np.nan)),
    )


def setup_of(plan: Measurements, setting: Placement, instrument: Instrument) -> StationsAndTargets:
    """Return the set-up at the planned poses and positions; known are only those the plan gives to an evaluation."""
    known = StationsAndTargets.from_table(plan, StationInstruments.same(instrument, plan.station))
    return replace(
        known,
        rotation=rotation_exp(np.array([setting.stations[name].rotation_rad for name in known.stations])),
        origin=np.array([setting.stations[name].origin_mm for name in known.stations]) * MM,
        place=np.array([setting.places_mm[name] for name in known.targets]) * MM,
    )
