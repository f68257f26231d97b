"""Shell completion (`twin --install-completion`): values of options, and files in the current folder.

Every function takes the incomplete word and returns its possible completions. ``{instruments}`` in the help of an option stands for
the names of all instruments, from `twin._common.families`, which imports nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeVar, final

import typer
from typer.core import TyperCommand

from twin._common import families
from twin._common.bundled import DEFAULT, bundled_folder
from twin._common.families import NAMES, PROGRAM_SUFFIXES
from twin.samples import PLANS

if TYPE_CHECKING:
    from twin.machine.machine import Machine

Completer = Callable[[str], list[str]]
LISTS: Final[Mapping[str, Sequence[str]]] = MappingProxyType(
    {
        "classes": NAMES,
        "instruments": tuple(families.INSTRUMENTS),
        "relative_instruments": families.SEQUENCE_INSTRUMENTS,
        "sequences": tuple(families.SEQUENCES),
        "drifts": tuple(families.DRIFTS),
        "artefacts": tuple(families.ARTEFACTS),
        "drift_instruments": families.DRIFT_INSTRUMENTS,
        "measured_formats": tuple(families.MEASURED_FORMATS),
        "table_formats": tuple(families.TABLE_FORMATS),
        "written_formats": (*families.TABLE_FORMATS, *families.LIVE_FORMATS),
        "kinematics_formats": tuple(families.KINEMATICS_FORMATS),
        "control_formats": (*families.TABLE_FORMATS, *families.KINEMATICS_FORMATS),
        "effects": tuple(families.EFFECTS),
    }
)
"""Lists by their name: values of options."""


def one_of(which: str) -> dict[str, Any]:
    """Return the arguments of `typer.Option` for an option whose value is one name of one of `LISTS`."""

    def checked(value: str) -> str:
        names = LISTS[which]
        if value not in names:
            raise typer.BadParameter(f"{value!r} is not one of {', '.join(map(repr, names))}.")
        return value

    return {"parser": checked, "metavar": f"[{{{which}}}]", "autocompletion": _listed(which)}


def _listed(which: str) -> Completer:
    """Return a completer of the names of one of `LISTS`."""
    return lambda incomplete: _starting_with(incomplete, LISTS[which])


@final
class ListingCommand(TyperCommand):
    """A command in whose help the lists are filled in."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, with the lists."""
        for option in self.params:
            for which in LISTS:
                for attribute, joint in (("help", ", "), ("metavar", "|")):
                    text = getattr(option, attribute, None)
                    if text and f"{{{which}}}" in text:
                        setattr(option, attribute, text.replace(f"{{{which}}}", joint.join(LISTS[which])))
        super().format_help(ctx, formatter)


YAML: Final = (".yaml", ".yml")

Found = TypeVar("Found")


def classes(incomplete: str) -> list[str]:
    """Complete a class of ISO/TR 16907."""
    return _starting_with(incomplete.upper(), LISTS["classes"])


def errors(ctx: Any, incomplete: str) -> list[str]:
    """Complete an ISO 230-1 error name of the machine given before on the line."""
    return _starting_with(incomplete.upper(), _names(ctx))


def aims(ctx: Any, incomplete: str) -> list[str]:
    """Complete an uncertainty that a plan can minimise."""
    return _starting_with(incomplete, ["tool", "everything", "weakest"]) + errors(ctx, incomplete)


def causes(ctx: Any, incomplete: str) -> list[str]:
    """Complete an effect and its location, two words in quotes."""
    # Until the effect is complete, listing all its locations would give hundreds of entries.
    effects = _starting_with(incomplete, sorted(LISTS["effects"]))
    if incomplete not in effects and " " not in incomplete:
        return effects
    from twin.model.effects import MACHINE_EFFECTS

    machine = _machine(ctx)
    places = {machine_effect.name: machine_effect.places(machine) for machine_effect in MACHINE_EFFECTS}
    return _starting_with(
        incomplete, [f"{effect} {where}" for effect, wheres in sorted(places.items()) for where in wheres]
    )


def _machine(ctx: Any) -> Machine:
    from twin.machine.machine import Machine

    return _from_machine(ctx, Machine.load)


def _from_machine(ctx: Any, read: Callable[[str], Found]) -> Found:
    """Return what ``read`` finds in the machine that is given; in the default one if that cannot be read."""
    try:
        return read(ctx.params.get("machine") or DEFAULT)
    except ValueError:
        return read(DEFAULT)


def _names(ctx: Any) -> tuple[str, ...]:
    """Return the names of the machine's errors; `_machine` would take as long as the rest of the completion together."""
    from twin._common.bundled import find_bundled
    from twin.machine.error_names import axes_of, component_names, location_names, squareness_names

    axes = _from_machine(ctx, lambda name: axes_of(find_bundled(name, ".yaml", "a machine file")))
    motions = [name for axis in axes for name in component_names(axis.name)]
    return (*motions, *squareness_names(axes), *location_names(axes))


def _starting_with(incomplete: str, names: Any) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _bundled(suffix: str) -> list[str]:
    dots = suffix.count(".")
    files = sorted(file.name for file in bundled_folder().glob(f"*{suffix}") if file.name.count(".") == dots)
    return [name.removesuffix(suffix) for name in files]


def _samples(suffixes: tuple[str, ...]) -> list[str]:
    return [file.name for file in sorted(PLANS[0].parent.iterdir()) if file.suffix in suffixes]


def _named_or_file(names: Callable[[], list[str]], suffixes: tuple[str, ...]) -> Completer:
    return lambda incomplete: _starting_with(incomplete, names()) + _files(incomplete, suffixes)


def _files(incomplete: str, suffixes: tuple[str, ...]) -> list[str]:
    """Return the folders, and the files with one of the suffixes, whose path starts with `incomplete`."""
    folder, _, start = incomplete.rpartition("/")
    lead = f"{folder}/" if folder or incomplete.startswith("/") else ""
    try:
        entries = sorted(Path(lead or ".").iterdir())
    except OSError:
        return []
    files = []
    for entry in entries:
        if entry.name.startswith(start) and (start or not entry.name.startswith(".")):
            if entry.is_dir():
                files.append(f"{lead}{entry.name}/")
            elif entry.suffix.lower() in suffixes:
                files.append(f"{lead}{entry.name}")
    return files


def programs(incomplete: str) -> list[str]:
    """Complete an NC program: one that comes with twin, or a file."""
    suffixes = tuple(sorted({suffix for some in PROGRAM_SUFFIXES.values() for suffix in some}))
    return _named_or_file(lambda: _samples(suffixes), suffixes)(incomplete)


artefacts, drifts, instruments, sequences = map(_listed, ("artefacts", "drifts", "instruments", "sequences"))
machines = _named_or_file(lambda: _bundled(".yaml"), YAML)
calibrations = _named_or_file(list, YAML)
kits = _named_or_file(lambda: _bundled(".kit.yaml"), YAML)
layouts = _named_or_file(lambda: _samples((".yaml",)), YAML)
plans = _named_or_file(lambda: [plan.name for plan in PLANS], (".csv",))
tables = _named_or_file(list, (".csv",))
