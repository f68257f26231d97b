"""Skew settings of firmware: Klipper, Marlin, RepRapFirmware, and the matrix of LinuxCNC's ``matrixkins``.

Behaviour as in the public sources; formulas are restated here, x, y, z the commanded machine coordinates:

- Klipper, github.com/Klipper3d/klipper at 84104bb, ``klippy/extras/skew_correction.py`` (`calc_skew`), and Marlin,
  github.com/MarlinFirmware/Marlin, ``Marlin/src/module/planner.h`` (`skew`), the same formula: the motors go to x − xy·y − (xz −
  xy·yz)·z, y − yz·z and z. It undoes a machine that moves to x + xy·y + xz·z and y + yz·z. ``SET_SKEW XY=AC,BD,AD`` takes the diagonals
  and a side of a parallelogram; xy is the cotangent of its angle at A, positive if AC is the longer diagonal.
- Marlin, ``gcode/calibrate/M852.cpp``: ``I`` (or ``S``) is xy, ``J`` xz, ``K`` yz, each from −1 to 1, in the units of G20 or
  G21; J and K need ``SKEW_CORRECTION_FOR_Z``. Positions whose correction would leave the range are not corrected, without a message.
- RepRapFirmware, github.com/Duet3D/RepRapFirmware at 0e02e02, ``src/Movement/Move3.cpp`` (`AxisTransform`) and ``M556`` of ``GCodes``:
  the tangents X/S, Y/S and Z/S are **added**: x + X/S·y + Z/S·z and y + Y/S·z. ``P1`` would correct y instead of x.
- LinuxCNC, github.com/LinuxCNC/linuxcnc at 1de03ef, ``src/hal/components/matrixkins.comp``: joints = C · axes, parameters ``C_xx`` …
  ``C_zz``. Version 2.9 of Debian does not have it; the component of February 2025 (5133dac) compiles for it and moves the joints of a
  running control as stated; that of 1de03ef does not compile there. Joints 3, 4 and 5 are A, B and C, whatever axes there are.

All of them keep the zero of the machine where it is. Skew settings of three numbers hold no scale: that belongs into the steps per mm.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import BasicClass
from twin.controls.correction import MatrixCorrection
from twin.controls.format import TableFormat, TableLine, fixed_decimals, single_file, table_lines
from twin.machine.machine import Machine

LETTERS: Final = "XYZ"
DIGITS: Final = 9
SPAN: Final = 1000.0
"""Length S of ``M556`` in mm."""
SIDE: Final = 100.0
"""Side of the parallelogram of ``SET_SKEW`` in mm."""
LARGEST: Final = 0.1
"""Largest entry that is accepted: 0.1 mm per mm are six degrees, more than any machine that can be used."""
SCALE_TEXT: Final = (
    "Scale is not in these settings: a comment in {} gives the factor of each axis whose scale error is proven. After a change of the "
    "scale measure again, and make the calibration anew."
)
Factors = tuple[float, float, float]
"""Skew xy, xz, yz: how far x moves with y, x with z, and y with z."""


class SkewFormat(TableFormat[MatrixCorrection]):
    """Settings that make the motors go to q + M q.

    Attributes:
        digit: half of the last digit of an entry.
        mark: what begins a comment.
        rate: instruction for the scale of one axis; ``axis``, ``grow`` (actual per commanded) and ``shrink`` (its inverse).
    """

    correction = MatrixCorrection
    points = 2
    rounding = (0.001, 0.0)
    digit: ClassVar[float] = 2.0 * 0.5 * 10.0**-DIGITS
    carries = "squareness of X, Y and Z"
    leaves = "scale (given as a factor); everything that is not linear"
    classes: ClassVar[tuple[BasicClass, ...]] = ("L-SQU",)
    mark: ClassVar[str]
    rate: ClassVar[str]

    def check(self, names: Collection[str]) -> None:
        """Raise `InputError` unless the linear axes are some of X, Y and Z, at least two."""
        if len(names) < 2 or not set(names) <= set(LETTERS):
            what = f"{self.title} corrects X, Y and Z"
            raise InputError(what, expected="two or three linear axes of these names", value=" ".join(names) or "none")

    def holds(self, moved: str, by: str) -> bool:
        """Return whether the settings can move one axis as a function of another."""
        return moved < by

    def write(self, correction: MatrixCorrection, notes: Sequence[str] = ()) -> dict[str, str]:
        """See `TableFormat.write`."""
        self.check(correction.linear)
        for moved, by, value in correction.entries:
            if not self.holds(moved, by) or abs(value) > LARGEST:
                what = f"not possible as a setting of {self.title}: {moved} by {by}"
                raise InputError(what, expected=f"{self.carries}, at most {LARGEST:g} mm per mm", value=value)
        whole = np.zeros((3, 3))
        places = [LETTERS.index(name) for name in correction.linear]
        whole[np.ix_(places, places)] = correction.matrix
        comments = [*notes, *self._rates(correction)]
        lines = [*(f"{self.mark} {text}" for text in comments), *self._lines(whole)]
        return {self.written[0]: "\n".join(lines) + "\n"}

    def read(self, files: Sequence[Path], machine: Machine) -> MatrixCorrection:
        """See `TableFormat.read`."""
        names = tuple(machine.axes[i].name for i in machine.linear)
        self.check(names)
        suffix = Path(self.written[0]).suffix
        path = single_file(files, suffix, f"the settings of {self.title} are one file", f"one {suffix} file")
        lines = [TableLine(path, line.number, line.text.partition(self.mark)[0].strip()) for line in table_lines(path)]
        whole = self._matrix([line for line in lines if line.text], path)
        for i, moved in enumerate(LETTERS):
            for j, by in enumerate(LETTERS):
                if whole[i, j] != 0.0 and not {moved, by} <= set(names):
                    what = f"a setting for {moved} by {by}, and {machine.name} does not have both"
                    raise InputError(what, expected=f"axes {' '.join(names)}", file=path, value=float(whole[i, j]))
        places = [LETTERS.index(name) for name in names]
        return MatrixCorrection(machine, whole[np.ix_(places, places)])

    def _rates(self, correction: MatrixCorrection) -> list[str]:
        """Return the instructions for the scale of the axes, which the settings do not hold."""
        return [
            "scale, not in these settings: " + self.rate.format(axis=name, grow=1.0 / (1.0 + value), shrink=1.0 + value)
            for name, value in correction.scale.items()
        ]

    @abstractmethod
    def _lines(self, matrix: np.ndarray) -> list[str]:
        """Return the lines of the file for the matrix M (3, 3) of X, Y and Z."""

    @abstractmethod
    def _matrix(self, lines: Sequence[TableLine], path: Path) -> np.ndarray:
        """Return the matrix M (3, 3) of the file; `InputError` if it is invalid."""


def to_factors(matrix: np.ndarray) -> Factors:
    """Return the skew factors of Klipper and Marlin for M (3, 3) above the diagonal."""
    xy, yz = -float(matrix[0, 1]), -float(matrix[1, 2])
    return xy, xy * yz - float(matrix[0, 2]), yz


def from_factors(xy: float, xz: float, yz: float) -> np.ndarray:
    """Return M (3, 3) for skew factors."""
    return np.array([[0.0, -xy, xy * yz - xz], [0.0, 0.0, -yz], [0.0, 0.0, 0.0]])


def skew_lengths(factor: float) -> Factors:
    """Return AC, BD and AD in mm for which ``SET_SKEW`` computes a factor; AB and AD have `SIDE`."""
    cosine = factor / float(np.hypot(1.0, factor))
    ac, bd = (SIDE * float(np.sqrt(2.0 + sign * 2.0 * cosine)) for sign in (1.0, -1.0))
    return ac, bd, SIDE


def _bounded(line: TableLine, what: str, text: str, *, scale: float = 1.0, middle: float = 0.0) -> float:
    """Return a number of a line, divided by ``scale``; `InputError` if it is farther than `LARGEST` from ``middle``."""
    value = line.decimal(what, text) / scale
    if abs(value - middle) > LARGEST:
        raise line.error(f"{what} is implausibly large", f"within {LARGEST * scale:g} of {middle:g}", text)
    return value


def _entries(lines: Sequence[TableLine], pattern: str, expected: str) -> dict[str, tuple[TableLine, str]]:
    """Return line and number of every entry by its name, the groups of a pattern; `InputError` for another line, or a name twice."""
    found: dict[str, tuple[TableLine, str]] = {}
    for line in lines:
        entry = re.fullmatch(pattern, line.text)
        if entry is None:
            raise line.error("not one of these settings", expected, line.text)
        if entry[1] in found:
            raise line.error(f"{entry[1]} is given twice", expected, line.text)
        found[entry[1]] = line, entry[2]
    return found


def _words(lines: Sequence[TableLine], code: str, letters: str, path: Path) -> dict[str, tuple[TableLine, str]]:
    """Return the words of the one G-code line of a file as `_entries`; `InputError` for another code, letter, or number of lines."""
    expected = f"{code} {' '.join(f'{letter}…' for letter in letters)}"
    if len(lines) != 1:
        raise InputError(f"not one {code} line", expected=expected, file=path, value=len(lines))
    (line,) = lines
    own, *words = line.text.upper().split()
    if own != code:
        raise line.error(f"not a {code} line", expected, line.text)
    return _entries(
        [TableLine(path, line.number, word) for word in words], rf"([{letters}])(.*)", f"{expected}, each once"
    )


@final
class Klipper(SkewFormat):
    """Klipper: profile of ``[skew_correction]``."""

    name = "klipper"
    title = "Klipper"
    what = "`[skew_correction]`, `SET_SKEW`"
    written = ("skew.cfg",)
    mark = "#"
    rate = "multiply rotation_distance of {axis} by {grow:.7f}"

    def _lines(self, matrix: np.ndarray) -> list[str]:
        factors = dict(zip(("xy", "xz", "yz"), to_factors(matrix), strict=True))
        planes = [
            f"{plane.upper()}={','.join(f'{one:.6f}' for one in skew_lengths(value))}"
            for plane, value in factors.items()
        ]
        return [
            f"# the same as a command: SET_SKEW {' '.join(planes)}",
            "[skew_correction]",
            "",
            "[skew_correction twin]",
            *(f"{plane}_skew = {fixed_decimals(value, DIGITS)}" for plane, value in factors.items()),
        ]

    def _matrix(self, lines: Sequence[TableLine], path: Path) -> np.ndarray:
        own, profile = [], False
        for line in lines:
            head = re.fullmatch(r"\[(.+)\]", line.text)
            profile = head[1].strip().startswith("skew_correction ") if head else profile
            own += [] if head else [line if profile else TableLine(path, line.number, f"{line.text} (in no profile)")]
        expected = "[skew_correction NAME] with xy_skew, xz_skew, yz_skew"
        texts = _entries(own, r"(xy|xz|yz)_skew\s*[=:]\s*(\S+)", expected)
        found = {plane: _bounded(line, f"{plane}_skew", text) for plane, (line, text) in texts.items()}
        for plane in ("xy", "xz", "yz"):
            if plane not in found:
                raise InputError(f"{plane}_skew is missing", expected=expected, file=path)
        return from_factors(found["xy"], found["xz"], found["yz"])

    def loading(self, correction: MatrixCorrection, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        return (
            "Copy the lines of skew.cfg into printer.cfg (one [skew_correction] only) and restart with FIRMWARE_RESTART.",
            "Add SKEW_PROFILE LOAD=twin to the start G-code, after homing, and SET_SKEW CLEAR=1 to the end.",
            "GET_CURRENT_SKEW shows the three factors of the file. CALC_MEASURED_SKEW of a new part should then show nearly zero.",
            f"Moves near the ends of the range can leave it, by up to {_reach(largest)} mm: keep parts away from the edges.",
            SCALE_TEXT.format(self.written[0]),
        )


@final
class Marlin(SkewFormat):
    """Marlin: ``M852``."""

    name = "marlin"
    title = "Marlin"
    what = "`M852`"
    written = ("skew.gcode",)
    mark = ";"
    rate = "multiply the steps per mm of {axis} (M92) by {shrink:.7f}"

    def _lines(self, matrix: np.ndarray) -> list[str]:
        words = [
            f"{letter}{fixed_decimals(value, DIGITS)}" for letter, value in zip("IJK", to_factors(matrix), strict=True)
        ]
        return ["G21 ; M852 reads its numbers in the units in force", f"M852 {' '.join(words)}", "M500 ; store"]

    def _matrix(self, lines: Sequence[TableLine], path: Path) -> np.ndarray:
        own = [line for line in lines if line.text.upper() not in ("G21", "M500")]
        words = _words(own, "M852", "IJK", path)
        found = {letter: _bounded(line, letter, text) for letter, (line, text) in words.items()}
        return from_factors(*(found.get(letter, 0.0) for letter in "IJK"))

    def loading(self, correction: MatrixCorrection, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        return (
            "The firmware needs SKEW_CORRECTION and SKEW_CORRECTION_GCODE; J and K also SKEW_CORRECTION_FOR_Z (Configuration.h). "
            "Without them M852 answers with an unknown command, or J and K have no effect.",
            "Home, send the lines of skew.gcode. M852 without a number shows the factors; M500 stores them.",
            f"Marlin leaves out the correction, without a message, where it would leave the range: keep {_reach(largest)} mm away from "
            "the ends.",
            SCALE_TEXT.format(self.written[0]),
        )


@final
class RepRapFirmware(SkewFormat):
    """RepRapFirmware: ``M556``."""

    name = "reprapfirmware"
    title = "RepRapFirmware"
    what = "`M556`"
    written = ("skew.g",)
    mark = ";"
    rate = "multiply the steps per mm of {axis} (M92) by {shrink:.7f}"
    _ENTRIES: ClassVar[Mapping[str, tuple[int, int]]] = {"X": (0, 1), "Y": (1, 2), "Z": (0, 2)}

    def _lines(self, matrix: np.ndarray) -> list[str]:
        words = [
            f"{letter}{fixed_decimals(SPAN * float(matrix[place]), DIGITS - 3)}"
            for letter, place in self._ENTRIES.items()
        ]
        return [f"M556 S{SPAN:g} {' '.join(words)}"]

    def _matrix(self, lines: Sequence[TableLine], path: Path) -> np.ndarray:
        words = _words(lines, "M556", "SXYZP", path)
        if words.pop("P", (lines[0], "0"))[1] not in ("0", "0.0"):
            raise lines[0].error("P1 corrects Y instead of X", "M556 without P1", lines[0].text)
        span = lines[0].decimal("S", words.pop("S", (lines[0], ""))[1])
        if span < 10.0:
            raise lines[0].error("the firmware ignores M556 with such an S", "S of 10 or more", span)
        matrix = np.zeros((3, 3))
        for letter, (line, text) in words.items():
            matrix[self._ENTRIES[letter]] = _bounded(line, letter, text, scale=span)
        return matrix

    def loading(self, correction: MatrixCorrection, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        return (
            "Copy the line of skew.g into config.g (in place of an M556 that is there) and restart, or send it after homing.",
            "M556 without numbers shows the three tangents: those of skew.g divided by 1000.",
            f"Moves near the ends of the range can leave it, by up to {_reach(largest)} mm.",
            SCALE_TEXT.format(self.written[0]),
        )


@final
class MatrixKins(SkewFormat):
    """LinuxCNC: ``matrixkins``, all nine entries."""

    name = "matrixkins"
    title = "LinuxCNC"
    what = "`setp matrixkins.C_xx` …"
    carries = "squareness and scale of X, Y and Z"
    leaves = "everything that is not linear"
    classes = ("L-POS", "L-SQU")
    written = ("matrixkins.hal",)
    mark = "#"
    rate = ""

    def holds(self, moved: str, by: str) -> bool:
        """See `SkewFormat.holds`: all entries."""
        return True

    def _lines(self, matrix: np.ndarray) -> list[str]:
        whole = matrix + np.eye(3)
        return [
            f"setp matrixkins.C_{a}{b} {fixed_decimals(float(whole[i, j]), DIGITS)}"
            for i, a in enumerate("xyz")
            for j, b in enumerate("xyz")
        ]

    def _matrix(self, lines: Sequence[TableLine], path: Path) -> np.ndarray:
        whole = np.eye(3)
        for name, (line, text) in _entries(
            lines, r"setp\s+matrixkins\.(C_[xyz][xyz])\s+(\S+)", "setp matrixkins.C_xx 1.0 …"
        ).items():
            place = "xyz".index(name[2]), "xyz".index(name[3])
            whole[place] = _bounded(line, name, text, middle=whole[place])
        return whole - np.eye(3)

    def loading(self, correction: MatrixCorrection, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        return (
            "LinuxCNC 2.9 does not have matrixkins. It is matrixkins.comp in the source of later versions; compile it with "
            "`halcompile --install matrixkins.comp` (package linuxcnc-uspace-dev); for 2.9 that of February 2025 (5133dac).",
            "INI file: [KINS] KINEMATICS = matrixkins. Add the lines of matrixkins.hal to the HAL file after the line that loads the "
            "kinematics. matrixkins moves three joints; joints 3, 4 and 5 are A, B and C: another order of rotary axes does not work.",
            "Change the parameters only with the machine switched off: the joints jump by the change. Home again.",
        )


def _reach(largest: Mapping[str, float]) -> str:
    return f"{max(largest.values(), default=0.0) * 1e-3:.2f}"
