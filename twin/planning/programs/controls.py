"""Languages of measuring programs, one for each control, and the steps that every program consists of. To add one, add it here.

Siemens SINUMERIK: touches with MEAS, logged with WRITE. LinuxCNC: straight probes (G38.2), logged with LOG. Heidenhain plain language:
touch probe cycle 4 (measuring in 3-D), logged with FN 16.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Final, Literal, final

import numpy as np

from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.nc import dialect_for

PROBING_FEED: Final = 200.0
"""Feed of a contact, mm/min."""
APPROACH_FEED: Final = 3000.0
"""Feed next to the sphere, mm/min."""
WIDTH: Final = 72
"""Characters per line of comment."""


@final
@dataclass(frozen=True)
class ProgramStep:
    """One step of a measuring program."""

    # ``rapid``, ``feed``, ``probe`` (towards the sphere until contact); or without motion ``dwell``, ``spindle``, ``read`` (a reading
    # is due) and ``stop`` (until the operator continues)
    kind: Literal["rapid", "feed", "probe", "dwell", "spindle", "read", "stop"]
    position: np.ndarray  # (axes,) end position, mm and degrees; of a probing move the end of the search
    pose: int  # number of the pose, from 1
    contact: int = 0  # number of the contact, from 1; 0 for other steps
    # (3,) unit vector of a probing move along the linear axes in command order; zero for others
    direction: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance_mm: float = 0.0  # length of a probing move along it; 0 for others
    feed: float = APPROACH_FEED  # of a feed move, mm/min or degrees/min
    seconds: float = 0.0  # of a dwell
    rpm: float = 0.0  # new spindle speed; 0 stops it
    text: str = ""  # what the operator must know at a reading or a stop

    @property
    def moves(self) -> bool:
        """Whether it is a motion."""
        return self.kind in ("rapid", "feed", "probe")


@final
@dataclass(frozen=True)
class ProgramSteps:
    """Steps of a measuring program."""

    machine: Machine
    steps: tuple[ProgramStep, ...]  # the steps in order; the first come from an unknown position
    poses: int  # number of poses that are probed
    skipped: tuple[int, ...]  # numbers of the poses of the plan to which no path with clearance was found
    header: tuple[str, ...]  # comments, in words
    spheres: tuple[str, ...]  # names of the spheres, for the poses of the plan in order
    tip_mm: tuple[float, float, float]  # (3,) the tip, from the spindle nose in the frame of the tool
    probing: bool = True  # whether there are contacts, which are logged

    @property
    def linear_names(self) -> tuple[str, ...]:
        """Names of the linear axes in command order."""
        return tuple(self.machine.axes[i].name for i in self.machine.linear)

    def convert(self, log: str, form: str) -> str:
        """Return the comment that says how the log becomes a measurement table, and that a calibration."""
        tip = ",".join(f"{value:g}" for value in self.tip_mm)
        return (
            f"The log becomes a measurement table with: twin convert {log} --format {form} --contacts 5 -o measured.csv - with "
            f"--tip {tip} if the tip is calibrated, with its own values: positions of the rotary axes need it. "
            "Then: twin identify measured.csv -o mine.yaml --only E_*0*"
        )

    def comments(self, *more: str) -> list[str]:
        """Return the lines of the header, wrapped."""
        return [line for text in (*self.header, *more) for line in wrap(ascii_text(text), WIDTH)]


@final
@dataclass(frozen=True)
class ProgramFormat:
    """A control's language of measuring programs."""

    name: str  # identifier
    title: str  # name of the control
    suffixes: tuple[str, ...]  # suffixes of the file name that select it
    source: str  # where the statements come from
    unverified: str  # what was not verified
    write: Callable[[ProgramSteps, str], str]  # function that returns the program's text from its steps and its name


class AxisWordsWriter:
    """Axis words of the axes whose written value changes; ``form``: function that returns a word from name and number."""

    def __init__(self, machine: Machine, form: Callable[[str, str], str]) -> None:
        self.machine = machine
        self.form = form
        self._last: dict[str, str] = {}

    def words(self, position: np.ndarray, *, remember: bool = True) -> list[str]:
        """Return the words of a position; it counts as reached only if ``remember``."""
        words = []
        for axis, value in zip(self.machine.axes, position, strict=True):
            if not np.isfinite(value):
                continue
            text = f"{value:.3f}".replace("-0.000", "0.000")
            if self._last.get(axis.name) != text:
                words.append(self.form(axis.name, text))
                if remember:
                    self._last[axis.name] = text
        return words

    def forget(self) -> None:
        """Write all linear axes the next time: after a contact the position is not known."""
        for i in self.machine.linear:
            self._last.pop(self.machine.axes[i].name, None)


