"""What a calibration file says of its machine's control: which tables are switched on, and whether its errors were measured with them.

    control:
      errors_are: uncorrected
      tables:
        - {file: cec.mpf, format: siemens, classes: [L-POS, L-STR], sha256: 5f…}

``uncorrected``: the errors of the file are those of the bare machine, and the control takes its part out of them by itself. Whoever
corrects a program must correct only what it leaves. ``remaining``: the errors were measured with the tables on, and are what those
leave. A program is corrected for them as they are; a new table is added to the old one, never put in its place.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, final

from twin._common.errors import InputError
from twin._common.files import read_bytes
from twin.machine.control.formats import FORMATS

ErrorsAre = Literal["uncorrected", "remaining"]


@final
@dataclass(frozen=True)
class TableEntry:
    """One file of the control.

    Attributes:
        file: where it is.
        format: its kind, one of `twin.machine.control.FORMATS`.
        classes: classes of ISO/TR 16907 whose errors it takes out, as far as it can.
        sha256: of the file's bytes when it was entered.
    """

    file: Path
    format: str
    classes: tuple[str, ...]
    sha256: str

    @classmethod
    def of(cls, file: Path, kind: str, classes: Sequence[str]) -> TableEntry:
        """The entry of a file as it is now.

        Raises:
            InputError: it cannot be read.
        """
        return cls(file, kind, tuple(classes), digest(file))

    def check(self) -> None:
        """Nothing, if the file is the one that was entered.

        Raises:
            InputError: it is another one by now, or cannot be read.
        """
        if digest(self.file) != self.sha256:
            raise InputError(
                "not the control table the calibration was written with: what the control corrects is not known",
                expected=f"the file with sha256 {self.sha256[:12]}…, or a `control:` section that says what is on now",
                file=self.file,
                value=digest(self.file)[:12] + "…",
            )


@final
@dataclass(frozen=True)
class ControlSection:
    """The section as it is written.

    Attributes:
        errors_are: ``uncorrected`` or ``remaining``.
        tables: the files that are switched on in the control, at least one.
    """

    errors_are: ErrorsAre
    tables: tuple[TableEntry, ...]

    @property
    def formats(self) -> tuple[str, ...]:
        """Kinds of its tables, each once."""
        return tuple(dict.fromkeys(entry.format for entry in self.tables))

    @property
    def caution(self) -> str:
        """What is to be minded where the errors are those its tables leave: a sentence, or nothing."""
        counted = {form.name for form in FORMATS if form.knows_machine}
        if self.errors_are == "uncorrected" or counted.isdisjoint(self.formats):
            return ""
        return (
            "The control counts the active tool in: these errors are what it left with the tool that was active while measuring, "
            "and hold for that length alone."
        )

    def to_entry(self, folder: Path | None) -> dict[str, Any]:
        """As the file has it; table files named as seen from a folder, if one is given."""

        def shown(file: Path) -> str:
            return str(file.resolve() if folder is None else os.path.relpath(file.resolve(), folder.resolve()))

        return {
            "errors_are": self.errors_are,
            "tables": [
                {"file": shown(one.file), "format": one.format, "classes": list(one.classes), "sha256": one.sha256}
                for one in self.tables
            ],
        }

    def of(self, kind: str) -> tuple[TableEntry, ...]:
        """The tables of one kind."""
        return tuple(entry for entry in self.tables if entry.format == kind)


def digest(file: Path) -> str:
    """The sha256 of a file's bytes.

    Raises:
        InputError: it cannot be read.
    """
    return sha256(read_bytes(file)).hexdigest()
