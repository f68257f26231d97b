"""Where a report comes from: files with their digests, programs with their versions, seeds."""

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
from twin.machine.control.section import digest
from twin.uncertainty.budget import SEED

MORE: Final = ("matplotlib", "meshcat")
MISSING: Final = "not installed"


@final
@dataclass(frozen=True)
class Source:
    """One file.

    Attributes:
        role: what it is.
        path: where it was.
        sha256: of its bytes.
    """

    role: str
    path: str
    sha256: str


@final
@dataclass(frozen=True)
class Sources:
    """Everything a report was made of.

    Attributes:
        files: with their digests.
        programs: name and version.
        seeds: of draws, by what is drawn.
        made: when.
    """

    files: tuple[Source, ...]
    programs: Mapping[str, str]
    seeds: Mapping[str, int]
    made: datetime

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return json_form(self, leave_out=("made",)) | {"made": self.made.isoformat(timespec="seconds")}


def sources(
    calibration: Calibration, identified: Path | None, measured: Sequence[Path], seed: int, made: datetime
) -> Sources:
    """What a report of a calibration is made of.

    Args:
        calibration: and its machine.
        identified: JSON of the identification, if given.
        measured: tables, if given.
        seed: of the draws of what is not known.
        made: when.

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
    # Of the control's tables what the calibration says of them: where they are not read, they need not be here.
    tables = () if calibration.control is None else calibration.control.tables
    return Sources(
        files=(
            *(Source(role, str(path), digest(path)) for role, path in files),
            *(Source(f"table in the control ({one.format})", str(one.file), one.sha256) for one in tables),
        ),
        programs=MappingProxyType(
            versions() | {"python": platform.python_version()} | {name: _version(name) for name in MORE}
        ),
        seeds=MappingProxyType(
            {"poses of the volume and sides of approach": SEED, "what is not known of the calibration": seed}
        ),
        made=made,
    )


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return MISSING
