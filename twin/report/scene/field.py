"""A field of errors as one HTML page: an arrow at every point, as long as its error a stated number of times, coloured by its size."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import MM
from twin.report.scene.path import Mesh, arrow, joined, rounded_125, scale_top_um, viridis
from twin.report.scene.viewer import bare_stage, lines_command, mesh_command, node_of, outermost, viewer_page

LONGEST: Final = 0.12
"""Of the field's extent: how long the longest arrow is drawn, about."""
THIN: Final = 0.0035
"""Radius of an arrow in the field's extent."""
MOST_ARROWS: Final = 1500
"""A browser of a phone turns that many smoothly."""
SMALLEST: Final = 0.3
"""Of the scale: what an arrow shorter than its own head is drawn as thick as."""


def chosen_factor(points_mm: np.ndarray, errors_um: np.ndarray) -> float:
    """Factor that shows the largest error at about `LONGEST` of the field's extent: 1, 2 or 5 times a power of ten, never below 1.

    Args:
        points_mm: (n, 3).
        errors_um: (n, 3).
    """
    extent = float(np.linalg.norm(np.ptp(points_mm, axis=0)))
    largest = float(np.linalg.norm(errors_um, axis=1).max())
    if extent <= 0.0 or largest <= 0.0:
        return 1.0
    return max(1.0, rounded_125(LONGEST * extent / (largest * 1e-3)))


def field_html(
    points_mm: np.ndarray,
    errors_um: np.ndarray,
    *,
    title: str,
    edges: tuple[tuple[str, np.ndarray, np.ndarray], ...] = (),
    illustrative: bool = False,
) -> str:
    """The page: arrows, a box with its edges named, a colour bar; drag turns it, wheel or two fingers zoom.

    Args:
        points_mm: (n, 3) where the tool was meant to be.
        errors_um: (n, 3) by how much it missed.
        title: what is shown, plain text.
        edges: of the box, each with its name, and its (3,) ends in mm, where they have a name to be shown.
        illustrative: say in the page that the errors are drawn, not measured.

    Raises:
        InputError: no points, too many, or arrays that do not belong together.
    """
    count = len(points_mm)
    if points_mm.shape != (count, 3) or errors_um.shape != (count, 3) or not 1 <= count <= MOST_ARROWS:
        raise InputError(
            "no field that can be drawn", expected=f"(n, 3) points and errors, n from 1 to {MOST_ARROWS}", value=count
        )
    factor = chosen_factor(points_mm, errors_um)
    size = np.linalg.norm(errors_um, axis=1)
    top = scale_top_um(float(size.max()))
    colours = viridis(np.clip(size / top, 0.0, 1.0))
    extent = max(float(np.linalg.norm(np.ptp(points_mm, axis=0))), 1.0) * MM
    ends = (points_mm + factor * errors_um * 1e-3) * MM
    arrows = [
        _arrow(start, end, THIN * extent, colour)
        for start, end, colour in zip(points_mm * MM, ends, colours, strict=True)
        if np.linalg.norm(end - start) > 0.0
    ]
    commands = [*bare_stage()]
    if arrows:
        commands.append(mesh_command(joined(arrows), node_of("arrows")))
    if edges:
        box = np.array([end for _, *both in edges for end in both]) * MM
        commands.append(lines_command(box, None, node_of("edges")))
    outline = np.concatenate([points_mm * MM, ends, *(np.array(both) * MM for _, *both in edges)])
    data = {
        "outline": outline[outermost(outline)].round(5).tolist(),
        "labels": [{"text": text, "at": ((a + b) / 2.0 * MM).round(5).tolist()} for text, a, b in edges if text],
    }
    return viewer_page("field", commands, data, top, title=title, factor=factor, illustrative=illustrative)


def _arrow(start: np.ndarray, end: np.ndarray, radius: float, colour: np.ndarray) -> Mesh:
    """Thinner where it would be shorter than its head: a small error looks small."""
    length = float(np.linalg.norm(end - start))
    return arrow(start, end, min(radius, max(length / 9.0, SMALLEST * radius)), colour)
