"""Compensation tables and kinematics of a machine's control: their formats, and the corrections that the control makes with them.

The `control:` section of a calibration file: which tables are active, and whether the errors were measured with them.

    control:
      errors_are: uncorrected
      tables:
        - {file: cec.mpf, format: siemens, classes: [L-POS, L-STR], sha256: 5f…}
      kinematics:
        - {file: kinchain.mpf, format: siemens-chain, classes: [R-POR], sha256: 90…}

``uncorrected``: the errors of the file are those of the machine without tables, and the control corrects part of them. A program is
corrected only for the remainder. ``remaining``: the errors were measured with the tables active and remain with them. A program is
corrected for all of them; a new table must be added to the old one and cannot replace it.

``live``: a kinematics module executes the errors of these calibrations in every cycle (`twin.compensation.live`).

``kinematics``: the control's transformation has the locations of the rotary axes in this file (`twin.controls.kinematics`). It
acts in tool centre point mode only, and new kinematics always replace the old ones: errors are measured without a transformation.
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
from twin._common.messages import Message
from twin.controls.correction import ControlCurve, ControlTerm, Correction, TableSum, TableSummary
from twin.controls.format import TableFormat
from twin.controls.formats import format_named, read_tables, table_formats
from twin.controls.kinematics import kinematics_formats, kinematics_named

ErrorsAre = Literal["uncorrected", "remaining"]


@final
@dataclass(frozen=True)
class TableEntry:
    """One file of the control.

    Attributes:
        format: name of its format, one of `twin.controls.formats` or, for kinematics, of `twin.controls.kinematics`.
        classes: classes of ISO/TR 16907 whose errors it corrects, completely or in part.
        sha256: SHA-256 of the file when it was recorded.
    """

    file: Path
    format: str
    classes: tuple[str, ...]
    sha256: str

    @classmethod
    def of(cls, file: Path, kind: str, classes: Sequence[str]) -> TableEntry:
        """Return the entry of a file with its current hash; raise `InputError` if it cannot be read."""
        return cls(file, kind, tuple(classes), file_sha256(file))

    def check(self) -> None:
        """Raise `InputError` if the file has changed since it was recorded or cannot be read."""
        if file_sha256(self.file) != self.sha256:
            what = "not the control table with which the calibration was written: the active corrections are unknown"
            expected = f"the file with sha256 {self.sha256[:12]}…, or a `control:` section with the tables active now"
            raise InputError(what, expected=expected, file=self.file, value=file_sha256(self.file)[:12] + "…")


@final
@dataclass(frozen=True)
class ControlSection:
    """The `control:` section of a calibration file.

    Attributes:
        tables: the tables active in the control.
        kinematics: the file of the transformation's kinematics, if they were written from a calibration; at most one.
        live: calibrations whose errors a kinematics module in the control corrects, completely.
        tool_length_mm: tool length for which tables and kinematics were made; None if it is not stated.
    """

    errors_are: ErrorsAre
    tables: tuple[TableEntry, ...]
    kinematics: tuple[TableEntry, ...] = ()
    live: tuple[TableEntry, ...] = ()
    tool_length_mm: float | None = None

    @property
    def entries(self) -> tuple[TableEntry, ...]:
        """All its files."""
        return (*self.tables, *self.kinematics, *self.live)

    @property
    def formats(self) -> tuple[str, ...]:
        """Formats of its tables, each once."""
        return tuple(dict.fromkeys(entry.format for entry in self.tables))

    @property
    def caution(self) -> str:
        """Warning that errors measured with active tables are valid for one tool length only; empty if it does not apply."""
        if self.errors_are == "uncorrected" or not any(format_named(name).knows_machine for name in self.formats):
            return ""
        return Message(
            "The control uses the length of the active tool: these errors were measured with its tables active and are valid only for "
            "the tool length at that time."
        )

    def to_entry(self, folder: Path | None) -> dict[str, Any]:
        """Return the entry for the file, with table files relative to ``folder``, if given."""

        def shown(file: Path) -> str:
            return str(file.resolve() if folder is None else os.path.relpath(file.resolve(), folder.resolve()))

        def listed(entries: Sequence[TableEntry]) -> list[dict[str, Any]]:
            return [
                {"file": shown(entry.file), "format": entry.format, "classes": [*entry.classes], "sha256": entry.sha256}
                for entry in entries
            ]

        found: dict[str, Any] = {"errors_are": self.errors_are, "tables": listed(self.tables)}
        more = {"kinematics": self.kinematics, "live": self.live}
        found |= {name: listed(entries) for name, entries in more.items() if entries}
        return found if self.tool_length_mm is None else found | {"tool_length_mm": self.tool_length_mm}

    def of(self, kind: str) -> tuple[TableEntry, ...]:
        """Return the tables of one format."""
        return tuple(entry for entry in self.tables if entry.format == kind)


def file_sha256(file: Path) -> str:
    """Return the SHA-256 of a file; raise `InputError` if it cannot be read."""
    return sha256(read_bytes(file)).hexdigest()


__all__ = [
    "ControlCurve",
    "ControlSection",
    "ControlTerm",
    "Correction",
    "TableEntry",
    "TableFormat",
    "TableSum",
    "TableSummary",
    "format_named",
    "kinematics_formats",
    "kinematics_named",
    "read_tables",
    "table_formats",
]
