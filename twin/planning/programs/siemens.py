"""Siemens SINUMERIK: touches with MEAS, logged with WRITE."""

from __future__ import annotations

from typing import Final

from twin.planning.programs.specification import (
    PROBING_FEED,
    AxisWordsWriter,
    ProgramFormat,
    ProgramStep,
    ProgramSteps,
)


def _text(program: ProgramSteps, name: str) -> str:
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
            lines += _without_motion(step)
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


def _without_motion(step: ProgramStep) -> list[str]:
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
        "Not run on a control. SUPA together with MEAS, the number of the probe, the folder of the log and its number of decimals are "
        "not verified."
    ),
    write=_text,
)
