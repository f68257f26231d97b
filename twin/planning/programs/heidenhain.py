"""Heidenhain plain language: touch probe cycle 4 (measuring in 3-D), logged with FN 16."""

from __future__ import annotations

from typing import Final

from twin.planning.programs.specification import (
    PROBING_FEED,
    AxisWordsWriter,
    ProgramFormat,
    ProgramStep,
    ProgramSteps,
)

ROTARY: Final = 205
"""First Q parameter of the rotary axes; Q201 to Q204 are results of the cycle: three coordinates and the status."""
SPHERE: Final = "Q220"
"""Q parameter of the number of the sphere."""


def _text(program: ProgramSteps, name: str) -> str:
    machine = program.machine
    rotary = [machine.axes[i].name for i in machine.rotary]
    entries = [*program.linear_names, *rotary]
    tool = "calibrated touch probe" if program.probing else "test tool"
    mask = " ".join((*(f"{axis}=%+.4lf" for axis in entries), "SPHERE=%.0lf"))
    numbers = ("Q201", "Q202", "Q203", *(f"Q{ROTARY + k}" for k in range(len(rotary))), SPHERE)
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
            lines += [f"; pose {pose}", *([f"{SPHERE} = {sphere}"] if program.probing else [])]
            values = [step.position[i] for i in machine.rotary]
            if program.probing and all(value == value for value in values):
                lines += [f"Q{ROTARY + k} = {value:+.3f}" for k, value in enumerate(values)]
        if not step.moves:
            lines += _without_motion(step)
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


def _without_motion(step: ProgramStep) -> list[str]:
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
        "Not run on a control. Which versions of the control have cycle 4, the place of its result parameters, whether the machine "
        "system of the results contains the tool length, and the format file of FN 16 are not verified."
    ),
    write=_text,
)
