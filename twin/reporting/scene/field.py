"""Error field as one HTML page: an arrow at every point, exaggerated by a stated factor and coloured by magnitude."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import MM
from twin.reporting.scene.path import Mesh, arrow, joined, rounded_125, scale_top_um, viridis
from twin.reporting.scene.viewer import bare_stage, lines_command, mesh_command, node_of, outermost, viewer_page

LONGEST: Final = 0.12
"""Approximate length of the longest arrow, as a share of the field's extent."""
THIN: Final = 0.0035
"""Radius of an arrow, as a share of the field's extent."""
MOST_ARROWS: Final = 1500
"""Largest number of arrows that the browser of a phone rotates smoothly."""
SMALLEST: Final = 0.3
"""Smallest radius of a short arrow, as a share of the regular radius."""


def chosen_factor(points_mm: np.ndarray, errors_um: np.ndarray) -> float:
    """Return the exaggeration factor that draws the largest error at about `LONGEST` of the field's extent: 1, 2 or 5 · 10ⁿ, n ≥ 0.

    Args:
        points_mm: (n, 3) tool points.
        errors_um: (n, 3) errors.
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
    """Return the page with arrows, a labelled box and a colour bar; drag rotates it, wheel or two fingers zoom.

    Args:
        points_mm: (n, 3) nominal tool points.
        errors_um: (n, 3) errors of the tool point.
        title: title of the page, plain text.
        edges: edges of the box, each with its label (or empty) and its (3,) end points, mm.
        illustrative: state on the page that the errors are assumed, not measured.

    Raises:
        InputError: no points, too many, or arrays of different length.
    """
    count = len(points_mm)
    if points_mm.shape != (count, 3) or errors_um.shape != (count, 3) or not 1 <= count <= MOST_ARROWS:
        raise InputError(
            "field cannot be drawn", expected=f"(n, 3) points and errors, n from 1 to {MOST_ARROWS}", value=count
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
    """Return an arrow; a short one is thinner, so that a small error looks small."""
    length = float(np.linalg.norm(end - start))
    return arrow(start, end, min(radius, max(length / 9.0, SMALLEST * radius)), colour)
