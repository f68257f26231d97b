"""Heidenhain plain language: touch probe cycle 4 (measuring in 3-D), logged with FN 16."""

from __future__ import annotations

from typing import Final

from twin.planning.programs.specification import (
    APPROACH_FEED,
    PROBING_FEED,
    AxisWordsWriter,
    ProgramFormat,
    ProgramSteps,
)


def _text(program: ProgramSteps, name: str) -> str:
    machine = program.machine
    rotary = [machine.axes[i].name for i in machine.rotary]
    more = (
        "Insert the TOOL CALL of the calibrated touch probe where it is marked; its length must not act on M91 positions.",
        f"FN 16 adds one line per contact to TNC:/{name}.TXT with the format file TNC:/TWIN.A, which must exist and hold the following "
        "line, with its text between double quotes, after a line M_APPEND:",
        f"  %4.0f %2.0f %10.4f %10.4f %10.4f{' %9.4f' * len(rotary)} , Q20, Q21, Q10, Q11, Q12"
        + "".join(f", Q{22 + k}" for k in range(len(rotary))),
        f"pose, contact, {', '.join(program.linear_names)} at the contact in the machine system, {', '.join(rotary)}",
    )
    lines = [f"BEGIN PGM {name} MM"]
    for text in (*program.comments(*more[:2]), *more[2:]):
        lines.append(f"; {text}")
    lines += ["; TOOL CALL ... of the touch probe", "FUNCTION RESET TCPM", "PLANE RESET STAY"]
    words, pose = AxisWordsWriter(machine, lambda axis, value: f"{axis}{_signed(value)}"), 0
    for step in program.steps:
        if step.pose != pose:
            pose = step.pose
            lines += [f"; pose {pose}", f"Q20 = {pose}"]
            values = [step.position[i] for i in machine.rotary]
            if all(value == value for value in values):
                lines += [f"Q{22 + k} = {value:+.3f}" for k, value in enumerate(values)]
        if step.kind == "probe":
            vector = zip(program.linear_names, step.direction, strict=True)
            lines += [
                f"Q21 = {step.contact}",
                "TCH PROBE 4.0 MEASURING IN 3-D",
                "TCH PROBE 4.1 Q10",
                "TCH PROBE 4.2 " + " ".join(f"I{axis}{value:+.6f}" for axis, value in vector),
                f"TCH PROBE 4.3 DIST{step.distance_mm:+.3f} F{PROBING_FEED:g} MB{step.distance_mm:+.3f} REFERENCE SYSTEM:1",
                "FN 9: IF +Q13 EQU -1 GOTO LBL 99",
                f"FN 16: F-PRINT TNC:\\TWIN.A / TNC:\\{name}.TXT",
            ]
            words.forget()
            continue
        found = words.words(step.position)
        if found:
            feed = "FMAX" if step.kind == "rapid" else f"F{APPROACH_FEED:g}"
            lines.append(f"L {' '.join(found)} R0 {feed} M91")
    lines += ["L M30", "LBL 99", "; no contact within the search", "STOP", "LBL 0", f"END PGM {name} MM"]
    return "".join(f"{number} {line}\r\n" for number, line in enumerate(lines))


def _signed(value: str) -> str:
    return value if value.startswith("-") else f"+{value}"


HEIDENHAIN: Final = ProgramFormat(
    name="heidenhain",
    title="HEIDENHAIN TNC",
    suffixes=(".h",),
    source="HEIDENHAIN TNC 640 manuals: touch probe cycle 4, FN 9, FN 16, M91",
    unverified=(
        "Not run on a control. Which versions of the control have cycle 4, the place of its result parameters, whether the machine "
        "system of the results contains the tool length, and the format file of FN 16 are not verified."
    ),
    write=_text,
)
