"""LinuxCNC: straight probes (G38.2), logged with PROBEOPEN and PROBECLOSE."""

from __future__ import annotations

from typing import Final

from twin._common.errors import InputError
from twin.planning.programs.specification import (
    APPROACH_FEED,
    PROBING_FEED,
    AxisWordsWriter,
    ProgramFormat,
    ProgramSteps,
)

AXES: Final = "XYZABCUVW"
"""Axis letters of the control."""


def _text(program: ProgramSteps, name: str) -> str:
    letters = [axis.name for axis in program.machine.axes]
    unknown = [letter for letter in letters if letter not in list(AXES)]
    if unknown:
        raise InputError("not an axis of LinuxCNC", expected=f"axes named {', '.join(AXES)}", value=", ".join(unknown))
    more = (
        f"Each contact adds one line to {name}.txt: {' '.join(AXES)} of the axes at the contact. "
        "Line 5 k + 1 is the first of pose k + 1.",
        program.convert(f"{name}.txt", "linuxcnc"),
        "The program sets coordinate system 9 - G59.3 - to zero and clears G92.",
    )
    lines = [f"({line})" for line in program.comments(*more)]
    lines += [
        "G21 G90 G94 G40 G49 G80 G17",
        f"G10 L2 P9 {' '.join(f'{letter}0' for letter in letters)} R0",
        "G59.3",
        "G92.1",
    ]
    lines += list(program.machine.tcp_off[:1])
    lines.append(f"(PROBEOPEN {name}.txt)")
    words, pose = AxisWordsWriter(program.machine, lambda axis, value: f"{axis}{value}"), 0
    for step in program.steps:
        if step.pose != pose:
            pose = step.pose
            lines.append(f"(pose {pose})")
        found = words.words(step.position, remember=step.kind != "probe")
        if not found:
            continue
        code, feed = {"rapid": ("G0", None), "feed": ("G1", APPROACH_FEED), "probe": ("G38.2", PROBING_FEED)}[step.kind]
        lines.append(" ".join([code, *found] + ([] if feed is None else [f"F{feed:g}"])))
        if step.kind == "probe":
            words.forget()
    lines += ["(PROBECLOSE)", "M2"]
    return "\n".join(lines) + "\n"


LINUXCNC: Final = ProgramFormat(
    name="linuxcnc",
    title="LinuxCNC",
    suffixes=(".ngc", ".nc"),
    source="LinuxCNC documentation: G38.2 straight probe, PROBEOPEN and PROBECLOSE, G10 L2, G59.3",
    unverified="Not run on a control. The axes must be those of the machine file, with the same zero.",
    write=_text,
)
