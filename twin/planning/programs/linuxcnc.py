"""LinuxCNC: straight probes (G38.2), logged with LOGOPEN, LOG and LOGCLOSE."""

from __future__ import annotations

from typing import Final

from twin._common.errors import InputError
from twin.planning.programs.specification import (
    PROBING_FEED,
    AxisWordsWriter,
    ProgramFormat,
    ProgramStep,
    ProgramSteps,
    ascii_text,
)

AXES: Final = "XYZABCUVW"
"""Axis letters of the control."""
FIRST_RESULT: Final = 5061
"""Numbered parameter that holds X of the last contact, in the coordinate system of the program; the other axes follow."""


def _text(program: ProgramSteps, name: str) -> str:
    letters = [axis.name for axis in program.machine.axes]
    unknown = [letter for letter in letters if letter not in list(AXES)]
    if unknown:
        raise InputError("not an axis of LinuxCNC", expected=f"axes named {', '.join(AXES)}", value=", ".join(unknown))
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
        fields = [f"#{FIRST_RESULT + AXES.index(axis)}" for axis in (*program.linear_names, *rotary)]
        lines += [f"G43.1 Z{-program.tip_mm[2]:g}", f"(LOGOPEN,{log})", f"(LOG,{','.join((*columns, 'sphere'))})"]
    words, pose = AxisWordsWriter(program.machine, lambda axis, value: f"{axis}{value}"), 0
    for step in program.steps:
        if step.pose != pose:
            pose = step.pose
            lines.append(f"(pose {pose})")
        if not step.moves:
            lines += _without_motion(step)
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


def _without_motion(step: ProgramStep) -> list[str]:
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
    unverified="Run by LinuxCNC 2.9 with a simulated machine. The axes must be those of the machine file, with the same zero.",
    write=_text,
)
