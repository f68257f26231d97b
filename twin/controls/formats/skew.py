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
  ``C_zz``. Version 2.9 of Debian does not have it; whether it compiles for that version was not tried.

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


def _bounded(line: TableLine, what: str, text: str, scale: float = 1.0) -> float:
    """Return a number of a line, divided by ``scale``; `InputError` beyond `LARGEST`."""
    value = line.decimal(what, text) / scale
    if abs(value) > LARGEST:
        raise line.error(f"{what} is implausibly large", f"at most {LARGEST * scale:g}", text)
    return value


def _words(line: TableLine, code: str, allowed: str) -> dict[str, str]:
    """Return the numbers of a G-code line by letter; `InputError` for another code, a letter twice or a foreign one."""
    words = line.text.upper().split()
    if words[0] != code:
        raise line.error(f"not a {code} line", f"{code} {' '.join(allowed)}", line.text)
    found: dict[str, str] = {}
    for word in words[1:]:
        if word[0] not in allowed or word[0] in found:
            raise line.error(f"a word that {code} does not have here", f"each of {' '.join(allowed)} once", word)
        found[word[0]] = word[1:]
    return found


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
        section, found = "", dict[str, float]()
        for line in lines:
            head = re.fullmatch(r"\[(.+)\]", line.text)
            if head:
                section = head[1].strip()
                continue
            entry = re.fullmatch(r"(xy|xz|yz)_skew\s*[=:]\s*(\S+)", line.text)
            if entry is None or not section.startswith("skew_correction "):
                raise line.error(
                    "not a line of a skew profile", "[skew_correction NAME] with xy_skew, xz_skew, yz_skew", line.text
                )
            if entry[1] in found:
                raise line.error(f"{entry[1]}_skew is given twice", "one profile", line.text)
            found[entry[1]] = _bounded(line, f"{entry[1]}_skew", entry[2])
        for plane in ("xy", "xz", "yz"):
            if plane not in found:
                raise InputError(f"{plane}_skew is missing", expected="xy_skew, xz_skew and yz_skew", file=path)
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
        if len(own) != 1:
            raise InputError("not one M852 line", expected="M852 I… J… K…", file=path, value=len(own))
        found = {letter: _bounded(own[0], letter, text) for letter, text in _words(own[0], "M852", "IJK").items()}
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
        if len(lines) != 1:
            raise InputError("not one M556 line", expected="M556 S… X… Y… Z…", file=path, value=len(lines))
        (line,) = lines
        words = _words(line, "M556", "SXYZP")
        if words.pop("P", "0") not in ("0", "0.0"):
            raise line.error("P1 corrects Y instead of X", "M556 without P1", line.text)
        span = line.decimal("S", words.pop("S", ""))
        if span < 10.0:
            raise line.error("the firmware ignores M556 with such an S", "S of 10 or more", span)
        matrix = np.zeros((3, 3))
        for letter, text in words.items():
            matrix[self._ENTRIES[letter]] = _bounded(line, letter, text, span)
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
        whole, seen = np.eye(3), set[tuple[int, int]]()
        for line in lines:
            entry = re.fullmatch(r"setp\s+matrixkins\.C_([xyz])([xyz])\s+(\S+)", line.text)
            if entry is None:
                raise line.error("not a parameter of matrixkins", "setp matrixkins.C_xx 1.0 …", line.text)
            place = "xyz".index(entry[1]), "xyz".index(entry[2])
            if place in seen:
                raise line.error(f"C_{entry[1]}{entry[2]} is given twice", "one setp", line.text)
            seen.add(place)
            whole[place] = line.decimal(f"C_{entry[1]}{entry[2]}", entry[3])
            if abs(whole[place] - (place[0] == place[1])) > LARGEST:
                raise line.error(
                    "implausibly large", f"within {LARGEST:g} of the unit matrix", f"{float(whole[place]):g}"
                )
        return whole - np.eye(3)

    def loading(self, correction: MatrixCorrection, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        return (
            "LinuxCNC 2.9 does not have matrixkins. It is matrixkins.comp in the source of later versions; compile it with "
            "`halcompile --install matrixkins.comp` (package linuxcnc-uspace-dev). That it compiles for 2.9 was not tried.",
            "INI file: [KINS] KINEMATICS = matrixkins. Add the lines of matrixkins.hal to the HAL file after the line that loads the "
            "kinematics. matrixkins moves three joints; more axes pass through.",
            "Change the parameters only with the machine switched off: the joints jump by the change. Home again.",
        )


def _reach(largest: Mapping[str, float]) -> str:
    return f"{max(largest.values(), default=0.0) * 1e-3:.2f}"
