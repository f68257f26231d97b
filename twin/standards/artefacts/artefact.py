"""Base class of artefacts and simple instruments, and the linear errors of a machine that they show."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import ClassVar, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis, Machine
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve
from twin.standards.artefacts.adjustment import Observed
from twin.standards.artefacts.sheet import ArtefactSheet, SheetQuantity, SheetRow
from twin.tool.forward import Kinematics

PROBE: Final = 1e-3
"""Error with which derivatives are taken; the model is linear in these errors, apart from rounding."""
INSIDE: Final = 0.1
"""Share of a range that a plan leaves free at each end."""
NEAR: Final = 0.03
"""Largest relative difference of a length from its nominal value: more is a mistake, not an error of a machine."""
EXPANSION: Final = SheetQuantity(
    "expansion", "µm/(m·K)", 11.5, 1.0, "thermal expansion of the artefact; iron alloys 11.5, granite 6, aluminium 23"
)
TEMPERATURE: Final = SheetQuantity(
    "temperature", "°C", 20.0, 3.0, "temperature of the artefact or instrument, and how well it is known"
)
RESOLUTION: Final = SheetQuantity("resolution", "mm", 0.01, None, "smallest step that can be read")
REPEAT: Final = SheetQuantity(
    "repeatability", "mm", 0.01, None, "standard deviation of one reading; used only if nothing is read twice"
)
MACHINE: Final = SheetQuantity(
    "machine deviation",
    "mm",
    0.02,
    None,
    "limit of the machine's own deviation at one position: backlash, steps, straightness",
)


@final
@dataclass(frozen=True, eq=False)
class LinearModel:
    """Displacement of the tool relative to the workpiece with scale and squareness errors.

    A command changed by d (n,) moves the tool by (D + Σ θ_k D_k) d mm.

    Attributes:
        axes: names of the n linear axes.
        names: names of the errors θ: ``scale X`` … and the squareness errors.
        nominal: D (3, n).
        derivatives: D_k (p, 3, n).
        origin: (n,) commands to which positions are referred.
    """

    axes: tuple[str, ...]
    names: tuple[str, ...]
    nominal: np.ndarray
    derivatives: np.ndarray
    origin: np.ndarray

    def at(self, errors: np.ndarray) -> np.ndarray:
        """Return the matrix (3, n) with given errors (p,)."""
        return np.asarray(self.nominal + np.tensordot(errors, self.derivatives, 1))

    def index(self, name: str) -> int:
        """Return the place of an axis."""
        return self.axes.index(name)

    def position(self, row: SheetRow, prefix: str = "") -> np.ndarray:
        """Return the commands (n,) of a row's columns, referred to the origin."""
        return np.array([row.number(f"{prefix}{name}_mm") for name in self.axes]) - self.origin


@lru_cache(maxsize=16)
def linear_model(machine: Machine) -> LinearModel:
    """Return the linear errors of a machine, from its kinematics; `InputError` without two linear axes."""
    linear = list(machine.linear)
    if len(linear) < 2:
        what = f"{machine.name} has fewer than two linear axes"
        raise InputError(what, expected="two or three linear axes", file=machine.path, value=len(linear))
    middle = np.array([0.5 * sum(axis.domain) if axis.linear else np.clip(0.0, *axis.domain) for axis in machine.axes])

    def matrix(errors: Calibration) -> np.ndarray:
        steps = np.tile(middle, (len(linear) + 1, 1))
        for row, i in enumerate(linear, start=1):
            low, high = machine.axes[i].domain
            steps[row, i] += 0.25 * (high - low)
        points = Kinematics(machine, errors, tool_length_mm=0.0).forward(steps).point_mm
        return np.array(
            [
                (point - points[0]) / (steps[row, i] - middle[i])
                for row, (i, point) in enumerate(zip(linear, points[1:], strict=True), start=1)
            ]
        ).T

    zero = Calibration.zero(machine)
    nominal = matrix(zero)
    names, found = [], []
    for i in linear:
        axis = machine.axes[i]
        curve = scale_curve(axis, PROBE)
        names.append(f"scale {axis.name}")
        found.append(matrix(replace(zero, curves=MappingProxyType({curve.name: curve}))))
    for name in machine.squareness_names:
        names.append(name)
        found.append(matrix(replace(zero, squareness=MappingProxyType({name: PROBE * 1e6}))))
    derivatives = (np.array(found) - nominal) / PROBE
    axes = tuple(machine.axes[i].name for i in linear)
    return LinearModel(axes, tuple(names), read_only(nominal), read_only(derivatives), read_only(middle[linear]))


