"""Draw the animation of a program on its machine, and the error field, each as one HTML page.

The page embeds meshcat's drawing commands, like meshcat's ``static_html``, which gets them from a server process. Here they are
collected from meshcat's classes, without a server. Lengths are in metres; the path and its deviations are given in mm.
"""

from __future__ import annotations

import base64
import importlib.resources
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final, final

import coal
import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin
import umsgpack
from meshcat import transformations
from meshcat.animation import Animation, AnimationClip, AnimationTrack
from meshcat.commands import SetAnimation, SetObject, SetProperty, SetTransform
from meshcat.path import Path as NodePath

from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.provenance import SourceWarning, warning_texts
from twin._common.resources import Progress, silent
from twin._common.units import MM
from twin.compensation.programs.execute import Execution, execute_file
from twin.compensation.programs.words import Setup
from twin.display import compact, in_iframe, render
from twin.display.results import Display, DisplayedResult
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.reporting.scene.path import (
    MAX_POINTS,
    Keyframes,
    Mesh,
    ScenePath,
    arrow,
    arrow_blocks,
    chosen_exaggeration,
    joined,
    keyframes,
    rounded_125,
    runs,
    scale_top_um,
    thinned,
    tube,
    viridis,
)
from twin.tool.forward import Kinematics

FIRST_LINK: Final = "machine"
"""Node of the scene tree that contains all objects."""
_EDGE: Final = 0x4A525C
_WAYS: Final = np.array(list(product((-2, -1, 0, 1, 2), repeat=3)), dtype=float)


def viewer_page(template: str, commands: Sequence[Any], data: Mapping[str, Any], top_um: float, **words: Any) -> str:
    """Return the page from a template that extends ``viewer.html.j2``, with meshcat's commands and ``data`` for its script."""
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


SECONDS: Final = 20.0
"""Duration of the animation."""
VECTORS: Final = 24
"""Number of points at which the deviation is drawn as an arrow."""
TOOL_RADIUS_MM: Final = 5.0
_NOMINAL: Final = (0.42, 0.45, 0.49)
_RAPID: Final = (0.72, 0.78, 0.86)
_INK: Final = (0.13, 0.14, 0.17)
_RED: Final = (0.84, 0.10, 0.12)
_TOOL: Final = 0xC9A227
_CORNERS: Final = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_BOX_EDGES: Final = np.concatenate(
    [_CORNERS[[a, b]] for a in range(8) for b in range(a + 1, 8) if np.sum(_CORNERS[a] != _CORNERS[b]) == 1]
)
_LIGHTS: Final = (
    ("AmbientLight", "intensity", 0.6),
    ("FillLight", "intensity", 0.38),
    ("FillLight", "position", [-2.0, -5.0, 4.0]),
    ("PointLightNegativeX", "visible", False),
    # The second point light imitates reflection from the floor; its distance makes it uniform.
    ("PointLightPositiveX", "intensity", 0.16),
    ("PointLightPositiveX", "position", [4.0, -3.0, 1.0]),
    ("PointLightPositiveX", "distance", 0.0),
)


