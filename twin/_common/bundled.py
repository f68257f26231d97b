"""Files given by their path or, if they come with `twin`, by their name."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from twin._common.errors import InputError, closest_name
from twin._common.families import PROGRAM_SUFFIXES
from twin._common.files import names_beside

DEFAULT: Final = "dmu50"
"""Machine file that is used if none is named; it comes with twin."""
DEFAULT_ROTARY_LIMIT_DEG: Final = 0.5
"""Largest motion of a rotary axis to correct an orientation, degrees."""
DEFAULT_TOLERANCE_MM: Final = 0.01
"""Largest distance of a tool path with fewer blocks from the programmed one, mm."""
DEFAULT_ACCELERATION: Final = 5000.0
"""Acceleration of the axes of a control that executes a program for a check, mm/s² and °/s²."""
TRIALS: Final = 100_000
"""Number of machines drawn from a calibration's covariance."""
VOLUME_POSES: Final = 200
"""Number of positions at which each of them is evaluated."""


def bundled_folder() -> Path:
    """Return the folder of the machines that come with `twin`: inside the installed package, or next to it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "urdf"
    return inside if inside.is_dir() else package.parent / "urdf"


_SAMPLES: Final = Path(__file__).resolve().parents[1] / "samples"


def find_bundled(name: str | Path, suffix: str, expected: str) -> Path:
    """Return the path of a file given by its path or bundled name; raise `InputError`, which lists the bundled ones, otherwise."""
    path = Path(name)
    if is_file(path):
        return path
    bundled = bundled_folder()
    for candidate in (bundled / path.name, bundled / f"{path.name}{suffix}"):
        if path.parent == Path(".") and is_file(candidate):
            return candidate
    known = sorted(file.name for file in bundled.glob(f"*{suffix}") if file.name.count(".") == suffix.count("."))
    meant = [*known, *(name.removesuffix(suffix) for name in known)]
    raise InputError(
        "not found",
        expected=f"{expected}, or one that comes with twin ({', '.join(known)})",
        file=path,
        nearest=closest_name(path.name, meant),
    )


def find_program(path: str | Path) -> Path:
    """Return the path of a program: a file, else a sample program that comes with twin.

    Raises:
        InputError: there is neither.

    Examples:
        >>> program = twin.find_program("cone_frustum.nc")
        >>> program.name, program.exists()
        ('cone_frustum.nc', True)
    """
    path = Path(path)
    if path.exists():
        return path
    bundled = _SAMPLES / path.name
    if path.parent == Path() and bundled.is_file():
        return bundled
    known = {suffix for suffixes in PROGRAM_SUFFIXES.values() for suffix in suffixes}
    names = sorted(file.name for file in _SAMPLES.glob("*") if file.suffix in known)
    raise InputError(
        "no such program",
        expected=f"a file, or a program that comes with twin: {' '.join(names)}",
        file=path,
        nearest=closest_name(path.name, [*names, *names_beside(path)]),
    )


def is_file(path: Path) -> bool:
    """Return whether the path is that of a file; False for a path that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # name too long, or with an invalid character
        return False