def scale_curve(axis: Axis, scale: float, variance: float | None = None) -> Curve:
    """Return the positioning error of a scale error, zero at the axis's zero; ``variance`` of the scale, if known."""
    low, high = axis.domain
    along = int(np.argmax(np.abs(axis.direction)))
    name = f"E_{DIRECTIONS[along]}{axis.name}"
    # An axis that carries the workpiece moves it against its positive direction, so that its error counts along the other one.
    shape = np.array([0.5 * (low + high), 0.5 * (high - low)]) * 1e3 * np.sign(axis.direction[along])
    covariance = None if variance is None else read_only(variance * np.outer(shape, shape))
    values = (float(shape[0] * scale), float(shape[1] * scale))
    return Curve(name, "um", axis.domain, "power", values, covariance)


class ArtefactKind(ABC):
    """One artefact or simple instrument.

    Attributes:
        name: name in options and sheets.
        title: name in reports.
        shows: what it determines, for the manual.
        quantities: statements that its budget needs.
        columns: columns of its sheet before the positions of the axes.
        prefixes: prefixes of the columns of positions: one for every position of a row.
        repeats: readings for which the sheet has columns.
    """

    name: ClassVar[str]
    title: ClassVar[Message]
    shows: ClassVar[Message]
    quantities: ClassVar[tuple[SheetQuantity, ...]]
    columns: ClassVar[tuple[str, ...]]
    prefixes: ClassVar[tuple[str, ...]] = ("",)
    repeats: ClassVar[int] = 3

    @abstractmethod
    def steps(self, plane: str) -> tuple[Message, ...]:
        """Return what to do, one sentence each."""

    @abstractmethod
    def rows(self, machine: Machine, plane: str, size_mm: tuple[float, ...]) -> list[dict[str, str]]:
        """Return the rows of an empty sheet; `InputError` if the size does not fit the ranges."""

    @abstractmethod
    def observed(self, sheet: ArtefactSheet, machine: Machine) -> Observed | None:
        """Return the equations of the readings; None if they show neither scale nor squareness. `InputError` as `read_sheet`."""

    def statements(self, size_mm: tuple[float, ...]) -> list[str]:
        """Return the comment lines of the statements; ``size_mm``: as given to the plan."""
        return [line for own in self.quantities for line in (f"#   {own.meaning}", own.text())]

    def all_columns(self, axes: Sequence[str]) -> tuple[str, ...]:
        """Return all columns of its sheet but the readings."""
        return (*self.columns, *(f"{prefix}{name}_mm" for prefix in self.prefixes for name in axes))


def plane_axes(plane: str, model: LinearModel) -> tuple[int, int]:
    """Return the places of the two axes of a plane (``XY``); `InputError` for another one."""
    if len(plane) != 2 or plane[0] == plane[1] or not set(plane) <= set(model.axes):
        pairs = [f"{a}{b}" for i, a in enumerate(sorted(model.axes)) for b in sorted(model.axes)[i + 1 :]]
        raise InputError(
            "not a plane of this machine", expected=f"one of {' '.join(pairs)}", value=plane, setting="plane"
        )
    return model.index(plane[0]), model.index(plane[1])


def spans(machine: Machine, names: Sequence[str], size_mm: Sequence[float]) -> list[tuple[float, float]]:
    """Return a span in the middle of the range of each axis, of the given sizes, else 80 % of the range."""
    found = []
    for k, name in enumerate(names):
        low, high = machine.by_name[name].domain
        size = size_mm[k] if k < len(size_mm) else (1.0 - 2.0 * INSIDE) * (high - low)
        if not 0.0 < size <= high - low:
            what = f"the size does not fit the range of {name}"
            raise InputError(what, expected=f"above 0 and at most {high - low:g} mm", value=size, setting="size")
        middle = 0.5 * (low + high)
        found.append((middle - 0.5 * size, middle + 0.5 * size))
    return found


def capped(machine: Machine, names: Sequence[str], size_mm: Sequence[float], usual: Sequence[float]) -> list[float]:
    """Return the given sizes, else usual ones that fit 80 % of the ranges."""
    free = [high - low for low, high in spans(machine, names, ())]
    given = len(size_mm)
    return [*size_mm, *(min(own, room) for own, room in zip(usual[given:], free[given:], strict=False))]


def positions(machine: Machine, at: Mapping[str, float], prefix: str = "") -> dict[str, str]:
    """Return cells of positions: those given, the middle of the range for other linear axes."""
    cells = {}
    for i in machine.linear:
        axis = machine.axes[i]
        value = at.get(axis.name, 0.5 * sum(axis.domain))
        cells[f"{prefix}{axis.name}_mm"] = f"{round(value, 3) + 0.0:g}"
    return cells


def same(effect: float, count: int) -> np.ndarray:
    """Return effects (count, count) of independent quantities, one for every reading."""
    return np.asarray(effect * np.eye(count))
