"""Common style of matplotlib pictures: palette, axes, polar plots, headings; saving and embedding. Needs the extra ``plots``.

Every drawing function returns a new `Figure` without a screen or shared state. Colour-blind readers can distinguish the colours; line
styles and markers also distinguish curves without colour. Axes of small pictures are drawn as a few artists that look like matplotlib's
own, which makes five for each tick and places each several times: more than half of the time of a small picture.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, cast, final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis, YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT, TICKRIGHT
from matplotlib.projections.polar import PolarAxes, RadialAxis, ThetaAxis
from matplotlib.text import Text
from matplotlib.textpath import text_to_path
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, ScalarFormatter
from matplotlib.transforms import ScaledTranslation, Transform

from twin._common.messages import Number, say
from twin.display.markup import Html, part
from twin.display.numbers import signed

GRID: Final[dict[str, Any]] = {"color": "#dddddd", "linewidth": 0.6}
"""Looks of a grid behind the data."""
FORWARD: Final = "#0072b2"
BACKWARD: Final = "#d55e00"
BOTH: Final = "#222222"
THIRD: Final = "#009e73"
RUN: Final = "#8a8a8a"
SHADE: Final = 0.22
"""Opacity of a 95 % band."""
HOLLOW: Final = 2.0
"""Radius of the zero circle of a polar plot, in units of the largest deviation."""
HEADROOM: Final = 1.15
DEG: Final = np.pi / 180.0


def new_figure(width: float, height: float, layout: str | None = "constrained") -> Figure:
    """Return an empty figure of a size in inches; ``layout``: matplotlib's layout engine, None if the axes are placed explicitly."""
    figure = Figure(figsize=(width, height), layout=layout)  # type: ignore[arg-type]
    FigureCanvasAgg(figure)
    return figure


@final
class _TranslatedFormatter(ScalarFormatter):
    """Labels of ticks with the decimal mark of the language."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return say(Number(super().__call__(x, pos)))


def style_axes(plot: Axes) -> None:
    """Add a pale grid behind the data and hide the top and right spines."""
    plot.grid(**GRID)
    for axis in (plot.xaxis, plot.yaxis):
        axis.set_major_formatter(_TranslatedFormatter())
    plot.set_axisbelow(True)
    plot.spines[["top", "right"]].set_visible(False)


def plot_markers(plot: Axes, x: Any, y: Any, colour: str, marker: str = "o", size: float = 4.0, **more: Any) -> None:
    """Draw markers without a line; ``more`` as for `Axes.plot`."""
    plot.plot(x, y, color=colour, marker=marker, markersize=size, linestyle="", **more)


def text_box_style(alpha: float, pad: float) -> dict[str, Any]:
    """Return the properties of the white box behind a text in a picture."""
    return {"facecolor": "white", "edgecolor": "none", "alpha": alpha, "pad": pad}


def heading(figure: Figure, text: str, size: float = 12.0) -> None:
    """Add a heading above all plots of a figure."""
    figure.suptitle(say(text), x=0.01, horizontalalignment="left", fontweight="bold", fontsize=size)


def legend_below(figure: Figure, *, columns: int | None = None, size: float = 9.0) -> None:
    """Add the legend of a figure's first plot below all plots; in one row unless ``columns`` are given."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    where: dict[str, Any] = {"loc": "outside lower center", "ncols": columns or len(labels)}
    figure.legend(handles, labels, **where, frameon=False, fontsize=size)


def polar_ticks(plot: PolarAxes, extent: float, domain: Sequence[float]) -> tuple[list[tuple[float, str]], bool]:
    """Set the radial range of a polar plot around its zero circle, and its angular range (``domain``, degrees) if less than a turn.

    Return tick radii up to ``extent`` with their labels, to be drawn by the caller, and whether the plot is a full turn.
    """
    plot.set_ylim(-HOLLOW * extent, HEADROOM * extent)
    full = domain[1] - domain[0] > 350.0
    if not full:
        plot.set_thetamin(domain[0])
        plot.set_thetamax(domain[1])
    plot.grid(color="#cccccc", linewidth=0.5)
    ticks = [tick for tick in MaxNLocator(4, symmetric=True).tick_values(-extent, extent) if abs(tick) <= extent]
    return [(tick, radius_label(tick)) for tick in ticks], full


