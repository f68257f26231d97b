"""Meshcat's viewer as one self-contained HTML page, made without a browser, network or server.

The page embeds meshcat's drawing commands, like meshcat's ``static_html``, which gets them from a server process. Here they are
collected from meshcat's classes, so that no server is started. Lengths are in metres.
"""

from __future__ import annotations

import base64
import importlib.resources
import json
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final

import meshcat.geometry as shapes
import numpy as np
import umsgpack
from meshcat.commands import SetObject, SetProperty
from meshcat.path import Path as NodePath

from twin.display import compact, render
from twin.reporting.scene.path import Mesh, viridis

FIRST_LINK: Final = "machine"
"""Node of the scene tree that contains all objects."""
_EDGE: Final = 0x4A525C
_WAYS: Final = np.array(list(product((-2, -1, 0, 1, 2), repeat=3)), dtype=float)


def viewer_page(template: str, commands: Sequence[Any], data: Mapping[str, Any], top_um: float, **words: Any) -> str:
    """Return the page's text, several megabytes.

    Args:
        template: name of the template, which extends ``viewer.html.j2``.
        commands: meshcat's drawing commands.
        data: numbers for the page's script.
        top_um: end of the colour scale.
        words: further variables of the template.
    """
    colours = viridis(np.linspace(0.0, 1.0, 17))
    main = importlib.resources.files("meshcat") / "viewer" / "dist" / "main.min.js"
    return render(
        f"reporting/scene/templates/{template}.html.j2",
        viewer=main.read_text(encoding="utf-8"),
        commands=json.dumps([packed(command) for command in commands]),
        page=json.dumps(data).replace("</", "<\\/"),
        gradient=", ".join(f"rgb({', '.join(str(round(255 * c)) for c in colour)})" for colour in colours),
        ticks=[compact(top_um * share / 4) for share in range(5)],
        **words,
    )


def node_of(*names: str) -> NodePath:
    """Return a node of the viewer's scene tree."""
    return NodePath(("meshcat", FIRST_LINK, *names))


def bare_stage() -> list[Any]:
    """Return commands that hide the viewer's default objects."""
    return [SetProperty("visible", False, NodePath((name,))) for name in ("Grid", "Axes", "Background")]


def mesh_command(mesh: Mesh, node: NodePath) -> SetObject:
    """Return the command that draws a mesh."""
    # Unlit, so that colours match the legend.
    geometry = shapes.TriangularMeshGeometry(mesh.vertices, mesh.faces, mesh.colours)
    return SetObject(geometry, shapes.MeshBasicMaterial(vertexColors=True), node)


def lines_command(segments: np.ndarray, colours: np.ndarray | None, node: NodePath) -> SetObject:
    """Return the command that draws segments with (2k, 3) end points and colours, or in the edge colour if None."""
    ends = segments.astype(np.float32).T
    if colours is None:
        drawn = shapes.PointsGeometry(ends), shapes.LineBasicMaterial(color=_EDGE, opacity=0.55)
    else:
        drawn = shapes.PointsGeometry(ends, colours.astype(np.float32).T), shapes.LineBasicMaterial(vertexColors=True)
    return SetObject(shapes.LineSegments(*drawn), path=node)


def outermost(points: np.ndarray) -> np.ndarray:
    """Return the indices of the outermost of (n, 3) points, which the camera must keep in view."""
    return np.asarray(np.unique(np.argmax(points @ _WAYS.T, axis=0)))


def packed(command: Any) -> str:
    """Return a drawing command as msgpack in base64, with fixed object names, so that equal input gives an equal page."""
    data = command.lower()
    if isinstance(command, SetObject):
        entry = data["object"]
        for kind, mark in (("geometries", "geometry"), ("materials", "material")):
            entry[kind][0]["uuid"] = entry["object"][mark] = mark
        entry["object"]["uuid"] = data["path"]
    # Single precision halves the size; 0.1 µm at 1 m is invisible.
    return base64.b64encode(umsgpack.packb(_plain(data), force_float_precision="single")).decode("ascii")


def _plain(data: Any) -> Any:
    """Return the data with NumPy numbers converted to Python numbers, as msgpack needs."""
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data] if not isinstance(data, umsgpack.Ext) else data
    return data.item() if isinstance(data, np.generic) else data
