"""What the shell offers at the Tab key: names the options take, and files beside them.

`twin --install-completion` writes the shell's part once. Every function takes what is written so far and gives what may follow.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from twin.machine.effects import MACHINE_EFFECTS
from twin.machine.iso16907 import NAMES
from twin.machine.machine import DEFAULT, Machine, bundled_folder
from twin.measurement.instruments import INSTRUMENTS
from twin.nc import DIALECTS, find_program
from twin.samples import PLANS

YAML: Final = (".yaml", ".yml")


Completer = Callable[[str], list[str]]


def classes(incomplete: str) -> list[str]:
    """Classes of ISO/TR 16907."""
    return _begun(incomplete.upper(), NAMES)


def instruments(incomplete: str) -> list[str]:
    """Instruments."""
    return _begun(incomplete, [one.name for one in INSTRUMENTS])


def errors(ctx: Any, incomplete: str) -> list[str]:
    """ISO 230-1 names of the machine that was named before."""
    return _begun(incomplete.upper(), _names(ctx))


def aims(ctx: Any, incomplete: str) -> list[str]:
    """What a plan can make small."""
    return _begun(incomplete, ["tool", "everything", "weakest"]) + errors(ctx, incomplete)


def causes(ctx: Any, incomplete: str) -> list[str]:
    """Effects and where they can be, as two words in quotes."""
    machine = _machine(ctx)
    places = {one.name: one.places(machine) for one in MACHINE_EFFECTS if one.places(machine)}
    # Until the effect is written, its places would be a list of hundreds.
    effects = _begun(incomplete, sorted(places))
    if incomplete not in effects and " " not in incomplete:
        return effects
    return _begun(incomplete, [f"{effect} {where}" for effect, wheres in sorted(places.items()) for where in wheres])


def _machine(ctx: Any) -> Machine:
    try:
        return Machine.load(ctx.params.get("machine") or DEFAULT)
    except ValueError:
        return Machine.load(DEFAULT)


def _names(ctx: Any) -> tuple[str, ...]:
    machine = _machine(ctx)
    return (*machine.motion_names, *machine.squareness_names, *machine.location_names)


def _begun(incomplete: str, names: Any) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _bundled(suffix: str) -> list[str]:
    dots = suffix.count(".")
    files = sorted(file.name for file in bundled_folder().glob(f"*{suffix}") if file.name.count(".") == dots)
    return [name.removesuffix(suffix) for name in files]


def _samples(suffixes: tuple[str, ...]) -> list[str]:
    folder = find_program(PLANS[0].name).parent
    return [file.name for file in sorted(folder.iterdir()) if file.suffix in suffixes]


def _named_or_file(names: Callable[[], list[str]], suffixes: tuple[str, ...]) -> Completer:
    """Names of what comes with twin, and files with one of the suffixes."""
    return lambda incomplete: _begun(incomplete, names()) + _files(incomplete, suffixes)


def _files(incomplete: str, suffixes: tuple[str, ...]) -> list[str]:
    """Files with one of the suffixes, and folders, whose path begins so."""
    folder, _, begun = incomplete.rpartition("/")
    lead = f"{folder}/" if folder or incomplete.startswith("/") else ""
    try:
        entries = sorted(Path(lead or ".").iterdir())
    except OSError:
        return []
    found = []
    for entry in entries:
        if entry.name.startswith(begun) and (begun or not entry.name.startswith(".")):
            if entry.is_dir():
                found.append(f"{lead}{entry.name}/")
            elif entry.suffix.lower() in suffixes:
                found.append(f"{lead}{entry.name}")
    return found


PROGRAM: Final = tuple(sorted({suffix for dialect in DIALECTS for suffix in dialect.suffixes}))
machines = _named_or_file(lambda: _bundled(".yaml"), YAML)
calibrations = _named_or_file(list, YAML)
kits = _named_or_file(lambda: _bundled(".kit.yaml"), YAML)
layouts = _named_or_file(lambda: _samples((".yaml",)), YAML)
programs = _named_or_file(lambda: _samples(PROGRAM), PROGRAM)
plans = _named_or_file(lambda: [plan.name for plan in PLANS], (".csv",))
tables = _named_or_file(list, (".csv",))
