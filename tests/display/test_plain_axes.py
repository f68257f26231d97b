"""Tests of axes drawn as few artists: they show the same ticks, numbers and labels as matplotlib's own, at the same places."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.axis import Tick
from matplotlib.projections.polar import PolarAxes
from matplotlib.text import Text

from twin.display.figures import (
    add_plain_axes,
    add_plain_polar,
    draw_plain_axes,
    draw_plain_polar,
    new_figure,
    polar_ticks,
    style_axes,
)

SIZE = 9.0


def _plot(low: float, high: float, peak: float, *, plain: bool = False) -> Axes:
    figure, place = new_figure(4.4, 3.0, None), (0.2, 0.3, 0.75, 0.65)
    plot = add_plain_axes(figure, place) if plain else figure.add_axes(place)
    x = np.linspace(low, high, 50)
    plot.plot(x, peak * np.sin(x / (high - low) * 5.0))
    plot.set(xlabel="X [mm]", ylabel="E_XX [µm]")
    return plot


def _boxes(plot: Axes, texts: Iterable[Text]) -> dict[tuple[str, bool], tuple[float, ...]]:
    """Return the boxes of texts in pixels, by text and by whether it stands at the vertical axis."""
    renderer = plot.figure.canvas.get_renderer()  # type: ignore[union-attr, attr-defined]
    left, boxes = plot.get_window_extent().x0, {one: one.get_window_extent(renderer) for one in texts}
    return {(one.get_text(), box.x1 < left): tuple(box.extents) for one, box in boxes.items()}


@pytest.mark.parametrize(("low", "high", "peak"), [(0, 500, 10.0), (-400, 0, 150.0), (3, 3.2, 0.4), (0, 7000, 2e4)])
def test_same_texts_at_the_same_places(low: float, high: float, peak: float) -> None:
    own, plain = _plot(low, high, peak), _plot(low, high, peak, plain=True)
    style_axes(own)
    own.tick_params(labelsize=SIZE)
    draw_plain_axes(plain, SIZE)
    for plot in (own, plain):
        plot.figure.canvas.draw()  # type: ignore[union-attr]
    (low_x, high_x), (low_y, high_y) = own.get_xlim(), own.get_ylim()
    texts = [one for one in own.get_xticklabels() if low_x <= one.get_position()[0] <= high_x]
    texts += [one for one in own.get_yticklabels() if low_y <= one.get_position()[1] <= high_y]
    expected = _boxes(own, [*texts, own.xaxis.label, own.yaxis.label])
    found = _boxes(plain, [one for one in plain.texts if one.get_text()])
    assert len(found) >= 8
    assert set(found) == set(expected)
    for text, box in found.items():
        np.testing.assert_allclose(
            box, expected[text], atol=1.6, err_msg=str(text)
        )  # texts are rendered at whole pixels


@pytest.mark.parametrize(("low", "high"), [(0.0, 360.0), (0.0, 180.0), (-120.0, 120.0)])
def test_angles_at_the_same_places(low: float, high: float) -> None:
    angles = np.deg2rad(np.arange(low, high, 30.0))
    figures, place = [new_figure(4.4, 4.3, None) for _ in "12"], (0.1, 0.1, 0.8, 0.8)
    plots = [cast(PolarAxes, figures[0].add_axes(place, projection="polar")), add_plain_polar(figures[1], place)]
    for plot in plots:
        ticks, _ = polar_ticks(plot, 5.0, (low, high))
    own, plain = plots
    own.set_xticks(angles)
    own.tick_params(axis="x", labelsize=8)
    draw_plain_polar(plain, angles, ticks, sizes=(8.0, 7.5))
    for plot in plots:
        plot.figure.canvas.draw()  # type: ignore[union-attr]
    found = _boxes(plain, [one for one in plain.texts if one.get_text().endswith("°")])
    expected = _boxes(own, own.get_xticklabels())
    assert {text for text, _ in found} == {f"{angle:.0f}°" for angle in np.arange(low, high, 30.0)}
    places = [sorted(tuple(np.round(box, 3)) for box in boxes.values()) for boxes in (found, expected)]
    assert len(places[0]) == len(angles)
    np.testing.assert_allclose(places[0], places[1], atol=1.6)
    assert [text for _, text in ticks] == [one.get_text() for one in plain.texts if "°" not in one.get_text()]


def test_axes_without_ticks_have_their_lines_at_the_same_places() -> None:
    own, plain = _plot(0.0, 500.0, 10.0), _plot(0.0, 500.0, 10.0, plain=True)
    draw_plain_axes(plain, SIZE)
    for plot in (own, plain):
        plot.figure.canvas.draw()  # type: ignore[union-attr]
    assert not [*plain.xaxis.majorTicks, *plain.yaxis.minorTicks, *plain.findobj(Tick)] and own.findobj(Tick)
    for name, spine in plain.spines.items():
        points = [one.get_transform().transform_path(one.get_path()).vertices for one in (spine, own.spines[name])]
        np.testing.assert_allclose(*points, atol=1e-9, err_msg=name)
