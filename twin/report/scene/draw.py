"""A program on its machine as one HTML page: headless, self-contained, no network and no server.

The page is meshcat's viewer with meshcat's own drawing commands embedded, as its ``static_html`` embeds them. That one
asks a server process for them; here they are collected straight from meshcat's classes, so none is started. Inside this
module everything is in metres; the path and its deviations come in mm.
"""

from __future__ import annotations

import base64
import html
import importlib.resources
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import meshcat.geometry as shapes
import numpy as np
import pinocchio as pin
import umsgpack
from meshcat import transformations
from meshcat.animation import Animation, AnimationClip, AnimationTrack
from meshcat.commands import SetAnimation, SetObject, SetProperty, SetTransform
from meshcat.path import Path as NodePath

from twin._common.errors import InputError
from twin._common.provenance import SourceWarning, texts
from twin._common.units import MM
from twin.kinematics.forward import Kinematics
from twin.report.scene.camera import CAMERA
from twin.report.scene.page import PAGE
from twin.report.scene.path import (
    MAX_POINTS,
    Keyframes,
    Mesh,
    ScenePath,
    arrow,
    arrow_blocks,
    chosen_exaggeration,
    joined,
    keyframes,
    runs,
    scale_top_um,
    thinned,
    tube,
    viridis,
)

__all__ = ["ScenePath", "scene_html"]

_FIRST_LINK = "machine"
_EDGE = 0x4A525C
_NOMINAL = (0.42, 0.45, 0.49)
_RAPID = (0.72, 0.78, 0.86)
_INK = (0.13, 0.14, 0.17)
_RED = (0.84, 0.10, 0.12)
_TOOL = 0xC9A227


def scene_html(
    kinematics: Kinematics,
    path: ScenePath,
    *,
    title: str,
    exaggeration: float | None = None,
    vectors: int = 24,
    seconds: float = 20.0,
    tool_radius_mm: float = 5.0,
    warnings: Sequence[SourceWarning] = (),
) -> str:
    """The page: the machine moving through a program, and the tool path with its deviation exaggerated and coloured.

    Args:
        kinematics: the machine with the errors it is shown with, and the tool's length.
        path: the motion; positions in mm and degrees, points in mm in the work frame.
        title: headline, plain text.
        exaggeration: factor on the deviation; None picks a round one that shows it well.
        vectors: at how many points the deviation is drawn as an arrow.
        seconds: duration of the animation.
        tool_radius_mm: radius the tool is drawn with.
        warnings: of where the calibration comes from; the page shows them.

    Returns:
        The page's text, some megabytes.

    Raises:
        InputError: the path does not fit the machine, a number is out of range, or the URDF has shapes that cannot be drawn.
    """
    machine = kinematics.machine
    path.check(len(machine.axes))
    given = (("exaggeration", exaggeration), ("seconds", seconds), ("tool_radius_mm", tool_radius_mm))
    for name, value in given:
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} out of range", expected="a positive number", value=value)
    if vectors < 0:
        raise InputError("vectors out of range", expected="0 or more", value=vectors)
    factor = chosen_exaggeration(path) if exaggeration is None else exaggeration
    top_um = scale_top_um(path.max_um)

    frames = keyframes(path, machine.linear, machine.rotary)
    visuals = _visuals(kinematics)
    tool = str(machine.model.frames[machine.tool_frame].name)
    work = str(machine.model.frames[machine.work_frame].name)
    links = tuple(dict.fromkeys([*(visual.link for visual in visuals), tool, work]))
    poses = link_poses(kinematics, frames.positions, links)
    outline = _outline(visuals, links, poses)
    box = np.array([outline.min(axis=0), outline.max(axis=0)])
    size = float(np.linalg.norm(box[1] - box[0]))

    commands: list[Any] = []
    for number, visual in enumerate(visuals):
        commands += visual.commands(node_of(visual.link, f"shape{number}"))
        if visual.link == work:
            commands += visual.commands(node_of(work, f"pale{number}"), pale=True)
    for link in links:
        edges = [visual.edges for visual in visuals if visual.link == link]
        if edges:
            commands.append(lines_command(np.concatenate(edges), None, node_of(link, "edges")))
    commands += _tool_commands(kinematics, node_of(tool), tool_radius_mm * MM, 0.008 * path.extent_mm * MM)
    commands += _path_commands(path, factor, top_um, vectors, node_of(work), size)
    commands += _motion_commands(frames, links, poses, seconds)
    commands += _stage_commands(box)

    worst = path.shown_mm(factor)[path.worst] * MM
    shown = np.concatenate([path.nominal_mm[path.judged], path.shown_mm(factor)[path.judged]]) * MM
    page: dict[str, Any] = {
        "outline": outline.tolist(),
        "pathOutline": (np.where(_CORNERS > 0, shown.max(axis=0), shown.min(axis=0))).round(6).tolist(),
        "work": _FIRST_LINK + "/" + work,
        "tool": _FIRST_LINK + "/" + tool,
        "worst": {"at": worst.round(6).tolist(), "um": short(path.max_um), "line": int(path.lines[path.worst])},
        "seconds": seconds,
        "axes": [{"name": axis.name, "unit": "mm" if axis.linear else "°"} for axis in machine.axes],
        "share": frames.share.round(6).tolist(),
        "q": frames.positions.round(3).tolist(),
        "um": frames.deviation_um.round(2).tolist(),
        "line": path.lines[frames.block].astype(int).tolist(),
        "cutting": path.cutting[frames.block].astype(int).tolist(),
    }
    return PAGE.substitute(
        title=html.escape(title),
        camera=CAMERA,
        machine=html.escape(machine.name),
        viewer=viewer_source(),
        commands=json.dumps([packed(command) for command in commands]),
        page=json.dumps(page).replace("</", "<\\/"),
        **colour_bar(top_um),
        factor=short(factor),
        max_um=short(path.max_um),
        rms_um=short(path.rms_um),
        max_line=int(path.lines[path.worst]),
        what="cutting moves" if np.any(path.cutting) else "all moves",
        notice="".join(f'<p class="notice">{html.escape(text)}</p>' for text in texts(warnings)),
        still="" if len(frames.share) > 1 else "still",
    )