def radius_label(tick: float) -> str:
    """Return a deviation with its sign; zero has none."""
    return say(Number(signed(f"{tick:+g}"))) if tick else "0"


def save(figure: Figure, path: str | Path, *, dpi: int = 150) -> None:
    """Write a figure in the format of the file's suffix (png, pdf, svg); ``dpi`` is for png."""
    figure.savefig(path, dpi=dpi)


def embedded(figure: Figure, words: str, caption: str = "", kind: str = "") -> Html:
    """Return a picture embedded as SVG, with alternative text, plain caption and CSS class; the same picture gives the same bytes."""
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "twin", "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return part(
        "figure", base64.b64encode(_smaller(buffer.getvalue().decode()).encode()).decode(), words, caption, kind
    )


METADATA: Final = re.compile(r"<metadata>.*?</metadata>", re.S)
FONTS: Final = re.compile(r"'DejaVu Sans'(?:, '[^']*')*(?:, [\w-]+)*")
DATA: Final = re.compile(r'(?<= d=")[^"]*|(?<= (?:x|y)=")-?\d+\.\d+(?=")')
DECIMALS: Final = re.compile(r"(\.\d\d)\d+")
COMMAND: Final = re.compile(r"\s*([A-Za-z])\s*")


def _smaller(svg: str) -> str:
    """Return an SVG of matplotlib with coordinates to a hundredth of a point, and without metadata and its list of fonts."""
    svg = FONTS.sub("'DejaVu Sans',Verdana,sans-serif", METADATA.sub("", svg))
    return DATA.sub(lambda found: COMMAND.sub(r"\1", DECIMALS.sub(r"\1", found.group())), svg)


TICK: Final = 3.5
"""Length of a tick, and its distance to its number, points."""
TURNED_PAD: Final = 14.0
"""Distance of the middle of the number of an angle from the outer circle, points."""
LABEL_PAD: Final = 4.0
"""Distance of the label of an axis from the numbers, points."""


class _WithoutTicks:
    """Mixin of an axis that is not drawn: matplotlib makes the first ticks of an axis with it, half of the time of empty axes."""

    if not TYPE_CHECKING:  # matplotlib declares variables
        majorTicks = minorTicks = property(lambda self: [])

    def get_major_ticks(self, numticks: int | None = None) -> list[Any]:
        """Return no ticks."""
        return []

    get_minor_ticks = get_major_ticks


@final
class _PlainXAxis(_WithoutTicks, XAxis):
    """Horizontal axis that is not drawn."""


@final
class _PlainYAxis(_WithoutTicks, YAxis):
    """Vertical axis that is not drawn."""


@final
class _PlainThetaAxis(_WithoutTicks, ThetaAxis):
    """Axis of angles that is not drawn."""


@final
class _PlainRadialAxis(_WithoutTicks, RadialAxis):
    """Axis of radii that is not drawn."""


@final
class _PlainAxes(Axes):
    def _init_axis(self) -> None:
        self.xaxis, self.yaxis = _PlainXAxis(self, clear=False), _PlainYAxis(self, clear=False)
        for axis, names in ((self.xaxis, ("bottom", "top")), (self.yaxis, ("left", "right"))):
            for name in names:
                self.spines[name].register_axis(axis)


@final
class _PlainPolarAxes(PolarAxes):
    def _init_axis(self) -> None:
        self.xaxis, self.yaxis = _PlainThetaAxis(self, clear=False), _PlainRadialAxis(self, clear=False)
        for name in ("polar", "inner"):
            self.spines[name].register_axis(self.yaxis)