def scene_html(
    kinematics: Kinematics,
    path: ScenePath,
    *,
    title: str,
    exaggeration: float | None = None,
    warnings: Sequence[SourceWarning] = (),
    omitted: str = "",
    features: Sequence[tuple[np.ndarray, float]] = (),
) -> str:
    """Return the page with the moving machine and the tool path, whose deviation is exaggerated and coloured; several megabytes.

    ``exaggeration`` None chooses a round number; ``omitted``: parts of the program that are not in the path, as shown on the page;
    ``features``: (n, 3) points of each feature of a part in the work frame, mm, and its probability of conformity, NaN if unknown.
    Raises `InputError` if the path does not fit the machine, the factor is not positive, or the URDF has shapes that cannot be drawn.
    """
    machine = kinematics.machine
    path.check(len(machine.axes))
    if exaggeration is not None and not (math.isfinite(exaggeration) and exaggeration > 0):
        raise InputError("exaggeration must be positive", expected="a number above 0", value=exaggeration)
    whole, path = path, path.drawn()
    factor = chosen_exaggeration(path) if exaggeration is None else exaggeration
    top_um = scale_top_um(path.max_um)
    frames = keyframes(path, machine.linear, machine.rotary)
    visuals = _visuals(kinematics)
    tool, work = (str(machine.model.frames[frame].name) for frame in (machine.tool_frame, machine.work_frame))
    links = tuple(dict.fromkeys([*(visual.link for visual in visuals), tool, work]))
    poses = link_poses(kinematics, frames.positions, links)
    outline = _outline(visuals, links, poses)
    box = np.array([outline.min(axis=0), outline.max(axis=0)])
    size = float(np.linalg.norm(box[1] - box[0]))
    commands = [
        *_machine_commands(visuals, links, work),
        *_tool_commands(kinematics, node_of(tool), 0.008 * path.extent_mm * MM),
        *_path_commands(path, factor, top_um, node_of(work), size),
        *_feature_commands(features, node_of(work).append("features"), 0.006 * path.extent_mm),
        *_motion_commands(frames, links, poses),
        *_stage_commands(box),
    ]
    axes = [{"name": axis.name, "unit": "mm" if axis.linear else "°"} for axis in machine.axes]
    places = {"work": f"{FIRST_LINK}/{work}", "tool": f"{FIRST_LINK}/{tool}"}
    data = {
        "outline": outline.tolist(),
        "frame": machine.upright.T.tolist(),
        **places,
        "axes": axes,
        **_path_data(path, frames, factor),
    }
    return viewer_page(
        "scene",
        commands,
        data,
        top_um,
        title=title,
        machine=machine.name,
        factor=factor,
        path=whole,
        features=bool(features),
        notices=[*warning_texts(warnings), *([f"Not shown: {omitted}."] if omitted else [])],
        still="" if len(frames.share) > 1 else "still",
    )


def _path_data(path: ScenePath, frames: Keyframes, factor: float) -> dict[str, Any]:
    worst = path.shown_mm(factor)[path.worst] * MM
    shown = np.concatenate([path.nominal_mm[path.counted], path.shown_mm(factor)[path.counted]]) * MM
    return {
        "pathOutline": (np.where(_CORNERS > 0, shown.max(axis=0), shown.min(axis=0))).round(6).tolist(),
        "worst": {"at": worst.round(6).tolist(), "um": compact(path.max_um), "line": int(path.lines[path.worst])},
        "seconds": SECONDS,
        "share": frames.share.round(6).tolist(),
        "q": frames.positions.round(3).tolist(),
        "um": frames.deviation_um.round(2).tolist(),
        "line": path.lines[frames.block].astype(int).tolist(),
        "cutting": path.cutting[frames.block].astype(int).tolist(),
    }


def link_poses(kinematics: Kinematics, positions: np.ndarray, links: tuple[str, ...]) -> np.ndarray:
    """Return (n, links, 4, 4) poses of links of the URDF for pictures, z up (`Machine.upright`), m, at (n, axes) commands.

    The machine has its errors.
    """
    machine = kinematics.machine
    model = machine.model
    data = model.createData()
    numbers = [model.getFrameId(link, pin.FrameType.BODY) for link in links]
    errors = kinematics.error_frames(positions)
    poses = np.empty((len(positions), len(links), 4, 4))
    for index, q in enumerate(positions * machine.scale):
        pin.framesForwardKinematics(model, data, machine.configuration(q, errors[index]))
        poses[index] = [data.oMf[number].homogeneous for number in numbers]
    poses[:, :, :3] = machine.upright @ poses[:, :, :3]
    return poses