def link_poses(kinematics: Kinematics, positions: np.ndarray, links: tuple[str, ...]) -> np.ndarray:
    """(n, links, 4, 4) poses of links in the base frame, metres, on the machine with its errors.

    Args:
        kinematics: machine and errors.
        positions: (n, axes) commands in mm and degrees.
        links: names of links in the URDF.
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
    return poses


@dataclass(frozen=True)
class _Visual:
    """One shape of the URDF, placed in its link's frame; ``edges`` (2k, 3) and ``corners`` (8, 3) in that frame too."""

    link: str
    geometry: Any
    placement: np.ndarray
    colour: tuple[float, float, float, float]
    edges: np.ndarray
    corners: np.ndarray

    def commands(self, node: NodePath, pale: bool = False) -> list[Any]:
        """Drawing commands; ``pale`` for the close-up, where it is only the ground the path is seen against."""
        red, green, blue, alpha = (1 - 0.2 * (1 - part) if pale else part for part in self.colour)
        material = shapes.MeshLambertMaterial(
            color=_hex((red, green, blue)),
            opacity=alpha,
            # Pushed back a hair, so that the edges drawn on the faces win.
            polygonOffset=True,
            polygonOffsetFactor=1,
            polygonOffsetUnits=1,
        )
        return [SetObject(self.geometry, material, node), SetTransform(self.placement, node)]