def add_plain_axes(figure: Figure, place: tuple[float, float, float, float]) -> Axes:
    """Return new axes at left, bottom, width and height in shares of the figure, to be finished by `draw_plain_axes`."""
    plot = figure.add_axes(place, axes_class=_PlainAxes)
    for spine in plot.spines.values():
        spine.get_position()  # places it, as a tick would
    return plot


def add_plain_polar(figure: Figure, place: tuple[float, float, float, float]) -> PolarAxes:
    """The same for `draw_plain_polar`."""
    return cast(PolarAxes, figure.add_axes(place, axes_class=_PlainPolarAxes))


def draw_plain_axes(
    plot: Axes, size: float, *, grid: Literal["both", "x", ""] = "both", scale: bool = True, right: bool = False
) -> None:
    """Draw grid, ticks, numbers (of a font size in points) and labels of a finished plot, and hide matplotlib's own.

    Fixed locators of axes and their formatters are used; the horizontal axis is drawn if ``scale``, the vertical one at the right if
    ``right``.
    """
    plot.set_title("", y=1.0)  # its place would otherwise be computed from those of the ticks
    for axis in (plot.xaxis, plot.yaxis):
        axis.set_visible(False)
    if scale:
        _draw(plot, plot.xaxis, size, grid=bool(grid), side=0)
    _draw(plot, plot.yaxis, size, grid=grid == "both", side=1 if right else -1)


def draw_plain_polar(
    plot: PolarAxes, angles: np.ndarray, radii: Sequence[tuple[float, str]], *, sizes: Sequence[float]
) -> None:
    """Draw grid, angles and radii of a finished polar plot, and hide matplotlib's own.

    ``angles``: (n,) rad, of the rays and their numbers; ``radii`` of the circles, ascending, with their texts; ``sizes``: font sizes
    of both in points.
    """
    for axis in (plot.xaxis, plot.yaxis):
        axis.set_visible(False)
    (low, high), (start, end) = sorted(plot.get_ylim()), np.deg2rad((plot.get_thetamin(), plot.get_thetamax()))
    arc = np.linspace(start, end, 181)
    rays = np.repeat(angles, 3), np.tile([low, high, np.nan], len(angles))
    circles = np.tile([*arc, np.nan], len(radii)), np.repeat([radius for radius, _ in radii], len(arc) + 1)
    for x, y in (rays, circles):
        plot.add_artist(Line2D(x, y, color="#cccccc", linewidth=0.5, zorder=0.5))
    looks: dict[str, Any] = {"color": "black", "clip_on": False}
    for angle in angles:
        away = _shifted(plot, TURNED_PAD * np.cos(angle), TURNED_PAD * np.sin(angle))
        text = f"{np.round(np.rad2deg(angle)) + 0.0:.0f}°"
        middle: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": sizes[0]}
        plot.add_artist(Text(angle, high, text, transform=plot.transData + away, **middle, **looks))
    full = end - start > 2.0 * np.pi - 1e-9
    right, up = (0.0, 0.0) if full else (2.0 * TICK * np.sin(start), -2.0 * TICK * np.cos(start))
    where = plot.transData + _shifted(plot, right, up)
    beside: dict[str, Any] = {"ha": "left", "va": "bottom"}
    if not full:
        beside = {
            "ha": "center" if abs(right) < TICK else "left" if right > 0.0 else "right",
            "va": "center" if abs(up) < TICK else "bottom" if up > 0.0 else "top",
        }
    box = text_box_style(0.8, 0.4)
    for radius, text in radii:
        at = np.deg2rad(plot.get_rlabel_position()) if full else start
        plot.add_artist(
            Text(at, radius, text, transform=where, fontsize=sizes[1], bbox=box, zorder=1.5, **beside, **looks)
        )