def ascii_text(text: str) -> str:
    """Return a text in plain ASCII without brackets and quotes, for a comment in any language."""
    for old, new in (("µ", "u"), ("…", "..."), ("–", "-"), ("−", "-"), ("°", " deg"), (";", ",")):
        text = text.replace(old, new)
    plain = text.translate(str.maketrans("([{}])", "      ", "\"'%"))
    return " ".join(plain.encode("ascii", "replace").decode().split())


# --- Siemens SINUMERIK ----------------------------------------------------------------------------


def _siemens_text(program: ProgramSteps, name: str) -> str:
    machine = program.machine
    rotary = [machine.axes[i].name for i in machine.rotary]
    log = f"{name}_LOG"
    columns = (
        *(f"contact_{axis.lower()}_mm" for axis in program.linear_names),
        *(f"{axis}_deg" for axis in rotary),
        "sphere",
    )
    more = (
        f"WRITE adds one line per contact to {log}: a table of contacts in the machine system. Copy it as {log}.csv.",
        program.convert(f"{log}.csv", "contacts"),
    )
    lines = [f"; {line}" for line in program.comments(*(more if program.probing else ()))]
    lines += ["DEF INT _ERR"] if program.probing else []
    lines += ["G71 G90 G94 G40 G17", "G500", "TRAFOOF", "D0"]
    lines += [f'WRITE(_ERR,"{log}","{",".join(columns)}")'] if program.probing else []
    words, pose = AxisWordsWriter(machine, lambda axis, value: f"{axis}={value}"), 0
    for step in program.steps:
        if step.pose != pose:
            pose = step.pose
            lines.append(f"; pose {pose}")
        if not step.moves:
            lines += _siemens_without_motion(step)
            continue
        found = words.words(step.position, remember=step.kind != "probe")
        if not found:
            continue
        if step.kind != "probe":
            feed = "G0" if step.kind == "rapid" else f"G1 F{step.feed:g}"
            lines.append(f"{feed} SUPA {' '.join(found)}")
            continue
        fields = [f"$AA_MM[{axis}]" for axis in program.linear_names] + [f"$AA_IM[{axis}]" for axis in rotary]
        text = '<<","<<'.join(fields) + f'<<",{program.spheres[step.pose - 1]}"'
        lines += [
            f"MEAS=1 G1 F{PROBING_FEED:g} SUPA {' '.join(found)}",
            "STOPRE",
            "IF $AC_MEA[1]==0",
            f'MSG("no contact: pose {step.pose}, contact {step.contact}")',
            "M0",
            "M30",
            "ENDIF",
            f'WRITE(_ERR,"{log}",""<<{text})',
        ]
        words.forget()
    lines.append("M30")
    return "\n".join(lines) + "\n"


def _siemens_without_motion(step: ProgramStep) -> list[str]:
    if step.kind == "dwell":
        return [f"G4 F{step.seconds:g}"]
    if step.kind == "spindle":
        return [f"S{step.rpm:g} M3"] if step.rpm > 0.0 else ["M5"]
    return [f"; {step.text}", *([f'MSG("{step.text}")', "M0"] if step.kind == "stop" else [])]


SIEMENS: Final = ProgramFormat(
    name="siemens",
    title="Siemens SINUMERIK",
    suffixes=(".mpf",),
    source="SINUMERIK 840D sl programming manuals: MEAS, $AC_MEA, $AA_MM, WRITE, SUPA",
    unverified=(
        Message(
            "Not run on a control. SUPA together with MEAS, the number of the probe, the folder of the log and its "
            "number of decimals are not verified."
        )
    ),
    write=_siemens_text,
)


# --- LinuxCNC -------------------------------------------------------------------------------------

LINUXCNC_AXES: Final = "XYZABCUVW"
"""Axis letters of the control."""
FIRST_RESULT: Final = 5061
"""Numbered parameter that holds X of the last contact, in the coordinate system of the program; the other axes follow."""