@final
@dataclass(frozen=True)
class _Visual:
    """One shape of the URDF with its placement, ``edges`` (2k, 3) and ``corners`` (8, 3) in the frame of its link."""

    link: str
    geometry: Any
    placement: np.ndarray
    colour: tuple[float, ...]
    edges: np.ndarray
    corners: np.ndarray

    def commands(self, node: NodePath, pale: bool = False) -> list[Any]:
        """Return the drawing commands; ``pale`` for the close-up, in which the shape is the background of the path."""
        red, green, blue, alpha = (1 - 0.2 * (1 - part) if pale else part for part in self.colour)
        # A small depth offset keeps the edges visible on the faces.
        back = {"polygonOffset": True, "polygonOffsetFactor": 1, "polygonOffsetUnits": 1}
        material = shapes.MeshLambertMaterial(color=_hex((red, green, blue)), opacity=alpha, **back)
        return [SetObject(self.geometry, material, node), SetTransform(self.placement, node)]


def _visuals(kinematics: Kinematics) -> list[_Visual]:
    machine = kinematics.machine
    model = machine.model
    refused = partial(InputError, expected="boxes, cylinders and spheres", file=machine.urdf)
    try:
        found = pin.buildGeomFromUrdf(model, str(machine.urdf), pin.GeometryType.VISUAL)
    except (ValueError, RuntimeError) as error:
        raise refused("shapes cannot be loaded", value=error) from error
    visuals = []
    for entry in found.geometryObjects:
        frame, shape, turn = model.frames[entry.parentFrame], entry.geometry, np.eye(4)
        if isinstance(shape, coal.Box):
            half = np.array(shape.halfSide)
            geometry, edges = shapes.Box((2 * half).tolist()), half * _BOX_EDGES
        elif isinstance(shape, coal.Cylinder):
            half = np.array([shape.radius, shape.radius, shape.halfLength])
            geometry = shapes.Cylinder(2 * shape.halfLength, shape.radius)
            # The axis of a cylinder is z in a URDF and y in three.js.
            turn[:3, :3] = pin.rpy.rpyToMatrix(math.pi / 2, 0.0, 0.0)
            edges = _rims(shape.radius, shape.halfLength)
        elif isinstance(shape, coal.Sphere):
            half = np.full(3, shape.radius)
            geometry, edges = shapes.Sphere(shape.radius), np.zeros((0, 3))
        else:
            raise refused(f"a shape of {frame.name} cannot be drawn", value=type(shape).__name__)
        place = (frame.placement.inverse() * entry.placement).homogeneous
        colour = tuple(float(part) for part in entry.meshColor)
        edges, corners = _moved(place, edges), _moved(place, half * _CORNERS)
        visuals.append(_Visual(str(frame.name), geometry, place @ turn, colour, edges, corners))
    return visuals


def machine_edges(kinematics: Kinematics) -> dict[str, np.ndarray]:
    """Return the edges of the machine's solids by link: (2k, 3) end points in the link's frame, m; `InputError` for other shapes."""
    visuals = _visuals(kinematics)
    links = dict.fromkeys(visual.link for visual in visuals)
    return {link: np.concatenate([visual.edges for visual in visuals if visual.link == link]) for link in links}


def _rims(radius: float, half_length: float, count: int = 40) -> np.ndarray:
    angles = 2 * np.pi * np.arange(count + 1) / count
    circle = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(count + 1)])
    up = np.array([0.0, 0.0, half_length])
    segments = np.stack([circle[:-1], circle[1:]], axis=1).reshape(-1, 3)
    return np.concatenate([segments + up, segments - up])


