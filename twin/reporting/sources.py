"""Sources of a report: files with their SHA-256 digests, versions of programs, random seeds."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

from twin._common.json_form import json_form
from twin.compute.parallel.versions import versions
from twin.machine.calibration import Calibration
from twin.machine.control.section import file_sha256
from twin.uncertainty.budget import SEED

MORE: Final = ("matplotlib", "meshcat")
MISSING: Final = "not installed"


@final
@dataclass(frozen=True)
class Source:
    """One source file.

    Attributes:
        role: kind of file, in words.
        path: its path.
        sha256: SHA-256 digest of its bytes, in hexadecimal.
    """

    role: str
    path: str
    sha256: str


@final
@dataclass(frozen=True)
class Sources:
    """Files, programs and seeds from which a report was made.

    Attributes:
        files: the source files.
        programs: version of every program, by name.
        seeds: random seeds, by their use.
        made: date and time.
    """

    files: tuple[Source, ...]
    programs: Mapping[str, str]
    seeds: Mapping[str, int]
    made: datetime

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, leave_out=("made",)) | {"made": self.made.isoformat(timespec="seconds")}


def sources(
    calibration: Calibration, identified: Path | None, measured: Sequence[Path], seed: int, made: datetime
) -> Sources:
    """Return the sources of a report.

    Args:
        calibration: the calibration, with its machine.
        identified: JSON file of the identification, or None.
        measured: measurement tables.
        seed: random seed of the draws from the covariance.
        made: date and time.

    Raises:
        InputError: a file cannot be read.
    """
    machine = calibration.machine
    files = [("machine file", machine.path), ("URDF", machine.urdf)]
    if calibration.path is not None:
        files.append(("calibration", calibration.path))
    if identified is not None:
        files.append(("identification", identified))
    files += [("measured", path) for path in measured]
    # The control's tables as listed in the calibration: they are not read, so the files may be absent.
    tables = () if calibration.control is None else calibration.control.entries
    return Sources(
        files=(
            *(Source(role, str(path), file_sha256(path)) for role, path in files),
            *(Source(f"table in the control ({one.format})", str(one.file), one.sha256) for one in tables),
        ),
        programs=MappingProxyType(
            versions() | {"python": platform.python_version()} | {name: _version(name) for name in MORE}
        ),
        seeds=MappingProxyType({"poses and directions of approach": SEED, "uncertainty of the calibration": seed}),
        made=made,
    )


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return MISSING