def _visuals(kinematics: Kinematics) -> list[_Visual]:
    machine = kinematics.machine
    model = machine.model
    try:
        found = pin.buildGeomFromUrdf(model, str(machine.urdf), pin.GeometryType.VISUAL)
    except (ValueError, RuntimeError) as error:
        raise InputError(
            "shapes that cannot be loaded", expected="boxes, cylinders and spheres", file=machine.urdf, value=error
        ) from error
    visuals = []
    for entry in found.geometryObjects:
        frame = model.frames[entry.parentFrame]
        placement = (frame.placement.inverse() * entry.placement).homogeneous
        shape = entry.geometry
        turn = np.eye(4)
        if isinstance(shape, coal.Box):
            half = np.array(shape.halfSide)
            geometry = shapes.Box((2 * half).tolist())
            edges = _box_edges(half)
        elif isinstance(shape, coal.Cylinder):
            half = np.array([shape.radius, shape.radius, shape.halfLength])
            geometry = shapes.Cylinder(2 * shape.halfLength, shape.radius)
            # URDF's cylinder stands along z, that of three.js along y.
            turn[:3, :3] = pin.rpy.rpyToMatrix(math.pi / 2, 0.0, 0.0)
            edges = _rims(shape.radius, shape.halfLength)
        elif isinstance(shape, coal.Sphere):
            half = np.full(3, shape.radius)
            geometry = shapes.Sphere(shape.radius)
            edges = np.zeros((0, 3))
        else:
            raise InputError(
                f"a shape of {frame.name} that cannot be drawn",
                expected="boxes, cylinders and spheres",
                file=machine.urdf,
                value=type(shape).__name__,
            )
        corners = half * _CORNERS
        red, green, blue, alpha = (float(part) for part in entry.meshColor)
        colour = (red, green, blue, alpha)
        visuals.append(
            _Visual(
                str(frame.name),
                geometry,
                placement @ turn,
                colour,
                _moved(placement, edges),
                _moved(placement, corners),
            )
        )
    return visuals


_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def _box_edges(half: np.ndarray) -> np.ndarray:
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.sum(_CORNERS[a] != _CORNERS[b]) == 1]
    return half * _CORNERS[np.array(pairs).ravel()]


def _rims(radius: float, half_length: float, count: int = 40) -> np.ndarray:
    angles = 2 * np.pi * np.arange(count + 1) / count
    circle = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(count + 1)])
    up = np.array([0.0, 0.0, half_length])
    segments = np.stack([circle[:-1], circle[1:]], axis=1).reshape(-1, 3)
    return np.concatenate([segments + up, segments - up])


