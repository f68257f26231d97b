"""Log of contacts that a Heidenhain control writes with ``FN 16: F-PRINT``, and the refusal of its own measuring logs.

The logs of the touch probe cycles themselves hold no sphere centres: for cycle 451 the manual (iTNC 530, 340 49x-05, Cycle Programming,
"Log function") lists angles, dispersion, backlash, the averaged positioning error and compensation values; those of cycles 408 to 431
hold features of a workpiece. They are refused. A program can write what is needed: ``TCH PROBE 0`` touches the sphere, ``FN 18:
SYSREAD`` with ``ID360 NR2`` reads the last touch point in machine coordinates, without radius and length of the probe (TNC 426/430
Technical Manual, ID360), and ``FN 16`` prints it with `MASK`, one entry for each axis of the machine. Q204 and Q205 are the rotary axes
as programmed; ``SPHERE`` (a number) and ``DX DY DZ`` (probing direction) are optional.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError, closest_name
from twin.machine.machine import Machine
from twin.measurement.formats.base import (
    ContactRow,
    Conversion,
    FormatSpecification,
    Given,
    MeasuredFormat,
    file_lines,
    number_in,
    reduced,
)

START: Final = "CONTACT"
MASK: Final = '"CONTACT X=%+.4lf Y=%+.4lf Z=%+.4lf B=%+.4lf C=%+.4lf SPHERE=%.0lf",Q201,Q202,Q203,Q204,Q205,Q206;'
"""Line of a mask for ``FN 16`` on a machine with the axes X, Y, Z, B, C."""
DIRECTION: Final = ("DX", "DY", "DZ")
SPHERE: Final = "SPHERE"
CYCLE_LOG: Final = re.compile(
    r"(?:measuring log|measurement log|messprotokoll)(?=[^;\t]*(?:TNC|TCH|probe|tastsystem|cycle|zyklus|kinemati))|TCH ?PROBE\s+4\d\d"
    r"|TCHPR4\d\d|(?:cycle|zyklus)\s+4\d\d",
    re.I,
)


@final
class HeidenhainContacts(MeasuredFormat):
    """Log of contacts written with FN 16."""

    specification = FormatSpecification(
        name="heidenhain",
        title="Heidenhain FN 16 log of contacts",
        suffixes=(".txt", ".a", ".log"),
        gives="sphere centres",
        instrument="probe",
        needs="positions of axes that the mask does not print",
        source="iTNC 530 Cycle Programming 340 49x-05 (log function of cycle 451); TNC 426/430 Technical Manual (FN 16, FN 18 ID360)",
        unverified=(
            "the mask on a control: it was written from the manual and not run",
            "that ID360 NR2 has the meaning of the TNC 426/430 on later controls",
        ),
    )

    def recognises(self, text: str) -> bool:
        """See `MeasuredFormat.recognises`."""
        head = text[:4000]
        return head.lstrip().startswith(START + " ") or CYCLE_LOG.search(head) is not None

    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """See `MeasuredFormat.read`."""
        rows: list[ContactRow] = []
        for line, text in file_lines(path):
            if CYCLE_LOG.search(text):
                raise InputError(
                    "the log of a touch probe cycle has no sphere centres",
                    expected=f"lines {START} X=… written with FN 16 (see the page on conversion); `twin import` reads tables",
                    file=path,
                    line=line,
                    value=text,
                )
            values = _entries(text, machine, path, line)
            sphere = values.pop(SPHERE, None)
            direction = [values.pop(name, float("nan")) for name in DIRECTION]
            if rows and values.keys() != rows[0].positions.keys():
                names = " ".join(rows[0].positions)
                raise InputError("other axes than before", expected=names, file=path, line=line, value=" ".join(values))
            name = "sphere" if sphere is None else f"{sphere:g}"
            rows.append(ContactRow(line, values, name, (direction[0], direction[1], direction[2])))
        return reduced(rows, path, machine, given).with_notes(
            "assumed: X, Y, Z are axis positions at the contact, without the radius of the tip",
            *(
                ()
                if SPHERE in file_words(path)
                else ("assumed: consecutive contacts in one pose are contacts with one sphere",)
            ),
        )


def file_words(path: Path) -> set[str]:
    """Return the names of all entries of a file."""
    return {entry.partition("=")[0] for _, text in file_lines(path) for entry in text.split()}


def _entries(text: str, machine: Machine, path: Path, line: int) -> dict[str, float]:
    words = text.split()
    if words[0] != START:
        raise InputError("not a contact", expected=f"{START} X=… Y=… Z=…", file=path, line=line, value=text)
    known, values = (*machine.names, SPHERE, *DIRECTION), {}
    for word in words[1:]:
        name, equals, number = word.partition("=")
        if not equals or name not in known or name in values:
            raise InputError(
                "unknown entry, or one given twice",
                expected=f"NAME=number, NAME one of {' '.join(known)}",
                file=path,
                line=line,
                value=word,
                nearest=closest_name(name, known),
            )
        values[name] = number_in(number, name, path, line)
    for name in ("X", "Y", "Z"):
        if name not in values:
            raise InputError(f"a contact without {name}", expected="X, Y and Z", file=path, line=line, value=text)
    return values
