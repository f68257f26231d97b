"""LinuxCNC probe log: the file that ``(PROBEOPEN name)`` opens and ``(PROBECLOSE)`` closes.

LinuxCNC manual, G-code overview, "Probe Logging" (docs/src/gcode/overview.adoc): the file receives the nine numbers X Y Z A B C U V W
of each successful straight probe (G38.n). Executed by LinuxCNC 2.9 (`tests/linuxcnc`), they are the parameters #5061 … #5069, in the
coordinate system and the units of the program, behind its work offset and tool length. G38.3 without a contact logs its end point.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin._common.units import count_with_noun
from twin.machine.machine import Machine
from twin.measurement.formats.base import (
    ContactRow,
    Conversion,
    FormatSpecification,
    Given,
    MeasuredFormat,
    file_lines,
    numbers_in,
    reduced,
)

AXES: Final = tuple("XYZABCUVW")
LINE: Final = re.compile(r"[-+.\deE]+(\s+[-+.\deE]+){8}")


@final
class LinuxCncProbeLog(MeasuredFormat):
    """LinuxCNC probe log."""

    specification = FormatSpecification(
        name="linuxcnc",
        title="LinuxCNC probe log",
        suffixes=(".txt", ".log", ".ngc"),
        gives="sphere centres",
        instrument="probe",
        needs="the work offset and, in Z, the tool length, if the coordinate system of the G38 was not that of the machine",
        source="LinuxCNC manual, G-code overview, sections Probe Logging and Numbered Parameters",
        unverified=(
            "that the program ran in mm (G21), and that its coordinates were not rotated (G10 L2 R)",
            "that every line is a contact: G38.3 and G38.5 log their end point without one",
        ),
    )

    def recognises(self, text: str) -> bool:
        """See `MeasuredFormat.recognises`."""
        return LINE.fullmatch(text.strip().split("\n", 1)[0].strip()) is not None

    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """See `MeasuredFormat.read`."""
        rows = []
        for number, text in file_lines(path):
            words = text.split()
            if len(words) != len(AXES):
                raise InputError(
                    count_with_noun(len(words), "number"),
                    expected="nine: X Y Z A B C U V W",
                    file=path,
                    line=number,
                    value=text,
                )
            values = dict(zip(AXES, numbers_in(words, "a coordinate", path, number), strict=True))
            for name, value in values.items():
                if name not in machine.names and value != 0.0:
                    raise InputError(
                        f"the machine has no axis {name}",
                        expected=f"zero, or one of {', '.join(machine.names)}",
                        file=path,
                        line=number,
                        value=f"{value:g}",
                    )
            rows.append(ContactRow(number, {name: value for name, value in values.items() if name in machine.names}))
        return reduced(rows, path, machine, given).with_notes(
            "assumed: every number is in mm or degrees; the coordinates plus the work offset are axis positions",
            "assumed: consecutive contacts in one pose are contacts with one sphere",
        )