def _outline(visuals: list[_Visual], links: tuple[str, ...], poses: np.ndarray) -> np.ndarray:
    """(k, 3) points of the machine, over its motion, that lie farthest out, for the camera to keep in view."""
    # Some fifty moments are enough to frame a picture.
    poses = np.concatenate([poses[:: 1 + len(poses) // 50], poses[-1:]])
    points = [poses[:, :, :3, 3].reshape(-1, 3)]
    for visual in visuals:
        pose = poses[:, links.index(visual.link)]
        points.append((np.einsum("nij,kj->nki", pose[:, :3, :3], visual.corners) + pose[:, None, :3, 3]).reshape(-1, 3))
    every = np.concatenate(points)
    ways = np.array(
        [(x, y, z) for x in (-2, -1, 0, 1, 2) for y in (-2, -1, 0, 1, 2) for z in (-2, -1, 0, 1, 2)], dtype=float
    )
    return np.asarray(np.unique(every[np.argmax(every @ ways.T, axis=0)].round(4), axis=0))


def _tool_commands(kinematics: Kinematics, node: NodePath, radius: float, dot: float) -> list[Any]:
    length = kinematics.tool_length_mm * MM
    tip = np.array([0.0, 0.0, -length])
    commands: list[Any] = []
    if length > 0:
        upright = transformations.rotation_matrix(math.pi / 2, [1, 0, 0])
        upright[:3, 3] = tip / 2
        # Twice: solid on the machine, a ghost in the close-up, where it must not hide the path.
        for name, opacity in (("tool", 1.0), ("ghost", 0.22)):
            material = shapes.MeshLambertMaterial(color=_TOOL, opacity=opacity, depthWrite=opacity == 1.0)
            commands += [
                SetObject(shapes.Cylinder(length, radius), material, node.append(name)),
                SetTransform(upright, node.append(name)),
            ]
    if dot > 0:
        commands += [
            SetObject(shapes.Sphere(dot), shapes.MeshBasicMaterial(color=_hex(_INK)), node.append("tip")),
            SetTransform(transformations.translation_matrix(tip), node.append("tip")),
        ]
    return commands


def _path_commands(
    path: ScenePath, factor: float, top_um: float, vectors: int, node: NodePath, size: float
) -> list[Any]:
    """The path in the work frame, twice: fine for the close-up, bold for the view of the whole machine (``size`` across)."""
    shown = path.shown_mm(factor) * MM
    nominal = path.nominal_mm * MM
    colours = viridis(np.clip(path.deviation_um / top_um, 0.0, 1.0))
    cuts, rapids = runs(path.cutting, True), runs(path.cutting, False)
    fine = 0.004 * path.extent_mm * MM
    bold = max(fine, 0.0011 * size)
    commands: list[Any] = []
    grey, pale = (np.tile(colour, (len(nominal), 1)) for colour in (_NOMINAL, _RAPID))
    for name, points, tints, radius, sides, limit in (
        ("fine", shown, colours, fine, 6, MAX_POINTS),
        ("bold", shown, colours, bold, 4, MAX_POINTS // 3),
        ("nominal", nominal, grey, 0.35 * fine, 3, MAX_POINTS),
    ):
        pieces = thinned(cuts, limit, path.worst)
        # A program of ten thousand short cuts has too many ends for tubes, in a file and in a browser.
        if sum(len(piece) for piece in pieces) > 2 * limit:
            commands.append(lines_command(*_pairs(points, tints, pieces), node.append(name)))
        elif pieces and radius > 0:
            tubes = [tube(points[piece], np.full(len(piece), radius), tints[piece], sides) for piece in pieces]
            commands.append(mesh_command(joined(tubes), node.append(name)))
    if rapids:
        commands.append(
            lines_command(*_pairs(nominal, pale, thinned(rapids, MAX_POINTS, path.worst)), node.append("rapids"))
        )
    blocks = [block for block in arrow_blocks(path, vectors) if path.deviation_um[block] > 0]
    if blocks and fine > 0:
        arrows = [
            arrow(
                nominal[block],
                shown[block],
                (1.3 if block == path.worst else 0.9) * fine,
                _RED if block == path.worst else _INK,
            )
            for block in blocks
        ]
        commands.append(mesh_command(joined(arrows), node.append("arrows")))
    return commands


def _motion_commands(frames: Keyframes, links: tuple[str, ...], poses: np.ndarray, seconds: float) -> list[Any]:
    """Poses of the links, and the animation of those that move: one node a link, whatever it consists of."""
    commands: list[Any] = []
    animation = Animation()
    for number, link in enumerate(links):
        track = poses[:, number]
        commands.append(SetTransform(track[0], node_of(link)))
        if len(track) > 1 and np.ptp(track, axis=0).max() > 1e-9:
            # With one frame a second the keys' times are seconds.
            times = (frames.share * seconds).tolist()
            clip = AnimationClip(fps=1)
            quaternions = [pin.Quaternion(pose[:3, :3]).coeffs().tolist() for pose in track]
            clip.tracks["position"] = AnimationTrack("position", "vector3", times, track[:, :3, 3].tolist())
            clip.tracks["quaternion"] = AnimationTrack("quaternion", "quaternion", times, quaternions)
            animation.clips[node_of(link)] = clip
    if animation.clips:
        commands.append(SetAnimation(animation, play=True, repetitions=1_000_000))
    return commands


def _stage_commands(box: np.ndarray) -> list[Any]:
    """Floor, light and background; the page sets the camera, which depends on the window."""
    low, high = box
    centre, span = (low + high) / 2, high - low
    floor = NodePath(("floor",))
    thickness = 0.004 * float(np.linalg.norm(span))
    slab = shapes.Box([1.16 * span[0], 1.16 * span[1], thickness])
    lights: dict[str, dict[str, Any]] = {
        "AmbientLight": {"intensity": 0.6},
        "FillLight": {"intensity": 0.38, "position": [-2.0, -5.0, 4.0]},
        "PointLightNegativeX": {"visible": False},
        # The second point light stands in for the bounce from the floor, far enough to be even.
        "PointLightPositiveX": {"intensity": 0.16, "position": [4.0, -3.0, 1.0], "distance": 0.0},
    }
    return [
        SetObject(slab, shapes.MeshLambertMaterial(color=0xE3E7EB), floor),
        SetTransform(transformations.translation_matrix([centre[0], centre[1], low[2] - thickness]), floor),
        *bare_stage(),
        *(
            SetProperty(key, value, NodePath(("Lights", light, "<object>")))
            for light, entries in lights.items()
            for key, value in entries.items()
        ),
    ]


def bare_stage() -> list[Any]:
    """Commands that take away what the viewer shows by itself."""
    return [SetProperty("visible", False, NodePath((name,))) for name in ("Grid", "Axes", "Background")]


def mesh_command(mesh: Mesh, node: NodePath) -> SetObject:
    """Draws a mesh, metres."""
    # Unlit, so that a colour in the picture is the colour of the legend.
    return SetObject(
        shapes.TriangularMeshGeometry(mesh.vertices, mesh.faces, mesh.colours),
        shapes.MeshBasicMaterial(vertexColors=True),
        node,
    )


def lines_command(segments: np.ndarray, colours: np.ndarray | None, node: NodePath) -> SetObject:
    """(2k, 3) ends of segments with their colours; the colour of edges where none are given."""
    ends = segments.astype(np.float32).T
    if colours is None:
        drawn = shapes.PointsGeometry(ends), shapes.LineBasicMaterial(color=_EDGE, opacity=0.55)
    else:
        drawn = shapes.PointsGeometry(ends, colours.astype(np.float32).T), shapes.LineBasicMaterial(vertexColors=True)
    return SetObject(shapes.LineSegments(*drawn), path=node)


def _pairs(points: np.ndarray, colours: np.ndarray, pieces: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Ends of all segments of all runs, and their colours."""
    ends = np.concatenate([np.repeat(piece, 2)[1:-1] for piece in pieces])
    return points[ends], colours[ends]


def packed(command: Any) -> str:
    """A drawing command as the viewer takes it: msgpack in base64. Names of objects are fixed: same input, same page."""
    data = command.lower()
    if isinstance(command, SetObject):
        entry = data["object"]
        for kind, mark in (("geometries", "geometry"), ("materials", "material")):
            entry[kind][0]["uuid"] = entry["object"][mark] = mark
        entry["object"]["uuid"] = data["path"]
    # Single precision: 0.1 µm at a metre, below anything to be seen, and half the size.
    return base64.b64encode(umsgpack.packb(_plain(data), force_float_precision="single")).decode("ascii")


def _plain(data: Any) -> Any:
    """The same with NumPy's numbers as Python's, which is all msgpack knows."""
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data] if not isinstance(data, umsgpack.Ext) else data
    return data.item() if isinstance(data, np.generic) else data


def node_of(*names: str) -> NodePath:
    """A place in the viewer's tree."""
    return NodePath(("meshcat", _FIRST_LINK, *names))


def _moved(placement: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(points @ placement[:3, :3].T + placement[:3, 3])


def _hex(colour: tuple[float, float, float]) -> int:
    red, green, blue = (round(255 * part) for part in colour)
    return red << 16 | green << 8 | blue


def colour_bar(top: float) -> dict[str, str]:
    """What a page's colour bar from 0 to ``top`` is made of: its CSS gradient, and the numbers below it."""
    colours = viridis(np.linspace(0.0, 1.0, 17))
    return {
        "gradient": ", ".join(f"rgb({', '.join(str(round(255 * c)) for c in colour)})" for colour in colours),
        "ticks": "".join(f"<span>{short(top * share / 4)}</span>" for share in range(5)),
    }


def short(value: float) -> str:
    """A number with three significant digits, and no exponent."""
    if value == 0 or not 1e-3 <= abs(value) < 1e9:
        return "0" if value == 0 else f"{value:.2g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else f"{int(text):,}".replace(",", "\u202f")


def viewer_source() -> str:
    """The viewer of meshcat, as one script."""
    file = importlib.resources.files("meshcat") / "viewer" / "dist" / "main.min.js"
    return file.read_text(encoding="utf-8")
