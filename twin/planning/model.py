"""What each reading of a plan would tell, before it is taken: derivatives by every unknown, in one set of coordinates.

The unknowns are those of `identify`: every error motion as orthonormal functions of its axis, squareness, locations, stations,
targets. What is known beforehand is how large such things are: a curve's functions fall off as those of the calibration in hand do
(`twin.identification.priors`), constants, stations and targets are as far off as is plausible. Linear in the errors, about
those expected.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.units import MM
from twin.identification.network import PIECE, Network
from twin.identification.setup import SetUp
from twin.identification.solve import free_directions, named
from twin.identification.unknowns import Unknowns, axes_told, offset_unseen, spaces_for
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.machine.motion_curve import Curve
from twin.measurement.instruments import Instrument
from twin.measurement.simulate import Setting, simulate
from twin.measurement.table import Measurements
from twin.numerics.curves import Basis, CurveSpace, bases_for
from twin.numerics.observability import UNSEEN, Determinability, determinability
from twin.numerics.spatial import rotation_exp

FALL: Final = 0.7
"""Ratio of variances from one orthonormal function of a curve to the next: gentler than a smooth curve's."""
MOST: Final = 13
"""Functions of a curve, as of `identify`."""
EXPECTED_UM: Final = 5.0
"""RMS of a curve, µm or µrad, where no calibration says how large it is: that of a machine in order."""
EXPECTED_FUNCTIONS: Final = 4
ROUNDING: Final = 1e-6
"""Share of a curve below which a function of it is what numbers were rounded to."""
LEAST_UM: Final = 0.5
"""A calibration that takes a curve as smaller than that is not believed: what it left out is not zero."""


NAMED: Final = 5
"""Unknowns that a reason names."""
VAGUE: Final = "the readings say less of it than is plausible anyway"


@final
@dataclass(frozen=True)
class Hidden:
    """An error a plan cannot show.

    Attributes:
        name: ISO 230-1 name.
        reason: what moves with it and leaves every reading as it is.
    """

    name: str
    reason: str


