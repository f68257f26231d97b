"""Names that options list: ``{instruments}`` in the help of an option stands for the names of all instruments.

The modules with the names are imported only when a help text is printed, or when such an option is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final, final

import typer
from typer.core import TyperCommand

_REGISTRIES: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "classes": ("twin.machine.classes", "NAMES"),
        "instruments": ("twin.measurement.instruments", "INSTRUMENTS"),
        "relative_instruments": ("twin.planning.sequences", "SET_UPS"),
        "sequences": ("twin.planning.sequences", "SEQUENCES"),
        "drifts": ("twin.planning.drift", "DRIFTS"),
        "drift_instruments": ("twin.planning.drift", "INSTRUMENTS"),
        "measured_formats": ("twin.measurement.formats", "FORMATS"),
        "table_formats": ("twin.machine.control", "FORMATS"),
        "kinematics_formats": ("twin.machine.control.kinematics", "KINEMATICS"),
    }
)
"""Module and registry of names, or of things that have one."""
USUAL_TOLERANCE_UM: Final = 1.0
"""Default tolerance of most formats of tables."""


def _registered(which: str) -> list[str]:
    module, registry = _REGISTRIES[which]
    return [getattr(one, "name", one) for one in getattr(import_module(module), registry)]


def _control_formats() -> list[str]:
    return [*_registered("table_formats"), *_registered("kinematics_formats")]


def _other_tolerances() -> list[str]:
    from twin.machine.control import FORMATS

    others = (one for one in FORMATS if one.tolerance_um != USUAL_TOLERANCE_UM)
    return ["", *(f"{one.name} {one.tolerance_um * 1e-3:g}" for one in others)]


def _table_counts() -> list[str]:
    from twin.machine.control import FORMATS

    return ["; ".join(f"{one.name}: default {one.tables}; {one.fewer_tables}" for one in FORMATS if one.tables)]


def _product_formats() -> list[str]:
    from twin.machine.control import FORMATS

    return [one.name for one in FORMATS if one.products]


LISTS: Final[Mapping[str, Callable[[], list[str]]]] = MappingProxyType(
    {which: partial(_registered, which) for which in _REGISTRIES}
    | {
        "control_formats": _control_formats,
        "other_tolerances": _other_tolerances,
        "table_counts": _table_counts,
        "product_formats": _product_formats,
    }
)


def names_of(which: str) -> Sequence[str]:
    """Return the names of a list; ``which``: one of `LISTS`."""
    return LISTS[which]()


def one_of(which: str) -> dict[str, Any]:
    """Return the arguments of `typer.Option` for an option whose value is one name of a list.

    Args:
        which: one of `LISTS`.
    """

    def checked(value: str) -> str:
        names = names_of(which)
        if value not in names:
            raise typer.BadParameter(f"{value!r} is not one of {', '.join(map(repr, names))}.")
        return value

    def completed(incomplete: str) -> list[str]:
        return [name for name in names_of(which) if name.startswith(incomplete)]

    return {"parser": checked, "metavar": f"[{{{which}}}]", "autocompletion": completed}


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
                        setattr(option, attribute, text.replace(f"{{{which}}}", joint.join(names_of(which))))
        super().format_help(ctx, formatter)
