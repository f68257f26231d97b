"""LinuxCNC: straight probes (G38.2), logged with PROBEOPEN and PROBECLOSE."""

from __future__ import annotations

from typing import Final

from twin._common.errors import InputError
from twin.planning.programs.specification import (
    PROBING_FEED,
    AxisWordsWriter,
    ProgramFormat,
    ProgramStep,
    ProgramSteps,
)

AXES: Final = "XYZABCUVW"
"""Axis letters of the control."""


def _text(program: ProgramSteps, name: str) -> str:
    letters = [axis.name for axis in program.machine.axes]
    unknown = [letter for letter in letters if letter not in list(AXES)]
    if unknown:
        raise InputError("not an axis of LinuxCNC", expected=f"axes named {', '.join(AXES)}", value=", ".join(unknown))
    probing = (
        f"Each contact adds one line to {name}.txt: {' '.join(AXES)} of the axes at the contact. "
        "Line 5 k + 1 is the first of pose k + 1.",
        program.convert(f"{name}.txt", "linuxcnc"),
        "The program sets coordinate system 9 - G59.3 - to zero and clears G92.",
    )
    lines = [f"({line})" for line in program.comments(*(probing if program.probing else ()))]
    lines.append("G21 G90 G94 G40 G49 G80 G17")
    if program.probing:
        lines += [f"G10 L2 P9 {' '.join(f'{letter}0' for letter in letters)} R0", "G59.3", "G92.1"]
    lines += list(program.machine.tcp_off[:1])
    if program.probing:
        lines.append(f"(PROBEOPEN {name}.txt)")
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
            words.forget()
    lines += [*(["(PROBECLOSE)"] if program.probing else []), "M2"]
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
    source="LinuxCNC documentation: G38.2 straight probe, PROBEOPEN and PROBECLOSE, G10 L2, G59.3",
    unverified="Not run on a control. The axes must be those of the machine file, with the same zero.",
    write=_text,
)