def _linuxcnc_text(program: ProgramSteps, name: str) -> str:
    letters = [axis.name for axis in program.machine.axes]
    unknown = [letter for letter in letters if letter not in list(LINUXCNC_AXES)]
    if unknown:
        raise InputError(
            "not an axis of LinuxCNC", expected=f"axes named {', '.join(LINUXCNC_AXES)}", value=", ".join(unknown)
        )
    log, rotary = f"{name}_LOG.csv", [program.machine.axes[i].name for i in program.machine.rotary]
    probing = (
        f"Each contact adds one line to {log}, a table of contacts in axis positions.",
        program.convert(log, "contacts"),
        "The program sets coordinate system 9 - G59.3 - and clears G92.",
    )
    lines = [f"({line})" for line in program.comments(*(probing if program.probing else ()))]
    lines.append("G21 G90 G94 G40 G49 G80 G17")
    if program.probing:
        # Offset and tool length cancel: kinematics with errors count the tool, and the words are positions of the axes.
        zero = {letter: 0.0 for letter in letters} | {"Z": program.tip_mm[2]}
        lines += [f"G10 L2 P9 {' '.join(f'{letter}{value:g}' for letter, value in zero.items())} R0", "G59.3", "G92.1"]
    lines += list(program.machine.tcp_off[:1])
    if program.probing:
        columns = (
            *(f"contact_{axis.lower()}_mm" for axis in program.linear_names),
            *(f"{axis}_deg" for axis in rotary),
        )
        fields = [f"#{FIRST_RESULT + LINUXCNC_AXES.index(axis)}" for axis in (*program.linear_names, *rotary)]
        lines += [f"G43.1 Z{-program.tip_mm[2]:g}", f"(LOGOPEN,{log})", f"(LOG,{','.join((*columns, 'sphere'))})"]
    words, pose = AxisWordsWriter(program.machine, lambda axis, value: f"{axis}{value}"), 0
    for step in program.steps:
        if step.pose != pose:
            pose = step.pose
            lines.append(f"(pose {pose})")
        if not step.moves:
            lines += _linuxcnc_without_motion(step)
            continue
        found = words.words(step.position, remember=step.kind != "probe")
        if not found:
            continue
        code, feed = {"rapid": ("G0", None), "feed": ("G1", step.feed), "probe": ("G38.2", PROBING_FEED)}[step.kind]
        machine = [] if program.probing else ["G53"]
        lines.append(" ".join([*machine, code, *found] + ([] if feed is None else [f"F{feed:g}"])))
        if step.kind == "probe":
            lines.append(f"(LOG,{','.join((*fields, ascii_text(program.spheres[step.pose - 1])))})")
            words.forget()
    lines += [*(["(LOGCLOSE)"] if program.probing else []), "M2"]
    return "\n".join(lines) + "\n"


def _linuxcnc_without_motion(step: ProgramStep) -> list[str]:
    if step.kind == "dwell":
        return [f"G4 P{step.seconds:g}"]
    if step.kind == "spindle":
        return [f"S{step.rpm:g} M3"] if step.rpm > 0.0 else ["M5"]
    return [f"({step.text})", *(["M0"] if step.kind == "stop" else [])]


LINUXCNC: Final = ProgramFormat(
    name="linuxcnc",
    title="LinuxCNC",
    suffixes=(".ngc", ".nc"),
    source="LinuxCNC documentation: G38.2 straight probe, #5061 to #5069, LOG, G10 L2, G59.3, G43.1",
    unverified=Message(
        "Run by LinuxCNC 2.9 with a simulated machine. The axes must be those of the machine file, with the same zero."
    ),
    write=_linuxcnc_text,
)


# --- Heidenhain plain language --------------------------------------------------------------------

ROTARY_PARAMETER: Final = 205
"""First Q parameter of the rotary axes; Q201 to Q204 are results of the cycle: three coordinates and the status."""
SPHERE_PARAMETER: Final = "Q220"
"""Q parameter of the number of the sphere."""


