"""Plots that return matplotlib axes, to go on with: a curve with its interval, a field, the machine in a position."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin.display import readable
from twin.display.numbers import COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.notebook.optional import optional
from twin.reporting.scene.draw import link_poses, machine_edges

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

FINE: Final = 361
"""Number of points with which a curve is drawn."""
_VIEW: Final = np.array([[np.cos(np.pi / 6), -np.cos(np.pi / 6), 0.0], [0.5, 0.5, 1.0]])
"""Isometric projection of x, y, z: x to the right and up, y to the left and up."""
_WORK, _TOOL, _FIXED, _ERROR = "#0072b2", "#d55e00", "#8a8f98", "#b3131b"


def plot_curve(calibration: Calibration, name: str, *, ax: Axes | None = None, **line: Any) -> Axes:
    """Plot an error motion with its 95 % interval against the position of its axis, and return the axes.

    Args:
        calibration: the calibration.
        name: ISO 230-1 name of the curve.
        ax: axes to draw into; new ones if None.
        line: properties of the line, as for `Axes.plot`.

    Raises:
        InputError: matplotlib is not installed, or the calibration has no such curve.
    """
    if name not in calibration.curves:
        known = list(calibration.curves)
        nearest = closest_name(name, known)
        raise InputError("no such curve", expected=" ".join(known) or "curves", value=name, nearest=nearest)
    curve = calibration.curves[name]
    plot = new_axes() if ax is None else ax
    q = np.linspace(*curve.domain, FINE)
    values = curve(q)
    drawn = plot.plot(q, values, **{"label": name, **line})
    names = [f"{name}[{k}]" for k in range(len(curve.coefficients))]
    covariance = calibration.covariance
    if set(names) <= set(covariance.names):
        shapes = np.array([curve.family.value(q, curve.domain, tuple(row)) for row in np.eye(len(names))])
        u = np.sqrt(np.einsum("iq,ij,jq->q", shapes, covariance.of(names).matrix, shapes))
        low, high = values - COVERAGE_FACTOR * u, values + COVERAGE_FACTOR * u
        plot.fill_between(q, low, high, color=drawn[0].get_color(), alpha=0.2, linewidth=0.0)
    axis = next(axis for axis in calibration.machine.axes if axis.name == name[3:])
    plot.set_xlabel(f"{axis.name} / {'mm' if axis.linear else '°'}")
    plot.set_ylabel(f"{name if len(plot.lines) == 1 else 'error motion'} / {readable(curve.unit)}")
    plot.grid(color="#dddddd", linewidth=0.6)
    _mark(plot, [warning.title for warning in calibration.warnings])
    return plot


def plot_field(field: xr.Dataset, variable: str = "distance", *, ax: Axes | None = None, **drawing: Any) -> Axes:
    """Plot a variable of `twin.error_field` over one axis (a line) or two (a map with a colour bar), and return the axes.

    Args:
        field: the field.
        variable: its name.
        ax: axes to draw into; new ones if None.
        drawing: properties, as for `Axes.plot` or `Axes.pcolormesh`.

    Raises:
        InputError: matplotlib is not installed; no such variable; more than two axes: choose a position with ``field.sel``.
    """
    if variable not in field:
        known = [str(name) for name in field.data_vars]
        nearest = closest_name(variable, known)
        raise InputError("no such variable", expected=" ".join(known), value=variable, nearest=nearest)
    data = field[variable]
    dims = [str(name) for name in data.dims]
    if len(dims) not in (1, 2):
        raise InputError("a field over one or two axes can be plotted", expected="field.sel(Z=…)", value=" ".join(dims))
    plot = new_axes() if ax is None else ax
    label = f"{data.attrs['long_name']} / {readable(data.attrs['units'])}"
    if len(dims) == 1:
        plot.plot(data[dims[0]], data, **drawing)
        plot.set_ylabel(label)
        plot.grid(color="#dddddd", linewidth=0.6)
    else:
        # Smooth shading would show values between positions that were not evaluated.
        shown = plot.pcolormesh(
            data[dims[0]], data[dims[1]], data.T, **{"shading": "nearest", "cmap": "viridis", **drawing}
        )
        plot.figure.colorbar(shown, ax=plot, label=label)
        plot.set_ylabel(_axis_label(field, dims[1]))
    plot.set_xlabel(_axis_label(field, dims[0]))
    _mark(plot, field.attrs.get("warnings", "").split("; "))
    return plot


def plot_machine(kinematics: Kinematics, position: Sequence[float] | np.ndarray, *, ax: Axes | None = None) -> Axes:
    """Draw the edges of the machine's solids in one position, in an isometric view, and return the axes.

    Args:
        kinematics: the machine.
        position: (axes,) commands in mm and degrees.
        ax: axes to draw into; new ones if None.

    Raises:
        InputError: matplotlib is not installed, or the URDF has shapes that cannot be drawn.
    """
    from matplotlib.collections import LineCollection

    plot = new_axes() if ax is None else ax
    machine = kinematics.machine
    edges = machine_edges(kinematics)
    poses = link_poses(kinematics, np.asarray(position, dtype=float)[None], tuple(edges))[0]
    colours = _side_colours(kinematics, tuple(edges))
    for (link, points), pose in zip(edges.items(), poses, strict=True):
        placed = (points @ pose[:3, :3].T + pose[:3, 3]) @ _VIEW.T * 1e3
        plot.add_collection(LineCollection(placed.reshape(-1, 2, 2), colors=colours[link], linewidths=0.8))
    plot.autoscale_view()
    plot.set_aspect("equal")
    plot.set_axis_off()
    plot.set_title(machine.name, fontsize=10)
    return plot


def _side_colours(kinematics: Kinematics, links: tuple[str, ...]) -> dict[str, str]:
    """Return a colour for each link: those that move with the tool side, with the work side, and not at all."""
    machine = kinematics.machine
    rest = np.array([0.0 if not axis.linear else float(np.mean([axis.lower, axis.upper])) for axis in machine.axes])
    colours = dict.fromkeys(links, _FIXED)
    still = link_poses(kinematics, rest[None], links)[0]
    for i, axis in enumerate(machine.axes):
        moved = rest.copy()
        moved[i] += 1.0
        for link, before, after in zip(links, still, link_poses(kinematics, moved[None], links)[0], strict=True):
            if np.abs(after - before).max() > 1e-5:
                colours[link] = _WORK if axis.side == "work" else _TOOL
    return colours


def new_axes() -> Axes:
    """Return axes of a new figure, in pyplot's care where a notebook shows figures."""
    return optional("matplotlib.pyplot").subplots(figsize=(6.4, 4.4), layout="constrained")[1]


def _mark(plot: Axes, warnings: Sequence[str]) -> None:
    """Write the warnings on where the numbers are from into a corner of a plot, once."""
    from twin.display.figures import text_box_style

    text = "; ".join(filter(None, warnings))
    if text and text not in [one.get_text() for one in plot.texts]:
        box = text_box_style(0.85, 2.0)
        plot.text(0.01, 0.02, text, transform=plot.transAxes, fontsize=8, color=_ERROR, fontweight="bold", bbox=box)


def _axis_label(field: xr.Dataset, name: str) -> str:
    return f"{name} / {'°' if field[name].attrs['units'] == 'deg' else 'mm'}"
