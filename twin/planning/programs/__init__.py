"""Programs for controls: a touch probe finds the spheres of a plan, or a drift test runs by its schedule.

A new control is a function and a `ProgramFormat` in `controls`, listed in `PROGRAMS`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin.nc import dialect_for
from twin.planning.programs.controls import HEIDENHAIN, LINUXCNC, SIEMENS, ProgramFormat, ProgramStep, ProgramSteps
from twin.planning.programs.steps import drift_steps, program_steps

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


__all__ = [
    "PROGRAMS",
    "ProgramFormat",
    "ProgramStep",
    "ProgramSteps",
    "drift_steps",
    "format_of",
    "program_steps",
    "write_program",
]