def _heidenhain_text(program: ProgramSteps, name: str) -> str:
    machine = program.machine
    rotary = [machine.axes[i].name for i in machine.rotary]
    entries = [*program.linear_names, *rotary]
    tool = "calibrated touch probe" if program.probing else "test tool"
    mask = " ".join((*(f"{axis}=%+.4lf" for axis in entries), "SPHERE=%.0lf"))
    numbers = ("Q201", "Q202", "Q203", *(f"Q{ROTARY_PARAMETER + k}" for k in range(len(rotary))), SPHERE_PARAMETER)
    more = (
        f"Insert the TOOL CALL of the {tool} where it is marked: its length must not act on M91 positions.",
        program.convert(f"{name}.TXT", "heidenhain"),
        f"FN 16 adds one line per contact to TNC:/{name}.TXT. It needs the format file TNC:/TWIN.A with a line M_APPEND and this line:",
    )
    lines = [f"BEGIN PGM {name} MM"]
    lines += [f"; {text}" for text in program.comments(*(more if program.probing else more[:1]))]
    if program.probing:
        lines.append(f'; "CONTACT {mask}",{",".join(numbers)};')
    lines += [
        f"; TOOL CALL ... of the {tool}",
        "FUNCTION RESET TCPM",
        "PLANE RESET STAY",
        "L M127",
    ]
    names = list(dict.fromkeys(program.spheres))
    words, pose = AxisWordsWriter(machine, lambda axis, value: f"{axis}{_signed(value)}"), 0
    for step in program.steps:
        if step.pose != pose:
            pose = step.pose
            sphere = names.index(program.spheres[pose - 1]) + 1
            lines += [f"; pose {pose}", *([f"{SPHERE_PARAMETER} = {sphere}"] if program.probing else [])]
            values = [step.position[i] for i in machine.rotary]
            if program.probing and all(value == value for value in values):
                lines += [f"Q{ROTARY_PARAMETER + k} = {value:+.3f}" for k, value in enumerate(values)]
        if not step.moves:
            lines += _heidenhain_without_motion(step)
            continue
        if step.kind == "probe":
            vector = zip(program.linear_names, step.direction, strict=True)
            lines += [
                "TCH PROBE 4.0 MEASURING IN 3-D",
                "TCH PROBE 4.1 Q201",
                "TCH PROBE 4.2 " + " ".join(f"I{axis}{value:+.6f}" for axis, value in vector),
                f"TCH PROBE 4.3 DIST{step.distance_mm:+.3f} F{PROBING_FEED:g} MB{step.distance_mm:+.3f} REFERENCE SYSTEM:1",
                "FN 9: IF +Q204 EQU -1 GOTO LBL 99",
                f"FN 16: F-PRINT TNC:\\TWIN.A / TNC:\\{name}.TXT",
            ]
            words.forget()
            continue
        found = words.words(step.position)
        if found:
            feed = "FMAX" if step.kind == "rapid" else f"F{step.feed:g}"
            lines.append(f"L {' '.join(found)} R0 {feed} M91")
    missed = ["LBL 99", "; no contact within the search", "STOP", "LBL 0"] if program.probing else []
    lines += ["L M30", *missed, f"END PGM {name} MM"]
    return "".join(f"{number} {line}\r\n" for number, line in enumerate(lines))


def _heidenhain_without_motion(step: ProgramStep) -> list[str]:
    if step.kind == "dwell":
        return ["CYCL DEF 9.0 DWELL TIME", f"CYCL DEF 9.1 DWELL {step.seconds:g}"]
    if step.kind == "spindle":
        return [f"TOOL CALL S{step.rpm:g}", "L M3"] if step.rpm > 0.0 else ["L M5"]
    return [f"; {step.text}", *(["STOP"] if step.kind == "stop" else [])]


def _signed(value: str) -> str:
    return value if value.startswith("-") else f"+{value}"


HEIDENHAIN: Final = ProgramFormat(
    name="heidenhain",
    title="HEIDENHAIN TNC",
    suffixes=(".h",),
    source="HEIDENHAIN TNC 640 manuals: touch probe cycle 4, FN 9, FN 16, M91",
    unverified=(
        Message(
            "Not run on a control. Which versions of the control have cycle 4, the place of its result parameters, "
            "whether the machine system of the results contains the tool length, and the format file of FN 16 are not "
            "verified."
        )
    ),
    write=_heidenhain_text,
)

# --- All controls ---------------------------------------------------------------------------------

PROGRAMS: Final = (LINUXCNC, HEIDENHAIN, SIEMENS)
"""All controls for which measuring programs are written."""
LONGEST_NAME: Final = 24


def format_of(path: str | Path) -> ProgramFormat:
    """Return the format that the suffix of a file name selects. Raises `InputError`: no format has this suffix."""
    suffix = Path(path).suffix.lower()
    for program in PROGRAMS:
        if suffix in program.suffixes:
            return program
    every = ", ".join(f"{suffix} ({program.title})" for program in PROGRAMS for suffix in program.suffixes)
    raise InputError("no control has programs with this suffix", expected=every, file=Path(path), value=suffix)


def write_program(steps: ProgramSteps, path: str | Path) -> None:
    """Write a measuring program atomically, read back before, in the language of the file's suffix; `InputError` for an unknown one."""
    chosen = format_of(path)
    name = re.sub(r"[^A-Za-z0-9]+", "_", Path(path).stem).strip("_").upper()[:LONGEST_NAME] or "TWIN"
    text = chosen.write(steps, name if name[0].isalpha() else f"T_{name}")

    def check(written: Path) -> None:
        data = written.read_bytes()
        dialect_for(Path(path), data).read(data, str(path))

    write_atomic(Path(path), text, check=check)