def _outline(visuals: list[_Visual], links: tuple[str, ...], poses: np.ndarray) -> np.ndarray:
    """Return (k, 3) outermost points of the machine over its motion, which the camera must keep in view."""
    # About fifty keyframes suffice to find the extent.
    poses = np.concatenate([poses[:: 1 + len(poses) // 50], poses[-1:]])
    points = [poses[:, :, :3, 3].reshape(-1, 3)]
    for visual in visuals:
        pose = poses[:, links.index(visual.link)]
        points.append((np.einsum("nij,kj->nki", pose[:, :3, :3], visual.corners) + pose[:, None, :3, 3]).reshape(-1, 3))
    every = np.concatenate(points)
    return np.asarray(np.unique(every[outermost(every)].round(4), axis=0))


def _machine_commands(visuals: list[_Visual], links: tuple[str, ...], work: str) -> list[Any]:
    """Return commands for the shapes and edges of the links; those of the work side are repeated for the close-up."""
    commands: list[Any] = []
    for number, visual in enumerate(visuals):
        commands += visual.commands(node_of(visual.link, f"shape{number}"))
        if visual.link == work:
            commands += visual.commands(node_of(work, f"pale{number}"), pale=True)
    for link in links:
        edges = [visual.edges for visual in visuals if visual.link == link]
        if edges:
            commands.append(lines_command(np.concatenate(edges), None, node_of(link, "edges")))
    return commands


def _tool_commands(kinematics: Kinematics, node: NodePath, dot: float) -> list[Any]:
    length = kinematics.tool_length_mm * MM
    tip = np.array([0.0, 0.0, -length])
    commands: list[Any] = []
    if length > 0:
        upright = transformations.rotation_matrix(math.pi / 2, [1, 0, 0])
        upright[:3, 3] = tip / 2
        cylinder = shapes.Cylinder(length, TOOL_RADIUS_MM * MM)
        # Drawn twice: solid on the machine, transparent in the close-up, where it must not hide the path.
        for name, opacity in (("tool", 1.0), ("ghost", 0.22)):
            material = shapes.MeshLambertMaterial(color=_TOOL, opacity=opacity, depthWrite=opacity == 1.0)
            commands += [SetObject(cylinder, material, node.append(name)), SetTransform(upright, node.append(name))]
    if dot > 0:
        ink, place = shapes.MeshBasicMaterial(color=_hex(_INK)), node.append("tip")
        commands += [
            SetObject(shapes.Sphere(dot), ink, place),
            SetTransform(transformations.translation_matrix(tip), place),
        ]
    return commands


def _path_commands(path: ScenePath, factor: float, top_um: float, node: NodePath, size: float) -> list[Any]:
    """Return commands for the path in the work frame: fine in the close-up, bold in the view of the machine of extent ``size``."""
    shown, nominal = path.shown_mm(factor) * MM, path.nominal_mm * MM
    colours = viridis(np.clip(path.deviation_um / top_um, 0.0, 1.0))
    cuts, rapids = runs(path.cutting & ~path.gaps), runs(~path.cutting & ~path.gaps)
    fine = 0.004 * path.extent_mm * MM
    commands: list[Any] = []
    grey, pale = (np.tile(colour, (len(nominal), 1)) for colour in (_NOMINAL, _RAPID))
    for name, points, tints, radius, sides, limit in (
        ("fine", shown, colours, fine, 6, MAX_POINTS),
        ("bold", shown, colours, max(fine, 0.0011 * size), 4, MAX_POINTS // 3),
        ("nominal", nominal, grey, 0.35 * fine, 3, MAX_POINTS),
    ):
        pieces = thinned(cuts, limit, path.worst)
        # For a program of ten thousand short cuts, tubes would be too large for the file and the browser.
        if sum(len(piece) for piece in pieces) > 2 * limit:
            commands.append(lines_command(*_pairs(points, tints, pieces), node.append(name)))
        elif pieces and radius > 0:
            tubes = [tube(points[piece], np.full(len(piece), radius), tints[piece], sides) for piece in pieces]
            commands.append(mesh_command(joined(tubes), node.append(name)))
    if rapids:
        lines = _pairs(nominal, pale, thinned(rapids, MAX_POINTS, path.worst))
        commands.append(lines_command(*lines, node.append("rapids")))
    blocks = [block for block in arrow_blocks(path, VECTORS) if path.deviation_um[block] > 0]
    if blocks and fine > 0:
        looks = [(1.3, _RED) if block == path.worst else (0.9, _INK) for block in blocks]
        arrows = [arrow(nominal[b], shown[b], wide * fine, ink) for b, (wide, ink) in zip(blocks, looks, strict=True)]
        commands.append(mesh_command(joined(arrows), node.append("arrows")))
    return commands


_DOT: Final = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
_DOT_FACES: Final = np.array([[a, (a + 1) % 4, 4] for a in range(4)] + [[(a + 1) % 4, a, 5] for a in range(4)])
_PROBABILITY: Final = np.array([[0.84, 0.37, 0.0], [0.90, 0.62, 0.0], [0.0, 0.62, 0.45]])
"""Colours of probabilities up to 5 %, of 50 % and from 95 % on; for all colour vision."""
_NOT_KNOWN: Final = (0.5, 0.5, 0.5)


def _feature_commands(features: Sequence[tuple[np.ndarray, float]], node: NodePath, radius_mm: float) -> list[Any]:
    """Return commands for the points of features, in the colour of their probability of conformity; grey if it is unknown."""
    dots = []
    for points, probability in features:
        known = math.isfinite(probability)
        colour = [np.interp(probability, (0.05, 0.5, 0.95), part) for part in _PROBABILITY.T] if known else _NOT_KNOWN
        vertices = (points[:, None] + radius_mm * _DOT).reshape(-1, 3) * MM
        faces = (_DOT_FACES + len(_DOT) * np.arange(len(points))[:, None, None]).reshape(-1, 3)
        dots.append(Mesh(vertices, faces, np.tile(colour, (len(vertices), 1))))
    return [mesh_command(joined(dots), node)] if dots and radius_mm > 0 else []


def _motion_commands(frames: Keyframes, links: tuple[str, ...], poses: np.ndarray) -> list[Any]:
    """Return commands for the poses of the links and the animation of the moving ones, one node per link."""
    commands: list[Any] = []
    animation = Animation()
    for number, link in enumerate(links):
        track = poses[:, number]
        commands.append(SetTransform(track[0], node_of(link)))
        if len(track) > 1 and np.ptp(track, axis=0).max() > 1e-9:
            # At one frame per second, key times are in seconds.
            times = (frames.share * SECONDS).tolist()
            clip = AnimationClip(fps=1)
            quaternions = [pin.Quaternion(pose[:3, :3]).coeffs().tolist() for pose in track]
            clip.tracks["position"] = AnimationTrack("position", "vector3", times, track[:, :3, 3].tolist())
            clip.tracks["quaternion"] = AnimationTrack("quaternion", "quaternion", times, quaternions)
            animation.clips[node_of(link)] = clip
    if animation.clips:
        commands.append(SetAnimation(animation, play=True, repetitions=1_000_000))
    return commands


def _stage_commands(box: np.ndarray) -> list[Any]:
    """Return commands for floor, lights and background; the page sets the camera, which depends on the window."""
    low, high = box
    centre, span = (low + high) / 2, high - low
    floor = NodePath(("floor",))
    thickness = 0.004 * float(np.linalg.norm(span))
    slab = shapes.Box([1.16 * span[0], 1.16 * span[1], thickness])
    return [
        SetObject(slab, shapes.MeshLambertMaterial(color=0xE3E7EB), floor),
        SetTransform(transformations.translation_matrix([centre[0], centre[1], low[2] - thickness]), floor),
        *bare_stage(),
        *(SetProperty(key, value, NodePath(("Lights", light, "<object>"))) for light, key, value in _LIGHTS),
    ]


def _pairs(points: np.ndarray, colours: np.ndarray, pieces: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    ends = np.concatenate([np.repeat(piece, 2)[1:-1] for piece in pieces])
    return points[ends], colours[ends]


def _moved(placement: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(points @ placement[:3, :3].T + placement[:3, 3])


def _hex(colour: tuple[float, float, float]) -> int:
    red, green, blue = (round(255 * part) for part in colour)
    return red << 16 | green << 8 | blue


# --- Error field as one HTML page: an arrow at every point, exaggerated by a stated factor and coloured by magnitude

LONGEST: Final = 0.12
"""Approximate length of the longest arrow, as a share of the field's extent."""
THIN: Final = 0.0035
"""Radius of an arrow, as a share of the field's extent."""
MOST_ARROWS: Final = 1500
"""Largest number of arrows that the browser of a phone rotates smoothly."""
SMALLEST: Final = 0.3
"""Smallest radius of a short arrow, as a share of the regular radius."""


def chosen_factor(points_mm: np.ndarray, errors_um: np.ndarray) -> float:
    """Return the factor that draws the largest (n, 3) error at about `LONGEST` of the field's extent: 1, 2 or 5 · 10ⁿ, n ≥ 0."""
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
    """Return the page with arrows at (n, 3) points, a labelled box and a colour bar; drag rotates it, wheel or two fingers zoom.

    ``edges`` of the box: label (or empty) and (3,) end points, mm. Raises `InputError`: no points, too many, or arrays of different
    length.
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


# --- Animate a program from a script or a notebook in one call ------------------------------------

HEIGHT_PX: Final = 600
"""Height of the frame in a notebook."""


@final
@dataclass(frozen=True, repr=False)
class Scene(DisplayedResult):
    """Animation of a machine running a program; displayed by a notebook."""

    html: str  # the self-contained page
    execution: Execution  # the simulated execution that it shows

    def save(self, path: str | Path) -> None:
        """Write the page atomically."""
        write_atomic(Path(path), self.html)

    @property
    def brief(self) -> str:
        """Size of the page, and the execution that it shows."""
        return f"animation, {len(self.html) / 1e6:.1f} MB: {self.execution.brief}"

    def display(self) -> Display:
        """Return the page in a frame."""
        return Display("Animation", below=(in_iframe(self.html, HEIGHT_PX),), small=self.execution.brief)


def draw_program(  # noqa: PLR0913
    program: str | Path,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    tool_length_mm: float | None = None,
    tcp: bool = False,
    setup: Setup | None = None,
    conditions: Conditions | None = None,
    exaggeration: float | None = None,
    language: str | None = None,
    features: Sequence[tuple[np.ndarray, float]] = (),
    progress: Progress = silent,
) -> Scene:
    """Return the animation of a machine running an NC program.

    Args:
        program: path of the program, or the name of a bundled one.
        machine: the machine it runs on.
        calibration: the machine's errors; the machine file's own if None.
        tool_length_mm: the machine file's own if None.
        tcp: whether tool centre point control (RTCP) is active from the start.
        setup: work offsets and origin; none if None.
        conditions: temperatures and time, for the effects that need them.
        exaggeration: factor of the drawn deviation; None chooses a round number.
        language: as for `twin.read_program`.
        features: (n, 3) points of each feature of a part in the work frame, mm, and its probability of conformity, NaN if unknown.
        progress: callback, called with stage and completed fraction.

    Raises:
        InputError: as `twin.compensation.programs.execute.execute_file`; no motion within the axis ranges.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> scene = twin.scene("cone_frustum.nc", machine, tool_length_mm=120)
        >>> scene.save("scene.html")  # open it in a browser
    """
    errors = Calibration.given(machine, calibration)
    progress("running", 0.0)
    run = execute_file(
        program,
        machine,
        errors,
        tool_length_mm=tool_length_mm,
        tcp=tcp,
        setup=setup,
        conditions=conditions,
        language=language,
    )
    source = find_program(program)
    if len(run.positions) < 2:
        raise InputError("no motion within the axis ranges", expected="a program with motion", file=source)
    progress("drawing", 0.5)
    page = scene_html(
        Kinematics(machine, errors, tool_length_mm=tool_length_mm, conditions=conditions),
        ScenePath(run.positions, run.meant_mm, run.reached_mm, run.cutting, run.lines, run.gaps),
        title=source.name,
        exaggeration=exaggeration,
        warnings=errors.warnings,
        omitted=run.omitted,
        features=features,
    )
    return Scene(page, run)
