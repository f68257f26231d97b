"""Errors at the tool over positions of the axes, as xarray data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.notebook.optional import optional
from twin.uncertainty.at_tool import ToolUncertainty

if TYPE_CHECKING:
    import xarray as xr


def error_field(
    kinematics: Kinematics, along: Mapping[str, Sequence[float] | np.ndarray], at: Mapping[str, float] | None = None
) -> xr.Dataset:
    """Return the errors of the tool over a grid of axis positions.

    Variables over the axes of ``along``: ``dx``, ``dy``, ``dz``: actual minus nominal tool point in µm, in the work frame;
    ``distance``: its length; ``tilt_a``, ``tilt_b``: tilt of the tool axis about x and y of the nominal tool frame in µrad; ``U``: the
    expanded uncertainty (95 %) of the point in µm, if any error has an uncertainty. Every variable and coordinate has the attribute
    ``units``. NaN where a curve of the calibration has no value.

    Args:
        kinematics: the machine with its errors, tool length and conditions.
        along: positions by axis name, mm or degrees.
        at: positions of other axes; the middle of the range of a linear axis and 0 for a rotary one if not given.

    Raises:
        InputError: xarray is not installed; an unknown axis, one given twice, or no axis.
    """
    xarray = optional("xarray")
    machine = kinematics.machine
    fixed = dict(at or {})
    for name in (*along, *fixed):
        if name not in machine.names:
            nearest = closest_name(name, machine.names)
            raise InputError("unknown axis", expected=" ".join(machine.names), value=name, nearest=nearest)
    twice = set(along) & set(fixed)
    if twice or not along:
        what = "axis given twice" if twice else "no axis"
        raise InputError(
            what, expected="each axis once, at least one of them with positions", value=min(twice, default=None)
        )
    grids = {name: np.asarray(values, dtype=float).reshape(-1) for name, values in along.items()}
    mesh = dict(zip(grids, np.meshgrid(*grids.values(), indexing="ij"), strict=True))
    shape = next(iter(mesh.values())).shape
    limits = machine.limits / machine.scale[:, None]
    columns = []
    for axis, (low, high) in zip(machine.axes, limits, strict=True):
        rest = float((low + high) / 2.0) if axis.linear else 0.0
        value = fixed.setdefault(axis.name, rest) if axis.name not in mesh else 0.0
        columns.append(mesh[axis.name].reshape(-1) if axis.name in mesh else np.full(int(np.prod(shape)), value))
    values = ErrorsAtTool(kinematics).at(np.column_stack(columns))
    unit = {axis.name: "mm" if axis.linear else "deg" for axis in machine.axes}
    data: dict[str, Any] = {
        name: (tuple(grids), column.reshape(shape), {"units": units, "long_name": words})
        for name, (column, units, words) in values.items()
    }
    coordinates: dict[str, Any] = {name: (name, grid, {"units": unit[name]}) for name, grid in grids.items()}
    coordinates |= {name: ((), value, {"units": unit[name]}) for name, value in fixed.items() if name not in grids}
    attributes = {
        "machine": machine.name,
        "source": kinematics.calibration.source,
        "tool_length_mm": kinematics.tool_length_mm,
    }
    warnings = [warning.title for warning in kinematics.calibration.warnings]
    return xarray.Dataset(data, coordinates, attributes | ({"warnings": "; ".join(warnings)} if warnings else {}))


@final
class ErrorsAtTool:
    """Errors of the tool of a machine, and their uncertainty.

    Args:
        kinematics: the machine with its errors, tool length and conditions.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        machine = kinematics.machine
        self._real = kinematics
        self._nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=kinematics.tool_length_mm)
        self._uncertainty = ToolUncertainty(kinematics)

    def at(self, positions: np.ndarray) -> dict[str, tuple[np.ndarray, str, str]]:
        """Return (n,) values, unit and description of every variable; NaN outside the domain of a curve."""
        known = ~self._real.outside_domain(positions).any(axis=1)
        reached, meant = self._real.forward(positions[known]), self._nominal.forward(positions[known])
        point = np.full((len(positions), 3), np.nan)
        tilt = np.full((len(positions), 2), np.nan)
        point[known] = (reached.point_mm - meant.point_mm) * 1e3
        tilt[known] = reached.tilt_urad(meant)
        found = {
            f"d{letter}": (point[:, i], "um", f"error of the tool point along {letter}")
            for i, letter in enumerate("xyz")
        }
        found["distance"] = (np.linalg.norm(point, axis=1), "um", "distance of the tool point from its nominal place")
        found["tilt_a"] = (tilt[:, 0], "urad", "tilt of the tool axis about x of the tool frame")
        found["tilt_b"] = (tilt[:, 1], "urad", "tilt of the tool axis about y of the tool frame")
        if self._uncertainty.parameters:
            expanded = np.full(len(positions), np.nan)
            expanded[known] = self._uncertainty.at(positions[known]).expanded_um
            found["U"] = (expanded, "um", "expanded uncertainty of the tool point (95 %)")
        return found
