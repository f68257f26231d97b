"""The thesis's identification of error motions from tracker data: the baseline with which `identify` is compared.

Ellingsdalen (2021), 3.1-3.4 and appendix B 3, for a machine with X, Y, Z on the tool side and rotary axes under the table, from a
table like ``thesis_plan.csv``. A table's targets on a side, in order of appearance, are its K, P and Q; ``approach_<axis>`` states
to which axis a row belongs. The steps, with our choice where the thesis gives none:

1. Alignment (3.1, 3.2). x is the least-squares line through X's motion of the first target, z the one through Z's, made orthogonal to
   x; all rounds together. (The thesis does not state which target, and which line is adjusted; X is the datum axis.) The thesis takes
   the origin from a circle of the rotating spindle, which tables lack. Here it is derived from the circles of the rotary axes, each
   fitted to the first target on the table (plane by least squares, circle after Kåsa), with the machine's nominal distances.
   Places of the tool side's targets, if the table has them, replace it. A rotary axis's z is its circle's normal, its x the X line in
   that plane.
2. Deviations (eq. 29, 3.3), for each round by itself: a target's nominal place is where it was first measured, moved nominally since.
3. `three_point` with six equations at every position (eq. 32, 36, 37, 3.6); mean and standard deviation over the rounds.
4. Curves (listing 3.1): the slope of the least-squares line is subtracted from a straightness, its height is not; then a polynomial, by
   default of degree 8, which above degree 1 loses the constant, that is its value at 0, as in the listing. C's polynomial is fitted up
   to its last position and is not periodic.
5. Squareness from the slopes (listing 3.2). The listing adds the angles of the two axes, both right-handed rotations; the squareness is
   their difference, which is used here. Locations of the rotary axes are not identified.

So a linear axis is determined up to a constant, and a straightness up to a line, which is squareness. Both include the orientation of
the axes at rest: E_C0Y + E_CX(0), E_A0Z + E_AY(0), E_B0Z + E_BX(0) + E_BY(0). A rotary axis is determined up to the effect of a small
fixed motion g of its circle's frame, g − Ad(R(q))·h with h such that all is zero at the first position.

The thesis's six error motions from three reflectors, position by position (Zhang and Hu 2011).

A reflector at p on a carrier with errors (e, ω) moves by Δ = e + ω × p (thesis eq. 30). Three reflectors give nine equations for
six unknowns (eq. 31, 35; 3.5 for a rotary axis, p rotated with it); the thesis selects six of them (eq. 32, 36, 37, 3.6). Both are
implemented: the six as a baseline, and all nine by least squares. Neither considers noise, stations or repeats, as `identify` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal, final

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial, polynomial

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import DEG, MM, UM, URAD
from twin.display.results import Result
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.calibration_file import MeasuredWith, MisfitEntry
from twin.model.motion_curve import Curve
from twin.model.unknown_errors import not_measured
from twin.numerics.spatial import algebraic_sphere, rigid_rates, rotation_exp

SIX: Final = {
    "X": ("Px", "Py", "Qx", "Qz", "Ky", "Kz"),
    "Y": ("Py", "Pz", "Qy", "Kx", "Kz", "Px"),
    "Z": ("Pz", "Qx", "Qz", "Ky", "Px", "Py"),
    "rotary": ("Px", "Py", "Qx", "Qz", "Ky", "Kz"),
}
"""The six equations: reflector and direction. X eq. 32, Y eq. 36, Z eq. 37, rotary eq. 3.6."""
REFLECTORS: Final = "KPQ"


def three_point(
    deviations: np.ndarray,
    places: np.ndarray,
    axis: Literal["X", "Y", "Z", "rotary"],
    *,
    equations: Literal["six", "nine"] = "six",
) -> np.ndarray:
    """Return six error motions at every position.

    ``deviations``: (m, 3, 3) measured minus nominal of reflectors K, P, Q, metres, along the axis's error frame; ``places``: (m, 3, 3)
    or (3, 3) the reflectors' nominal places in the error frame, metres; rotated with a rotary axis; ``equations``: ``six`` as the
    thesis, ``nine`` by least squares.

    Returns:
        (m, 6) translations and rotations, metres and radians.

    Raises:
        InputError: reflectors on a line, or a place that makes the six equations singular (the thesis's N = 0).
    """
    deviations = np.asarray(deviations, dtype=float)
    where = np.broadcast_to(np.asarray(places, dtype=float), deviations.shape)
    m = len(deviations)
    matrix = rigid_rates(where.reshape(-1, 3)).reshape(m, 9, 6)
    right = deviations.reshape(m, 9)
    if equations == "six":
        rows = [3 * REFLECTORS.index(name[0]) + "xyz".index(name[1]) for name in SIX[axis]]
        matrix, right = matrix[:, rows], right[:, rows]
    scale = np.array([1.0, 1.0, 1.0, *(1.0 / _size(where),) * 3])
    singular = np.linalg.svd(matrix * scale, compute_uv=False)[:, -1]
    if np.any(singular < 1e-6):
        raise InputError(
            f"the {equations} equations of {axis} do not determine six errors",
            expected="three reflectors not on a line, and at different heights along the axes that the equations use",
            value=f"smallest singular value {singular.min():.1e}",
        )
    solved = np.linalg.pinv(matrix * scale) @ right[:, :, None]
    return np.asarray(solved[:, :, 0] * scale)


def _size(places: np.ndarray) -> float:
    """Return a typical distance of the reflectors, so that rotations are scaled like translations in the rank."""
    return float(max(np.linalg.norm(places - places.mean(axis=1, keepdims=True), axis=2).max(), 1e-9))


# --- The thesis's identification of error motions from tracker data: the baseline with which `identify` is compared

DEGREE: Final = 8
"""Default degree of a curve (figure 3.7)."""
LINEAR: Final[tuple[Literal["X", "Y", "Z"], ...]] = ("X", "Y", "Z")
NO_TEST: Final = "the thesis's method does not compare its residuals with the noise of the readings"
NO_LOCATION: Final = Message("the thesis's method does not identify the location of a rotary axis")
SOURCE: Final = "thesis's method (Ellingsdalen 2021: three points, six equations, polynomial)"


@final
@dataclass(frozen=True)
class PointwiseMotion:
    """One error motion at the measured positions, before any line or curve is fitted.

    Attributes:
        name: ISO 230-1 name.
        unit: ``um`` or ``urad``.
        position: (m,) mm or degrees, in the order measured; all is zero at the first.
        mean: (m,) over the rounds.
        deviation: (m,) standard deviation over the rounds; NaN for a single one.
    """

    name: str
    unit: str
    position: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray


@final
@dataclass(frozen=True, repr=False)
class ThesisIdentification(Result):
    """Result of the thesis's method.

    ``calibration``: its curves and squareness, without uncertainty; ``motions``: the points to which the curves were fitted, by ISO
    230-1 name.
    """

    calibration: Calibration
    motions: Mapping[str, PointwiseMotion]

    @property
    def brief(self) -> str:
        """Numbers of curves and points."""
        points = sum(len(motion.mean) for motion in self.motions.values())
        return f"{self.calibration.machine.name}, by the thesis's method: {len(self.motions)} error motions, {points:,} values"


@final
@dataclass(frozen=True)
class _AxisPoints:
    """All points of one axis: (rounds, positions, K P Q, 3) in the station's frame, metres; positions in mm or degrees."""

    axis: str
    position: np.ndarray
    start: np.ndarray
    points: np.ndarray
    places: np.ndarray


@final
@dataclass(frozen=True)
class _Frame:
    """A frame relative to the station's: columns of ``turn`` are its axes, ``origin`` in metres."""

    turn: np.ndarray
    origin: np.ndarray

    def of(self, points: np.ndarray) -> np.ndarray:
        """Return points of the station's frame in this one."""
        return np.asarray((points - self.origin) @ self.turn)


def identify_as_thesis(  # noqa: C901, PLR0912
    measurements: Measurements, machine: Machine, *, degrees: Mapping[str, int] | None = None, constant: bool = False
) -> ThesisIdentification:
    """Identify error motions by the thesis's method; see the module.

    Args:
        measurements: runs of X, Y, Z with three targets on the tool side and, unless these have places, of every rotary axis with
            three on the work side; one station, x, y and z read, every target at every position once per round, ``approach_<axis>``.
        machine: the machine.
        degrees: of the polynomial, by error motion; 8 for the others.
        constant: whether polynomials above degree 1 keep their constant, which listing 3.1 drops.

    Raises:
        InputError: a machine of another design, a table without these runs, a degree too high for the number of positions, an unknown
            error motion, places that make the six equations singular.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan, truth = twin.thesis_plan.plan(machine), twin.Calibration.default(machine)
        >>> data, _ = twin.simulate(plan, machine, truth, twin.instruments.LaserTracker(), np.random.default_rng(1))
        >>> sorted(twin.identify_as_thesis(data, machine).calibration.squareness)
        ['E_A0Z', 'E_B0Z', 'E_C0Y']

    References:
        - S. H. Ellingsdalen: Improving the Accuracy of a Five-Axis Machine Tool by Laser Tracker Calibration, NTNU, 2021, 3.1 to 3.4.
        - Z. Zhang, H. Hu: Measuring geometrical errors of linear axis of machine tools based on the laser tracker, ROBIO 2011.
    """
    _check_machine(machine)
    chosen = dict(degrees or {})
    for name in chosen:
        if name not in machine.motion_names:
            raise InputError(
                "degree for an unknown error motion", expected=f"one of {', '.join(machine.motion_names)}", value=name
            )
    if len(stations := dict.fromkeys(measurements.station)) != 1:
        raise InputError(
            "several stations", expected="one station", file=measurements.source, value=", ".join(stations)
        )
    runs = {axis.name: _run(measurements, machine, axis.name) for axis in machine.axes}
    measured_runs = {axis: run for axis, run in runs.items() if run is not None}
    for name in LINEAR:
        if name not in measured_runs:
            raise InputError(f"no run of {name}", expected=f"rows with approach_{name}", file=measurements.source)
    x, z = (_direction(measured_runs[name]) for name in "XZ")
    z = _unit(z - (z @ x) * x)
    turn = np.column_stack([x, np.cross(z, x), z])
    circles = {name: _circle(run, machine, x) for name, run in measured_runs.items() if name not in LINEAR}
    if len(circles) == 1:
        raise InputError(
            f"only a run of {next(iter(circles))}", expected="runs of both rotary axes", file=measurements.source
        )
    frames: dict[str, _Frame] = {}
    origin = None
    if circles:
        frames, met, nominal_place = _closest_approach(circles, machine)
        origin = met - turn @ nominal_place
    motions: dict[str, PointwiseMotion] = {}
    for name, run in measured_runs.items():
        if name in frames:
            solved = _rotary(run, machine, frames[name])
        else:
            solved = _linear(run, machine, turn, origin, measurements.source)
        for component, values in enumerate(np.moveaxis(solved, 2, 0)):
            motion = _averaged(f"E_{DIRECTIONS[component]}{name}", component, run, values)
            motions[motion.name] = motion
    fitted = _fitted(motions, machine, chosen, constant)
    sides = [len(dict.fromkeys(measurements.target[measurements.carrier == side].tolist())) for side in CARRIERS]
    calibration = replace(
        fitted,
        simulated=measurements.simulated,
        instruments=tuple(dict.fromkeys(name for name in measurements.instrument.tolist() if name)),
        set_up=MeasuredWith(stations=1, targets_on_tool=sides[0], targets_on_work=sides[1], points=len(measurements)),
        misfit=MisfitEntry(verdict="untested", says=NO_TEST),
        not_identifiable=not_measured(machine, [*fitted.curves, *fitted.squareness], list(measured_runs), NO_LOCATION),
    )
    return ThesisIdentification(calibration, MappingProxyType(motions))


def _check_machine(machine: Machine) -> None:
    at_zero = _nominal(machine, np.zeros(len(machine.axes)))
    fits = tuple(machine.axes[i].name for i in machine.linear) == LINEAR and len(machine.rotary) in (0, 2)
    for axis in machine.axes:
        turn = at_zero[axis.name].rotation
        fits &= axis.side == ("tool" if axis.linear else "work")
        fits &= np.allclose(turn[:, 0], [1.0, 0.0, 0.0])
        if axis.linear:
            fits &= np.allclose(turn @ axis.direction, np.eye(3)[DIRECTIONS.index(axis.name)])
        else:
            fits &= abs(axis.direction[2]) == 1.0
    if not fits:
        raise InputError(
            "the thesis's method does not apply to this machine",
            expected="X, Y, Z on the tool side, rotary axes across X on the work side",
            value=machine.name,
        )


def _nominal(machine: Machine, position: np.ndarray) -> dict[str, pin.SE3]:
    """Return the nominal error frames of all axes, and the spindle nose (``tool``), in the base frame; positions in mm and degrees."""
    data = machine.model.createData()
    pin.framesForwardKinematics(machine.model, data, machine.configuration(position * machine.scale))
    found = {frame.axis: data.oMi[frame.joint] for frame in machine.frames if frame.role == "motion"}
    return found | {"tool": data.oMf[machine.tool_frame]}


def _run(table: Measurements, machine: Machine, axis: str) -> _AxisPoints | None:
    column = machine.names.index(axis)
    side = machine.by_name[axis].side
    of = table.select(np.flatnonzero((table.approach[:, column] != 0.0) & (table.carrier == side)))
    if len(of) == 0:
        return None

    def fail(what: str, expected: str, row: int = 0) -> InputError:
        return InputError(f"run of {axis}: {what}", expected=expected, file=table.source, line=int(of.lines[row]))

    targets, rounds = list(dict.fromkeys(of.target)), list(dict.fromkeys(of.round))
    if len(targets) != len(REFLECTORS):
        raise fail(f"targets {', '.join(targets)}", "three targets")
    others = np.delete(of.positions, column, axis=1)
    moved = np.flatnonzero(np.any(others != others[0], axis=1))
    if len(moved):
        raise fail("another axis moved too", "the other axes at rest", int(moved[0]))
    position = np.array(list(dict.fromkeys(of.positions[:, column].tolist())))
    points = np.full((len(rounds), len(position), len(targets), 3), np.nan)
    for row, (target, number, value) in enumerate(zip(of.target, of.round, of.positions[:, column], strict=True)):
        place = (rounds.index(number), int(np.flatnonzero(position == value)[0]), targets.index(target))
        if not np.isnan(points[place]).any():
            raise fail(f"target {target} twice at {value:g} in round {number}", "once per round", row)
        if not np.isfinite(of.point_mm[row]).all():
            raise fail("a coordinate that was not measured", "x, y and z", row)
        points[place] = of.point_mm[row] * MM
    for number, q, target in np.argwhere(np.isnan(points[..., 0])):
        what = f"round {rounds[number]} lacks target {targets[target]} at {position[q]:g}"
        raise fail(what, "every target at every position in every round")
    places = np.array([of.place_mm[of.target == target][0] * MM for target in targets])
    return _AxisPoints(axis, position, of.positions[0], points, places)


def _direction(run: _AxisPoints) -> np.ndarray:
    """Return the unit vector along which the first target moves, by least squares, in the direction of increasing commands."""
    points = run.points[:, :, 0].reshape(-1, 3)
    command = np.tile(run.position - run.position.mean(), len(run.points))
    along = np.linalg.svd(points - points.mean(axis=0))[2][0]
    return np.asarray(along * np.sign(command @ (points @ along)))


def _circle(run: _AxisPoints, machine: Machine, x: np.ndarray) -> _Frame:
    """Return a rotary axis's frame from the circle of its first target; its origin is in the circle's plane."""
    points = run.points[:, :, 0].reshape(-1, 3)
    centroid = points.mean(axis=0)
    z = np.linalg.svd(points - centroid)[2][2]
    x = _unit(x - (x @ z) * z)
    flat = (points - centroid) @ np.column_stack([x, np.cross(z, x)])
    found, _ = algebraic_sphere(flat)
    centre = centroid + found[0] * x + found[1] * np.cross(z, x)
    arms = run.points[0, np.argsort(run.position), 0] - centre
    sense = np.sum(np.cross(arms[:-1], arms[1:]) @ z) * machine.by_name[run.axis].direction[2]
    z = z * np.sign(sense)
    return _Frame(np.column_stack([x, np.cross(z, x), z]), centre)


def _closest_approach(
    circles: Mapping[str, _Frame], machine: Machine
) -> tuple[dict[str, _Frame], np.ndarray, np.ndarray]:
    """Return frames of two rotary axes with origins in the nominal places, and their point of closest approach in both frames.

    Returns:
        Frames by axis; the point of closest approach in the station's frame; its nominal place in the base frame; metres.
    """
    nominal = _nominal(machine, np.zeros(len(machine.axes)))
    a, b = circles
    lines = [(circles[name].origin, circles[name].turn[:, 2]) for name in (a, b)]
    nominal_lines = [(nominal[name].translation, nominal[name].rotation[:, 2]) for name in (a, b)]
    met, nominal_place = _closest(*lines), _closest(*nominal_lines)
    frames = {
        name: _Frame(circles[name].turn, origin + (along - along_meant) * z)
        for name, (origin, z), along, along_meant in zip((a, b), lines, met, nominal_place, strict=True)
    }
    points = [
        np.mean([origin + along * z for (origin, z), along in zip(pair, by, strict=True)], axis=0)
        for pair, by in ((lines, met), (nominal_lines, nominal_place))
    ]
    return frames, points[0], points[1]


def _closest(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return (2,) the distances along two lines (origin, unit vector) to their points of closest approach."""
    return np.asarray(np.linalg.lstsq(np.column_stack([first[1], -second[1]]), second[0] - first[0], rcond=None)[0])


def _linear(run: _AxisPoints, machine: Machine, turn: np.ndarray, origin: np.ndarray | None, source: str) -> np.ndarray:
    """Return (rounds, m, 6) the error motions of a linear axis.

    ``origin``: the base frame's origin there, or None if only the table gives the places of the targets.
    """
    nominal = _nominal(machine, run.start)
    frame = nominal[run.axis]
    travel = (run.position - run.position[0])[:, None] * MM * (frame.rotation @ machine.by_name[run.axis].direction)
    deviations = ((run.points - run.points[:, :1]) @ turn - travel[:, None]) @ frame.rotation
    if np.isfinite(run.places).all():
        places = np.array([frame.actInv(nominal["tool"].act(place)) for place in run.places])
        arms = np.broadcast_to(places, (len(run.points), *places.shape))
    elif origin is not None:
        arms = ((run.points[:, 0] - origin) @ turn - frame.translation) @ frame.rotation
    else:
        raise InputError(
            "places of the tool side's targets are unknown",
            expected="runs of the rotary axes, or place_x_mm, place_y_mm, place_z_mm",
            file=source,
        )
    which: dict[str, Literal["X", "Y", "Z"]] = {"X": "X", "Y": "Y", "Z": "Z"}
    return np.array([three_point(d, arm, which[run.axis]) for d, arm in zip(deviations, arms, strict=True)])


def _rotary(run: _AxisPoints, machine: Machine, frame: _Frame) -> np.ndarray:
    """Return (rounds, m, 6) the error motions of a rotary axis, along its error frame, which does not rotate."""
    points = frame.of(run.points)
    angle = (run.position - run.position[0]) * DEG * machine.by_name[run.axis].direction[2]
    turns = rotation_exp(angle[:, None] * [0.0, 0.0, 1.0])
    nominal = np.einsum("mij,rkj->rmki", turns, points[:, 0])
    return np.array([three_point(d, arms, "rotary") for d, arms in zip(points - nominal, nominal, strict=True)])


def _averaged(name: str, component: int, run: _AxisPoints, values: np.ndarray) -> PointwiseMotion:
    unit, scale = ("um", UM) if component < 3 else ("urad", URAD)
    deviation = values.std(axis=0, ddof=1) if len(values) > 1 else np.full(len(run.position), np.nan)
    mean = values.mean(axis=0)
    return PointwiseMotion(
        name, unit, read_only(np.array(run.position)), read_only(mean / scale), read_only(deviation / scale)
    )


def _fitted(
    motions: Mapping[str, PointwiseMotion], machine: Machine, degrees: Mapping[str, int], constant: bool
) -> Calibration:
    """Return the calibration by listing 3.1 on every motion, and 3.2 on the slopes."""
    curves, slopes = {}, {}
    for name, motion in motions.items():
        axis = machine.by_name[name[3:]]
        q, values = motion.position, motion.mean
        if axis.linear and name[2] in "XYZ" and name[2] != name[3]:
            slopes[name] = float(polynomial.polyfit(q, values, 1)[1])
            values = values - slopes[name] * q
        domain = axis.domain
        degree = degrees.get(name, DEGREE)
        if not 0 <= degree < len(q):
            raise InputError(f"degree of {name}", expected=f"0 to {len(q) - 1}, for {len(q)} positions", value=degree)
        # The listing fits in mm; the same polynomial in u is better conditioned.
        u = Polynomial([-(domain[0] + domain[1]), 2.0]) / (domain[1] - domain[0])
        coefficients = polynomial.polyfit(u(q), values, degree)
        if degree > 1 and not constant:
            coefficients[0] -= polynomial.polyval(u(0.0), coefficients)
        curves[name] = Curve(name, motion.unit, domain, "power", tuple(float(c) for c in coefficients), source=SOURCE)
    # The rotation of one axis's line minus that of the other's, both right-handed: a falling E_XY is a rotation of Y about +z.
    squareness = {
        "E_C0Y": -1e3 * (slopes["E_XY"] + slopes["E_YX"]),
        "E_A0Z": -1e3 * (slopes["E_YZ"] + slopes["E_ZY"]),
        "E_B0Z": 1e3 * (slopes["E_XZ"] + slopes["E_ZX"]),
    }
    nothing: Mapping[str, float] = MappingProxyType({})
    return Calibration(machine, SOURCE, MappingProxyType(curves), MappingProxyType(squareness), nothing)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.linalg.norm(vector))
