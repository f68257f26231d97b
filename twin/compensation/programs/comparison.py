"""Comparison of real and nominal tool poses at many points on straight lines of commands.

The baseline, the method of Ellingsdalen (2021), subtracts the deviation once and does not invert the kinematics. The properties of the
listings 3.1 to 3.4 are reproduced, mistakes included, because the published figure 3.11 was made with them:

- a fitted polynomial of degree above one loses its constant (listing 3.1);
- curves are read at the nearest whole mm or degree; Z's table is indexed from its far end (listings 3.3, 3.4);
- angular errors of the linear axes are omitted (eq. 3.40);
- E_BB is read for E_CB and E_BC for E_CC, the rotation about y has the wrong sign, and the errors of both rotary axes stand before
  the whole chain instead of at their joints (listing 3.3);
- axis locations are not included.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import rows_all_true
from twin._common.errors import InputError
from twin._common.resources import builds_expressions
from twin._common.units import MM, UM, URAD
from twin.compute.along import AlongFunction, BatchFunction, Totals, fractions
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve
from twin.tool.forward import Kinematics

SLACK: Final = 1e-9
"""Distance (mm, degrees) beyond a curve's domain that is rounding, as in `twin.model.calibration.Calibration.outside`."""
MIDDLE: Final = np.full(1, 0.5)
"""The fraction of a line without displacement: any."""
QUANTITIES: Final = 4
"""Quantities of a pose whose totals are kept: distance (µm), angle between the tool axes and its tilts (µrad)."""
UNITS: Final = np.array([MM / UM, *[1.0 / URAD] * 3])
"""These for each mm and radian, in which rounding errors are compared."""


@final
@dataclass(frozen=True)
class Commands:
    """Commands, mm and degrees, at points on straight lines; or one point for each line, its begin."""

    begin: np.ndarray  # (lines, axes) start of each line
    way: np.ndarray | None = None  # (lines, axes) displacement along each line; None for single points
    # (lines,) number of points, at fractions (k + ½)/n of the line; None for single points
    points: np.ndarray | None = None
    # function from (n, axes) words of the tool tip to commands, if the lines are straight lines of such words; else None
    converted: Callable[[np.ndarray], np.ndarray] | None = None

    @property
    def counts(self) -> np.ndarray:
        """(lines,) number of points of each line."""
        return np.ones(len(self.begin), dtype=int) if self.points is None else self.points

    def of(self, lines: np.ndarray) -> Commands:
        """Return the points of some lines: indices or (lines,) booleans."""
        way, points = (None if array is None else array[lines] for array in (self.way, self.points))
        return Commands(self.begin[lines], way, points, self.converted)

    def split(self, line: np.ndarray, share: np.ndarray) -> Commands:
        """Return the points as lines of their own where `split_lines` says so; single points as they are."""
        if self.way is None or self.points is None:
            return self
        whole = np.isnan(share)
        begin = self.begin[line] + np.where(whole, 0.0, share)[:, None] * self.way[line]
        way = np.where(whole[:, None], self.way[line], 0.0)
        return Commands(begin, way, np.where(whole, self.points[line], 1), self.converted)

    def as_array(self) -> np.ndarray:
        """Return the commands at all points, (n, axes)."""
        if self.way is None or self.points is None:
            return np.asarray(self.begin)
        line = np.repeat(np.arange(len(self.begin)), self.points)
        commands = np.asarray(self.begin[line] + fractions(self.points)[:, None] * self.way[line])
        return commands if self.converted is None else self.converted(commands)

    @property
    def inputs(self) -> tuple[np.ndarray, np.ndarray]:
        """Begin and displacement."""
        return self.begin, np.zeros(self.begin.shape[1]) if self.way is None else self.way


