"""Names that options list: ``{instruments}`` in the help of an option stands for the names of all instruments.

The names come from `twin._common.families`; what else the help of `twin control` says of the formats is imported when it is printed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, final

import typer
from typer.core import TyperCommand

from twin._common import families
from twin.machine.classes import NAMES

USUAL_TOLERANCE_UM: Final = 1.0
"""Default tolerance of most formats of tables."""


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


NAMES_OF: Final[Mapping[str, Sequence[str]]] = MappingProxyType(
    {
        "classes": NAMES,
        "instruments": tuple(families.INSTRUMENTS),
        "relative_instruments": families.SEQUENCE_INSTRUMENTS,
        "sequences": tuple(families.SEQUENCES),
        "drifts": tuple(families.DRIFTS),
        "drift_instruments": families.DRIFT_INSTRUMENTS,
        "measured_formats": tuple(families.MEASURED_FORMATS),
        "table_formats": tuple(families.TABLE_FORMATS),
        "kinematics_formats": tuple(families.KINEMATICS_FORMATS),
        "control_formats": (*families.TABLE_FORMATS, *families.KINEMATICS_FORMATS),
        "effects": tuple(name for name in families.EFFECTS if name not in families.ERROR_MOTIONS),
    }
)
"""Names that an option can have as its value, by list."""
FACTS: Final[Mapping[str, Callable[[], list[str]]]] = MappingProxyType(
    {
        "other_tolerances": _other_tolerances,
        "table_counts": _table_counts,
        "product_formats": _product_formats,
    }
)
"""Other lists of the help texts, each as a function that imports what it describes."""


def one_of(which: str) -> dict[str, Any]:
    """Return the arguments of `typer.Option` for an option whose value is one name of a list.

    Args:
        which: one of `NAMES_OF`.
    """

    def checked(value: str) -> str:
        names = NAMES_OF[which]
        if value not in names:
            raise typer.BadParameter(f"{value!r} is not one of {', '.join(map(repr, names))}.")
        return value

    def completed(incomplete: str) -> list[str]:
        return [name for name in NAMES_OF[which] if name.startswith(incomplete)]

    return {"parser": checked, "metavar": f"[{{{which}}}]", "autocompletion": completed}


def _shown(which: str) -> Sequence[str]:
    return NAMES_OF[which] if which in NAMES_OF else FACTS[which]()


@final
class ListingCommand(TyperCommand):
    """A command in whose help the lists are filled in."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, with the lists."""
        for option in self.params:
            for which in (*NAMES_OF, *FACTS):
                for attribute, joint in (("help", ", "), ("metavar", "|")):
                    text = getattr(option, attribute, None)
                    if text and f"{{{which}}}" in text:
                        setattr(option, attribute, text.replace(f"{{{which}}}", joint.join(_shown(which))))
        super().format_help(ctx, formatter)
