"""In a notebook: calibrations and tables as pandas frames, errors over the volume as xarray data, plots to go on with, sliders.

pandas, xarray and ipywidgets are the extra `notebook`: `pip install 'twin[notebook]'`. Nothing else of twin needs them.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin._common.files import scratch_folder
from twin._common.units import TURN
from twin.display import readable
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import split_name
from twin.reporting.scene.draw import link_poses, machine_edges
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty

if TYPE_CHECKING:
    import ipywidgets
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes


def optional(package: str) -> Any:
    """Return a package of the extra ``notebook``; raise `InputError` if it is not installed."""
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise InputError(
            f"{package} is not installed", expected="the extra notebook: pip install 'twin[notebook]'"
        ) from None


# --- Calibrations and measurement tables as pandas frames, and back -------------------------------

COLUMNS: Final = ("error", "kind", "term", "value", "unit", "u")
_TEXT: Final = ("target", "carrier", "station", "station_carrier")
_COMMENTS: Final = "comments"


def to_frame(what: Calibration | Measurements, machine: Machine | None = None) -> pd.DataFrame:
    """Return a calibration or a measurement table as a pandas frame.

    Of a calibration: one row per number with the columns ``error`` (``E_XX``), ``kind`` (``curve``, ``squareness``, ``location``),
    ``term`` (index of a curve's coefficient, else 0), ``value``, ``unit`` and ``u``, the standard uncertainty (NaN if unknown). The
    covariance between rows, domains and bases of the curves, and effects that a diagnosis added are not in the frame;
    `calibration_from_frame` takes them from a calibration.

    Of a table: the columns of its CSV file; the file's comments are in ``attrs``.

    Args:
        what: calibration or table.
        machine: the table's machine; not needed for a calibration.

    Raises:
        InputError: pandas is not installed; a table without its machine.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> frame = twin.to_frame(twin.Calibration.default(machine))
        >>> frame.groupby("kind").size().to_dict()
        {'curve': 203, 'location': 8, 'squareness': 3}
        >>> twin.to_frame(twin.thesis_plan.plan(machine), machine).shape
        (840, 24)
    """
    pandas = optional("pandas")
    if isinstance(what, Calibration):
        frame = pandas.DataFrame(_rows(what), columns=list(COLUMNS))
        frame.attrs["source"] = what.source
        frame.attrs["warnings"] = [warning.title for warning in what.warnings]
        return frame
    if machine is None:
        raise InputError("a measurement table needs its machine", expected="to_frame(table, machine)")
    text = what.to_csv(machine)
    lines = text.splitlines()
    comments = [line for line in lines if line.startswith("#")]
    body = "\n".join(line for line in lines if not line.startswith("#"))
    frame = pandas.read_csv(io.StringIO(body), dtype=str, keep_default_na=False, na_values=[""])
    for name in frame.columns.difference(_TEXT, sort=False):
        frame[name] = _exact(frame[name])
    frame.attrs[_COMMENTS] = comments
    return frame


def _exact(texts: pd.Series[Any]) -> pd.Series[Any]:
    """Return a column as whole numbers, else as the doubles nearest to its texts, else, as the names of rounds, unchanged."""
    for number in (int, float):
        with contextlib.suppress(ValueError):
            return texts.map(number)
    return texts


def calibration_from_frame(frame: pd.DataFrame, calibration: Calibration) -> Calibration:
    """Return a calibration with the values of a frame; an unchanged frame gives the same calibration.

    The covariance, the domains and bases of the curves, effects and tables of the control are those of ``calibration``. Values of a
    unit other than that of the calibration are not converted.

    Args:
        frame: as `to_frame` returns it; rows in any order, every number of the calibration once.
        calibration: the calibration that the frame was made from, or one with the same numbers.

    Raises:
        InputError: a column or a row is missing, given twice, or unknown, or a value is not finite; the error names it.

    Examples:
        >>> calibration = twin.Calibration.default(twin.Machine.load("dmu50"))
        >>> frame = twin.to_frame(calibration)
        >>> frame.loc[frame.error == "E_C0Y", "value"] = 0.0
        >>> twin.calibration_from_frame(frame, calibration).squareness["E_C0Y"]
        0.0
    """
    missing = [name for name in ("error", "term", "value") if name not in frame.columns]
    if missing:
        raise InputError("missing column", expected=", ".join(COLUMNS), value=missing[0])
    values: dict[tuple[str, int], float] = {}
    for error, term, value in zip(frame["error"], frame["term"], frame["value"], strict=True):
        key = str(error), int(term)
        if key in values or not np.isfinite(value):
            what = "row given twice" if key in values else "value is not a number"
            raise InputError(what, expected="one finite value for each number", value=f"{key[0]}[{key[1]}] {value}")
        values[key] = float(value)
    known = {(row[0], row[2]) for row in _rows(calibration)}
    for wrong, what in ((known - set(values), "missing row"), (set(values) - known, "unknown row")):
        if wrong:
            name, term = min(wrong)
            raise InputError(what, expected="the rows of to_frame(calibration)", value=f"{name}[{term}]")
    curves = {
        name: replace(curve, coefficients=tuple(values[name, k] for k in range(len(curve.coefficients))))
        for name, curve in calibration.curves.items()
    }
    return replace(
        calibration,
        curves=MappingProxyType(curves),
        squareness=MappingProxyType({name: values[name, 0] for name in calibration.squareness}),
        location=MappingProxyType({name: values[name, 0] for name in calibration.location}),
    )


def measurements_from_frame(frame: pd.DataFrame, machine: Machine) -> Measurements:
    """Return a measurement table from a frame with the columns of its CSV file (`twin doc files`).

    Args:
        frame: the rows; comments in ``attrs``, as `to_frame` puts them there, say where the numbers come from (``simulated``).
        machine: the machine.

    Raises:
        InputError: as for `Measurements.load`; the line is that of the frame written as CSV.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan, truth = twin.thesis_plan.plan(machine), twin.Calibration.default(machine)
        >>> data, _ = twin.simulate(plan, machine, truth, twin.instruments.LaserTracker(), np.random.default_rng(1))
        >>> frame = twin.to_frame(data, machine)
        >>> len(twin.measurements_from_frame(frame[frame["target"] != "K"], machine))
        708
    """
    text = frame.to_csv(index=False, lineterminator="\n")
    comments = "".join(f"{line}\n" for line in frame.attrs.get(_COMMENTS, ()))
    with scratch_folder() as folder:
        path = folder / "frame.csv"
        path.write_text(comments + text, encoding="utf-8")
        try:
            return replace(Measurements.load(path, machine), source="frame")
        except InputError as error:
            raise InputError(
                error.what, expected=error.expected, file="frame", line=error.line, value=error.value
            ) from None


def _rows(calibration: Calibration) -> list[tuple[Any, ...]]:
    covariance = calibration.covariance
    variance = dict(zip(covariance.names, np.diagonal(covariance.matrix), strict=True))

    def u(*names: str) -> float:
        return next((float(np.sqrt(variance[name])) for name in names if name in variance), float("nan"))

    rows: list[tuple[Any, ...]] = []
    for name, curve in calibration.curves.items():
        for k, value in enumerate(curve.coefficients):
            rows.append((name, "curve", k, float(value), curve.unit, u(f"{name}[{k}]")))
    constants: tuple[tuple[str, Mapping[str, float]], ...] = (
        ("squareness", calibration.squareness),
        ("location", calibration.location),
    )
    for kind, found in constants:
        for name, value in found.items():
            unit = "urad" if kind == "squareness" or split_name(name)[0] >= 3 else "um"
            rows.append((name, kind, 0, float(value), unit, u(name)))
    return rows


# --- Errors at the tool over positions of the axes, as xarray data --------------------------------


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

    Examples:
        >>> kinematics = twin.Kinematics(twin.Machine.load("dmu50"), tool_length_mm=120)
        >>> field = twin.error_field(kinematics, {"X": [0, 250, 500], "Y": [0, 225, 450]}, {"Z": -200})
        >>> field.distance.round(1).values
        array([[167.3, 154.2, 122.5],
               [ 54.5,  72.2, 148.7],
               [ 71.3,  95.8,  62.6]])
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
    """Errors of the tool of a machine with its tool length and conditions, and their uncertainty."""

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


# --- Plots that return matplotlib axes, to go on with: a curve with its interval, a field, the machine in a position

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

    Examples:
        >>> calibration = twin.Calibration.default(twin.Machine.load("dmu50"))
        >>> axes = twin.plot_curve(calibration, "E_XX")
        >>> axes = twin.plot_curve(calibration, "E_YX", ax=axes, linestyle="--")
        >>> len(axes.lines)
        2
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

    Examples:
        >>> kinematics = twin.Kinematics(twin.Machine.load("dmu50"), tool_length_mm=120)
        >>> field = twin.error_field(kinematics, {"X": range(0, 501, 50), "Y": range(0, 451, 50)})
        >>> axes = twin.plot_field(field)
        >>> axes.get_xlabel(), axes.get_ylabel()
        ('X / mm', 'Y / mm')
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

    Examples:
        >>> kinematics = twin.Kinematics(twin.Machine.load("dmu50"), tool_length_mm=120)
        >>> axes = twin.plot_machine(kinematics, [100, 200, -150, 60, 20])
        >>> axes.figure.savefig("machine.png")
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


# --- A slider for each axis, with the machine in that position and the error at the tool there (ipywidgets)


def axis_sliders(kinematics: Kinematics) -> ipywidgets.Box:
    """Return sliders for the axes, with a drawing of the machine and the error at the tool in that position.

    The attribute ``sliders`` of the box holds them by axis name, ``error`` the text below the drawing.

    Args:
        kinematics: the machine with its errors and tool length.

    Raises:
        InputError: ipywidgets or matplotlib is not installed; the URDF has shapes that cannot be drawn.

    Examples:
        >>> kinematics = twin.Kinematics(twin.Machine.load("dmu50"), tool_length_mm=120)
        >>> box = twin.axis_sliders(kinematics)
        >>> list(box.sliders)
        ['X', 'Y', 'Z', 'B', 'C']
    """
    widgets = optional("ipywidgets")
    machine = kinematics.machine
    errors = ErrorsAtTool(kinematics)
    warnings = "; ".join(warning.title for warning in kinematics.calibration.warnings)
    sliders: dict[str, Any] = {}
    for axis, (low, high) in zip(machine.axes, machine.limits / machine.scale[:, None], strict=True):
        low, high = max(low, -TURN if not axis.linear else low), min(high, TURN if not axis.linear else high)
        middle = float(np.clip((low + high) / 2.0 if axis.linear else 0.0, low, high))
        unit = "mm" if axis.linear else "°"
        sliders[axis.name] = widgets.FloatSlider(
            value=middle,
            min=float(low),
            max=float(high),
            step=max(axis.increment, 1e-3),
            description=f"{axis.name} / {unit}",
            continuous_update=False,
            readout_format=".3f",
        )
    picture, text = widgets.Image(format="png"), widgets.HTML()

    def show(_: Any = None) -> None:
        position = np.array([sliders[name].value for name in machine.names])
        picture.value = _png(kinematics, position)
        text.value = _error(errors, position) + (f"<br>{warnings}" if warnings else "")

    for slider in sliders.values():
        slider.observe(show, names="value")
    show()
    box = widgets.VBox([widgets.HBox([widgets.VBox(list(sliders.values())), picture]), text])
    box.sliders, box.error = sliders, text
    return box


def _png(kinematics: Kinematics, position: np.ndarray) -> bytes:
    from twin.display.figures import new_figure

    figure = new_figure(4.6, 4.2)
    plot_machine(kinematics, position, ax=figure.subplots())
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=80)
    return stream.getvalue()


def _error(errors: ErrorsAtTool, position: np.ndarray) -> str:
    found = {name: float(value[0]) for name, (value, _, _) in errors.at(position[None]).items()}
    if np.isnan(found["distance"]):
        return "outside the domain of the error motions: no error is known here"
    known = f" ± {found['U']:.1f} (U, 95 %)" if "U" in found else " (U unknown)"
    return (
        f"<b>error of the tool point {found['distance']:.1f}{known} µm</b>: x {found['dx']:+.1f}, y {found['dy']:+.1f}, "
        f"z {found['dz']:+.1f} µm; tilt of the tool axis about x {found['tilt_a']:+.1f}, about y {found['tilt_b']:+.1f} µrad"
    )