def split_lines(points: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lines in which points of some are lines of their own: (n,) line each is from, (n,) fraction of it, NaN if whole.

    ``points``: (lines,) number of points of each line; ``which``: (lines,) whether its points become lines.
    """
    counts = np.where(which, points, 1)
    line = np.repeat(np.arange(len(points)), counts)
    return line, np.where(which[line], fractions(counts), np.nan)


@final
@dataclass(frozen=True)
class ComparedPoses:
    """Deviations of tool poses from nominal ones."""

    distance_mm: np.ndarray  # (n,) distance between the functional points
    angle_rad: np.ndarray  # (n,) angle between the tool axes
    known: np.ndarray  # (n,) whether the commands are finite and within the domains of all curves of the machine


@final
class PoseComparison:
    """Compares poses of a machine with errors with nominal ones.

    ``of_words``: commands as an expression of words of the tip; ``like``: the comparison of the same machines for other words, whose
    functions of commands are shared.
    """

    def __init__(
        self,
        real: Kinematics,
        nominal: Kinematics,
        of_words: Callable[[Any], Any] = lambda words: words,
        like: PoseComparison | None = None,
    ) -> None:
        self._real, self._nominal, self._of_words, self._like = real, nominal, of_words, like
        self._along: dict[tuple[str, bool, bool], AlongFunction] = {}

    def distance_mm(self, nominal: Commands, commanded: Commands, approach: np.ndarray | None = None) -> np.ndarray:
        """Return (lines,) the largest distance between the functional points on each line; 0 on a line without points."""
        inputs = (*nominal.inputs, *commanded.inputs, *self._sides(approach))
        return self._function(self._distance, nominal, commanded).largest(inputs, nominal.counts)

    def poses(self, nominal: np.ndarray, commanded: np.ndarray, approach: np.ndarray | None = None) -> ComparedPoses:
        """Return the deviations in point and orientation at (n, axes) nominal and given commands."""
        still = np.zeros(nominal.shape[1])
        inputs = (nominal, still, commanded, still, *self._sides(approach), MIDDLE)
        distance, angle, beyond = (column[:, 0] for column in self._poses(*inputs))
        return ComparedPoses(distance, angle, np.isfinite(distance) & (beyond <= SLACK))

    def known(self, commanded: np.ndarray) -> np.ndarray:
        """Return (n,) whether (n, axes) commands are finite and within the domains of all curves, as `ComparedPoses.known`."""
        return rows_all_true(np.isfinite(commanded) & ~self._real.calibration.outside_domains(commanded))

    def totals(
        self, nominal: Commands, written: Commands, before: np.ndarray | None, after: np.ndarray | None
    ) -> tuple[Totals, Totals]:
        """Return the totals of `QUANTITIES` with nominal and with written commands, where the poses of both are known."""
        inputs = (*nominal.inputs, *written.inputs, *self._sides(before), *self._sides(after))
        both = self._function(self._totals, nominal, written).totals(inputs, nominal.counts, SLACK)
        parts = (slice(0, QUANTITIES), slice(QUANTITIES, None))
        first, last = (
            Totals(both.count, both.squares[p] * UNITS**2, both.largest[p, p] * UNITS, both.line[p]) for p in parts
        )
        return first, last

    def _sides(self, approach: np.ndarray | None) -> tuple[np.ndarray, ...]:
        if not self._real.directed:
            return ()
        return (np.zeros(len(self._real.machine.axes)) if approach is None else approach,)

    @builds_expressions
    def _function(self, make: Callable[..., ca.Function], nominal: Commands, given: Commands) -> AlongFunction:
        """Return a function for lines of commands or of words, made when first needed."""
        words = nominal.converted is not None, given.converted is not None
        if self._like is not None and not any(words):
            return self._like._function(getattr(self._like, make.__name__), nominal, given)
        key = make.__name__, *words
        if key not in self._along:
            self._along[key] = AlongFunction(make(*words))
        return self._along[key]

    def _distance(self, *words: bool) -> ca.Function:
        inputs, meant, given, share = self._symbols(*words)
        sides = self._real.symbols()[1:]
        distance, _, _ = self._compared(meant, given, sides)
        return ca.Function("distance", [*inputs, *sides, share], [distance])

    @cached_property
    @builds_expressions
    def _poses(self) -> BatchFunction:
        if self._like is not None:
            return self._like._poses
        inputs, meant, given, share = self._symbols(False, False)
        sides = self._real.symbols()[1:]
        distance, (angle, *_), beyond = self._compared(meant, given, sides)
        return BatchFunction(ca.Function("poses", [*inputs, *sides, share], [distance, angle, beyond]))

    def _totals(self, *words: bool) -> ca.Function:
        inputs, meant, given, share = self._symbols(*words)
        sides, outputs, beyond = [], [], []
        for commands in (meant, given):
            mine = self._real.symbols()[1:]
            distance, turned, out = self._compared(meant, commands, mine)
            sides += mine
            outputs += [distance, *(ca.fabs(angle) for angle in turned)]
            beyond.append(out)
        return ca.Function("totals", [*inputs, *sides, share], [*outputs, ca.fmax(*beyond)])

    def _symbols(self, *words: bool) -> tuple[list[Any], Any, Any, Any]:
        """Return begin and displacement of lines (whether of ``words`` of the tip), commands at a point, and the fraction."""
        axes = len(self._real.machine.axes)
        share = ca.SX.sym("share")
        lines = [[ca.SX.sym(f"{which}_{part}", axes) for part in ("begin", "way")] for which in ("meant", "given")]
        meant, given = (
            self._of_words(begin + share * way) if tips else begin + share * way
            for (begin, way), tips in zip(lines, words, strict=True)
        )
        return [*lines[0], *lines[1]], meant, given, share

    def _compared(self, meant: Any, given: Any, sides: list[Any]) -> tuple[Any, tuple[Any, ...], Any]:
        """Return expressions: distance in mm; angle between the tool axes and its two tilts; amount by which a domain is exceeded."""
        machine = self._real.machine
        nominal, commanded = (command * ca.DM(machine.scale) for command in (meant, given))
        frame, _ = self._nominal.pose_at(nominal)
        target, upright = self._nominal.tip_and_axis_at(nominal)
        point, axis = self._real.tip_and_axis_at(commanded, *sides)
        beyond = ca.SX(-1.0)
        for q, (lower, upper) in zip(ca.vertsplit(given), self._real.calibration.domains(), strict=True):
            beyond = beyond if np.isneginf(lower) else ca.fmax(beyond, lower - q)
            beyond = beyond if np.isposinf(upper) else ca.fmax(beyond, q - upper)
        apart = ca.norm_2(axis - upright)
        leaning = frame.T @ axis
        tilts = ca.atan2(-leaning[1], leaning[2]), ca.atan2(leaning[0], leaning[2])
        return ca.norm_2(point - target) / MM, (2.0 * ca.asin(ca.fmin(apart / 2.0, 1.0)), *tilts), beyond


# --- Compensation by the method of Ellingsdalen (2021), listings 3.1-3.4 as they run: a baseline for comparison


@final
class ThesisMethod:
    """The thesis's compensation, for a machine with X, Y, Z on the tool side and two rotary axes under the workpiece.

    Args:
        calibration: the identified error motions.
        nominal: the machine without errors.

    Raises:
        InputError: a machine of another design, which the listings do not cover.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=120)
        >>> method = twin.ThesisMethod(twin.Calibration.default(machine), nominal)
        >>> programmed = np.array([[250.0, 225.0, -200.0, 30.0, 45.0]])
        >>> (1e3 * (method.commands(programmed) - programmed)).round(1)  # µm and millidegrees
        array([[-26.7,  -9.9,  17.8,   0. ,   0. ]])

    References:
        - S. H. Ellingsdalen: Improving the Accuracy of a Five-Axis Machine Tool by Laser Tracker Calibration, master's thesis, NTNU,
          2021, listings 3.1 to 3.4.
    """

    def __init__(self, calibration: Calibration, nominal: Kinematics) -> None:
        machine = calibration.machine
        sides = {axis.name: axis.side for axis in machine.axes}
        linear = tuple(machine.axes[i].name for i in machine.linear)
        if linear != ("X", "Y", "Z") or any(sides[name] != "tool" for name in linear):
            raise InputError(
                "the method of the thesis needs X, Y, Z on the tool side",
                expected="the method exact for this machine",
                value=machine.name,
                setting="method",
            )
        self._calibration = calibration
        self._nominal = nominal
        self._linear = list(machine.linear)
        self._rotary = list(machine.rotary)

    def commands(self, nominal: np.ndarray) -> np.ndarray:
        """Return compensated commands (n, axes), mm and degrees, for nominal ones: rotary axes first, then linear (figure 3.9)."""
        commands = np.array(nominal, dtype=float)
        commands[:, self._linear] += self._for_rotary(nominal)
        commands[:, self._linear] -= self._of_linear(commands)
        return commands

    def _for_rotary(self, q: np.ndarray) -> np.ndarray:
        """Return (n, 3) mm by which the linear axes follow the workpiece: listing 3.3, with the errors before the whole chain."""
        shift = np.zeros((len(q), 3))
        turned = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        for i in self._rotary:
            for k, read in enumerate("ABB"):  # E_B is read for E_C
                turned = turned @ _turn(k, self._read(f"E_{read}", i, q) * URAD)
            shift += self._translation_mm(i, q)
        # The workpiece point under the tool is where the tool is meant to be; the work frame at rest is the base frame.
        upright = np.array(q)
        upright[:, self._rotary] = 0.0
        point = self._nominal.forward(upright).point_mm
        return np.asarray(np.einsum("nij,nj->ni", turned, point + shift) - point)

    def _of_linear(self, q: np.ndarray) -> np.ndarray:
        """Return the (n, 3) deviation in mm of the linear axes: eq. 3.40 and listing 3.4, translations and squareness only."""
        _, y, z = (q[:, i] for i in self._linear)
        square = self._calibration.squareness
        deviation = sum((self._translation_mm(i, q) for i in self._linear), start=np.zeros((len(q), 3)))
        deviation[:, 0] += (-y * square.get("E_C0Y", 0.0) + z * square.get("E_B0Z", 0.0)) * 1e-6
        deviation[:, 1] += -z * square.get("E_A0Z", 0.0) * 1e-6
        return deviation

    def _translation_mm(self, axis: int, q: np.ndarray) -> np.ndarray:
        """Return the (n, 3) translational errors of an axis in mm."""
        return np.stack([self._read(f"E_{d}", axis, q) * 1e-3 for d in "XYZ"], axis=1)

    def _read(self, component: str, axis: int, q: np.ndarray) -> np.ndarray:
        """Return an axis's curve as the listings read it: without its constant, at the nearest whole mm or degree."""
        name = self._calibration.machine.axes[axis].name
        curve: Curve | None = self._calibration.curves.get(component + name)
        if curve is None:
            return np.zeros(len(q))
        lo, hi = curve.domain
        whole = np.round(q[:, axis])
        if lo < 0.0 <= hi:
            # The table runs from 0 down to lo; a negative index counts from its end.
            whole = np.where(whole < 0.0, lo - 1.0 - whole, whole)
        elif self._calibration.machine.by_name[name].lower is None:
            whole = lo + np.mod(whole - lo, hi - lo)
        values = curve(np.clip(whole, lo, hi))
        at_zero = curve(np.clip(0.0, lo, hi))
        return np.asarray(values - at_zero if len(curve.coefficients) > 2 else values)


def _turn(about: int, angles: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) rotations about x, y or z as the listing writes them: the sign of that about y is reversed."""
    i, j = ((1, 2), (0, 2), (0, 1))[about]
    turns = np.zeros((len(angles), 3, 3))
    turns[:, range(3), range(3)] = 1.0
    turns[:, i, i] = turns[:, j, j] = np.cos(angles)
    turns[:, i, j], turns[:, j, i] = -np.sin(angles), np.sin(angles)
    return turns
