"""A field of errors as one HTML page: an arrow at every point, as long as its error a stated number of times, coloured by its size."""

from __future__ import annotations

import html
import json
from string import Template
from typing import Final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import MM
from twin.report.scene.camera import CAMERA
from twin.report.scene.draw import (
    bare_stage,
    colour_bar,
    lines_command,
    mesh_command,
    node_of,
    packed,
    short,
    viewer_source,
)
from twin.report.scene.path import Mesh, arrow, joined, rounded_125, scale_top_um, viridis

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
        _arrow(start, end, THIN * extent, (float(r), float(g), float(b)))
        for start, end, (r, g, b) in zip(points_mm * MM, ends, colours, strict=True)
        if np.linalg.norm(end - start) > 0.0
    ]
    commands = [*bare_stage()]
    if arrows:
        commands.append(mesh_command(joined(arrows), node_of("arrows")))
    if edges:
        commands.append(
            lines_command(np.array([end for _, *both in edges for end in both]) * MM, None, node_of("edges"))
        )
    outline = np.concatenate([points_mm * MM, ends, *(np.array(both) * MM for _, *both in edges)])
    page = {
        "outline": outline[np.unique(np.argmax(outline @ _WAYS.T, axis=0))].round(5).tolist(),
        "labels": [{"text": text, "at": ((a + b) / 2.0 * MM).round(5).tolist()} for text, a, b in edges if text],
    }
    return PAGE.substitute(
        title=html.escape(title),
        camera=CAMERA,
        viewer=viewer_source(),
        commands=json.dumps([packed(command) for command in commands]),
        page=json.dumps(page).replace("</", "<\\/"),
        **colour_bar(top),
        factor=short(factor),
        notice="<b>drawn, not measured</b>" if illustrative else "",
    )


def _arrow(start: np.ndarray, end: np.ndarray, radius: float, colour: tuple[float, float, float]) -> Mesh:
    """Thinner where it would be shorter than its head: a small error looks small."""
    length = float(np.linalg.norm(end - start))
    return arrow(start, end, min(radius, max(length / 9.0, SMALLEST * radius)), colour)


_WAYS = np.array([(x, y, z) for x in (-2, -1, 0, 1, 2) for y in (-2, -1, 0, 1, 2) for z in (-2, -1, 0, 1, 2)], float)

PAGE = Template(
    """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
img-src data: blob:">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
html, body { margin: 0; height: 100%; overflow: hidden; background: #fff;
  font: 14px/1.35 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: #1b1b1b; }
#meshcat-pane { position: fixed; inset: 0 0 66px 0; touch-action: none; cursor: grab; }
#meshcat-pane canvas { display: block; }
.dg { display: none; }
#legend { position: fixed; left: 0; right: 0; bottom: 0; height: 66px; padding: 4px 12px; background: #fff; }
#colours { height: 13px; border-radius: 3px; background: linear-gradient(to right, $gradient); }
#ticks { display: flex; justify-content: space-between; font-variant-numeric: tabular-nums; font-size: 13px; }
#words { display: flex; justify-content: space-between; gap: 1em; }
.name { position: fixed; transform: translate(-50%, -50%); padding: 0 3px; background: #ffffffcc; font-weight: 600; font-size: 13px;
  white-space: nowrap; pointer-events: none; }
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<div id="legend"><div id="colours"></div><div id="ticks">$ticks</div>
<div id="words"><span>error in µm · arrows × $factor</span>$notice</div></div>
<script>$viewer</script>
<script>
"use strict";
(function () {
  const page = $page;
  // Without WebGL there is nothing to see here: whoever embeds the page shows its picture instead.
  let viewer;
  try {
    viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
    viewer.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  } catch (error) {
    document.body.textContent = "This browser draws nothing in 3D (no WebGL): see the picture instead.";
    try { parent.document.body.classList.add("flat"); } catch (outside) { /* not embedded, or not by us */ }
    return;
  }
  window.viewer = viewer;
  for (const command of $commands) {
    viewer.handle_command_bytearray(Uint8Array.from(atob(command), c => c.charCodeAt(0)));
  }
  viewer.scene.updateMatrixWorld(true);
$camera  const camera = viewer.camera;
  const names = page.labels.map(label => {
    const span = document.createElement("span");
    span.className = "name";
    span.textContent = label.text;
    document.body.appendChild(span);
    return span;
  });
  let touched = false;
  viewer.controls.addEventListener("start", () => { touched = true; });
  function layout() {
    const w = window.innerWidth, h = window.innerHeight - 66;
    if (w <= 0 || h <= 0) return;
    viewer.set_3d_pane_size(w, h);
    if (!touched) fit(camera, viewer.controls, page.outline, [-0.62, -1.3, 0.75], 0.88 * TANGENT * w / h, 0.88 * TANGENT);
    viewer.set_dirty();
  }
  const draw = viewer.render.bind(viewer);
  viewer.render = function () {
    draw();
    const w = window.innerWidth, h = window.innerHeight - 66;
    page.labels.forEach((label, i) => {
      const at = world(label.at).project(camera);
      names[i].style.left = Math.max(30, Math.min(w - 30, (at.x + 1) / 2 * w)) + "px";
      names[i].style.top = Math.max(10, Math.min(h - 10, (1 - at.y) / 2 * h)) + "px";
    });
  };
  window.onload = layout;
  window.addEventListener("resize", layout);
  layout();
})();
</script>
</body>
</html>
"""
)