@final
@dataclass(frozen=True)
class PlanModel:
    """The unknowns of a planned measurement, and what is known of them before it.

    Attributes:
        machine: the machine.
        plan: the readings.
        instrument: what reads them.
        unknowns: of the machine.
        setting, setup: stations and targets as planned.
        plausible: (p,) size of every unknown that stands for one in the coordinates used here.
        free: (p, f) the directions the datum leaves, in these units: the coordinates are along them.
        prior: (f, f) precision of the coordinates before any reading.
        about: (columns,) the expected errors, µm and µrad: derivatives are taken there. An angle that is not zero shows where on its
            carrier the targets sit, which no reading tells exactly.
    """

    machine: Machine
    plan: Measurements
    instrument: Instrument
    unknowns: Unknowns
    setting: Setting
    setup: SetUp
    plausible: np.ndarray
    free: np.ndarray
    prior: np.ndarray
    about: np.ndarray

    @classmethod
    def of(
        cls,
        machine: Machine,
        plan: Measurements,
        setting: Setting,
        instrument: Instrument,
        expected: Calibration,
        known: Collection[str] = (),
    ) -> PlanModel:
        """The unknowns of a plan's axes, stations and targets, as `identify` has them.

        A constant that the readings do not show is a station's or a location's: its curve has none.

        Args:
            machine: the machine.
            plan: every reading in question; axes it does not move have no unknowns.
            setting: where stations and targets are.
            instrument: what reads.
            expected: how large errors are; curves it does not have are taken as `EXPECTED_UM`.
            known: names of the stations and targets that an evaluation is told exactly.
        """
        offsets: list[str] | None = None
        while True:
            model = cls._with_constants(machine, plan, setting, instrument, expected, known, offsets)
            unseen = offset_unseen(model.unknowns, model.told.remaining_variance) if model.unknowns.offsets else None
            if unseen is None:
                return model
            offsets = [name for name in model.unknowns.offsets if name != unseen]

    @classmethod
    def _with_constants(
        cls,
        machine: Machine,
        plan: Measurements,
        setting: Setting,
        instrument: Instrument,
        expected: Calibration,
        known: Collection[str],
        offsets: list[str] | None,
    ) -> PlanModel:
        """The same with a constant in some of the curves that can have one (`Unknowns`); in all of them if None."""
        turning = {split_name(c.name)[2] for c in expected.curves.values() if c.family.periodic}
        bases: dict[str, Basis] = {
            axis.name: bases_for(rotary=not axis.linear, endless=axis.lower is None or axis.name in turning)[0]
            for axis in machine.axes
        }
        spaces, constants = spaces_for(machine, plan.positions, bases=bases, most=MOST, wanted=lambda name: True)
        told = as_told(plan, known)
        unknowns = Unknowns(
            machine, spaces, constants, axes_told(machine, told), None if offsets is None else sorted(offsets)
        )
        setup = setup_of(told, setting, instrument)
        plausible = np.concatenate([unknowns.plausible, setup.plausible])
        free = free_directions(unknowns.datum, len(unknowns), len(setup))
        precision = np.ones(len(plausible))
        about = np.zeros(len(unknowns))
        for space in spaces:
            columns = unknowns.of(space.name)
            precision[columns] = unknowns.plausible[columns] ** 2 / _sizes(space, expected) ** 2
            if space.name in expected.curves:
                about[columns] = _parts(space, expected.curves[space.name])
        for name, value in (*expected.squareness.items(), *expected.location.items()):
            about[unknowns.of(name)] = value
        prior = free.T @ (precision[:, None] * free)
        return cls(machine, plan, instrument, unknowns, setting, setup, plausible, free, prior, about)

    @cached_property
    def rows(self) -> np.ndarray:
        """(n, 3, f) derivatives of the whitened readings by the coordinates; zero where nothing is read."""
        readings, _ = simulate(
            self.plan,
            self.machine,
            Calibration.zero(self.machine),
            self.instrument,
            np.random.default_rng(0),
            setting=self.setting,
            noise=False,
        )
        network = Network(self.machine, readings, self.instrument, self.unknowns)
        found = np.empty((len(readings), 3, self.free.shape[1]))
        for start in range(0, len(readings), PIECE):
            piece = network.piece(self.about, self.setup, np.arange(start, min(start + PIECE, len(readings))))
            found[piece.rows] = (piece.jacobian * self.plausible) @ self.free
        return found

    def to_parameters(self, coordinates: np.ndarray) -> np.ndarray:
        """(columns, …) the machine's unknowns, µm and µrad, of (f, …) coordinates."""
        return np.asarray(self.plausible[: len(self.unknowns), None] * (self.free[: len(self.unknowns)] @ coordinates))

    def at_tool(self, positions: np.ndarray, tool_length_mm: float, without: Collection[str] = ()) -> np.ndarray:
        """(n, 3, f) derivatives of the tool point in the work frame, µm, by the coordinates; errors ``without`` count for nothing."""
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
        """As given, else the machine file's, else 100 mm: at the nose itself a turn about it would look harmless."""
        return given_mm if given_mm is not None else self.machine.tool_length_mm or 100.0

    @cached_property
    def told(self) -> Determinability:
        """What the readings determine, unknown by unknown, with nothing known beforehand but what is plausible."""
        flat = self.rows.reshape(-1, self.rows.shape[-1])
        triangle = np.linalg.qr(flat, mode="r") if len(flat) > flat.shape[1] else flat
        # The coordinates' own derivatives, carried back to the unknowns: outside the datum's directions there is nothing to carry.
        return determinability(
            triangle @ self.free.T / self.plausible,
            named(self.unknowns, self.setup),
            free=self.free,
            measurements=int(np.count_nonzero(np.any(flat != 0.0, axis=1))),
        )

    @cached_property
    def hidden(self) -> tuple[Hidden, ...]:
        """The errors of which not even the lowest order is determined, as `identify` would leave them out."""
        unseen = dict(zip(self.told.names, self.told.remaining_variance, strict=True))
        # The machine's own unknowns come first.
        names = dict(zip(self.unknowns.columns, self.told.names, strict=False))
        found = []
        for name in self.unknowns.entities:
            space = self.curves.get(name)
            columns = [column for column in self.unknowns.columns if column.entity == name]
            lowest = [names[column] for column in (columns if space is None else columns[: len(space.groups()[0])])]
            worst = max(lowest, key=lambda one: unseen[one])
            if unseen[worst] > UNSEEN:
                direction = self.told.null_direction_of(worst)
                found.append(Hidden(name, VAGUE if direction is None else str(direction.shortened(NAMED))))
        return tuple(found)

    @cached_property
    def curves(self) -> dict[str, CurveSpace]:
        """The spaces of the error motions by name."""
        return {space.name: space for space in self.unknowns.curves}


def _sizes(space: CurveSpace, expected: Calibration) -> np.ndarray:
    """(count − first,) how large each orthonormal function of a curve may be, µm or µrad.

    As an estimate will have it (`twin.identification.priors`): nothing holds the functions the expected curve has; those beyond
    fall by `FALL` a function, from the size that those it has show together.
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
    # What an estimate does not resolve says nothing of the size either, and the expected curve left it out.
    size = max(float(np.sum(own[:has] ** 2 / fall[:has])) / max(has - 1, 1), LEAST_UM**2)
    open_ = np.arange(count) < has
    return np.asarray(np.where(open_, expected.machine.plausible(space.name), np.sqrt(size * fall)))


def _parts(space: CurveSpace, curve: Curve) -> np.ndarray:
    """(count − first,) a curve in a space's orthonormal functions, those the datum leaves."""
    q, w = space.grid()
    return np.asarray(((w * curve(q)) @ space.functions(q))[space.first :])


def as_told(plan: Measurements, known: Collection[str]) -> Measurements:
    """The plan as an evaluation will have it: poses and places only where they are known."""
    station = np.array([name in known for name in plan.station])[:, None]
    target = np.array([name in known for name in plan.target])[:, None]
    return replace(
        plan,
        station_pose=locked(np.where(station, plan.station_pose, np.nan)),
        place_mm=locked(np.where(target, plan.place_mm, np.nan)),
    )


def setup_of(plan: Measurements, setting: Setting, instrument: Instrument) -> SetUp:
    """Where stations and targets are, and which of it the plan tells an evaluation."""
    told = SetUp.told(plan, lengths_only=instrument.lengths_only)
    return replace(
        told,
        rotation=rotation_exp(np.array([setting.stations[name].turn_rad for name in told.stations])),
        origin=np.array([setting.stations[name].origin_mm for name in told.stations]) * MM,
        place=np.array([setting.places_mm[name] for name in told.targets]) * MM,
    )