def _draw(plot: Axes, axis: Axis, size: float, *, grid: bool, side: int) -> None:
    """Draw one axis: below (``side`` 0), at the left (−1) or at the right (1)."""
    at, texts = _numbers(plot, axis, size, upright=side != 0)
    edge = np.full(len(at), float(side > 0))
    along = plot.get_yaxis_transform() if side else plot.get_xaxis_transform()
    font, outside = FontProperties(size=size), 2.0 * TICK
    looks: dict[str, Any] = {"color": "black", "clip_on": False}
    if grid:
        across = np.tile([0.0, 1.0, np.nan], len(at))
        x, y = _in_order(np.repeat(at, 3), across, side)
        plot.add_artist(Line2D(x, y, transform=along, zorder=0.5, **GRID))
    mark = {-1: TICKLEFT, 0: TICKDOWN, 1: TICKRIGHT}[side]
    marks: dict[str, Any] = {"linestyle": "", "marker": mark, "markersize": TICK, "markeredgewidth": 0.8}
    x, y = _in_order(at, edge, side)
    plot.add_artist(Line2D(x, y, transform=along, zorder=2.1, **marks, **looks))
    ends: dict[str, Any] = {
        -1: {"va": "center_baseline", "ha": "right"},
        0: {"va": "top", "ha": "center"},
        1: {"va": "center_baseline", "ha": "left"},
    }[side]
    numbers = along + _outward(plot, outside, side)
    for place, text in zip(at, texts, strict=True):
        x, y = _in_order(place, edge[0], side)
        plot.add_artist(Text(x, y, text, fontproperties=font, transform=numbers, **ends, **looks))
    width, height, _ = np.max(
        [text_to_path.get_text_width_height_descent(text, font, False) for text in (*texts, "lp")], axis=0
    )
    turned: dict[str, Any] = {"rotation": 90.0, "rotation_mode": "anchor", "va": "top" if side > 0 else "bottom"}
    if not axis.label.get_text():
        return
    label = plot.transAxes + _outward(plot, outside + LABEL_PAD + (width if side else height), side)
    x, y = _in_order(0.5, float(side > 0), side)
    looks |= {"ha": "center", "fontsize": axis.label.get_fontsize(), **(turned if side else {"va": "top"})}
    plot.add_artist(Text(x, y, axis.label.get_text(), transform=label, **looks))


def _in_order(along: Any, across: Any, side: int) -> tuple[Any, Any]:
    return (across, along) if side else (along, across)


def _outward(plot: Axes, points: float, side: int) -> Transform:
    """Return the shift by a number of points away from the plot."""
    return _shifted(plot, side * points, 0.0) if side else _shifted(plot, 0.0, -points)


def _shifted(plot: Axes, x: float, y: float) -> Transform:
    inches: Any = plot.get_figure(root=True).dpi_scale_trans  # type: ignore[union-attr]
    return ScaledTranslation(x / 72.0, y / 72.0, inches)


def _numbers(plot: Axes, axis: Axis, size: float, *, upright: bool) -> tuple[np.ndarray, list[str]]:
    """Return positions and texts of the ticks of an axis: those of a fixed locator, or as chosen by matplotlib."""
    shape = plot.get_window_extent()
    length = (shape.height if upright else shape.width) / plot.get_figure(root=True).dpi * 72.0  # type: ignore[union-attr]
    most = int(np.clip(length // (size * (2.0 if upright else 3.0)), 1, 9))
    given = axis.get_major_locator()
    locator = given if isinstance(given, FixedLocator) else MaxNLocator(most, steps=[1, 2, 2.5, 5, 10])
    low, high = sorted(axis.get_view_interval())
    at = np.asarray(locator.tick_values(low, high))
    formatter = axis.get_major_formatter()
    texts = formatter.format_ticks(at.tolist())
    if not isinstance(formatter, FixedFormatter):
        texts = [say(Number(text)) for text in texts]
    slack = 1e-10 * (high - low)
    inside = (at >= low - slack) & (at <= high + slack)
    return at[inside], [text for text, shown in zip(texts, inside, strict=True) if shown]
