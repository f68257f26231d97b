"""Names that options list: ``{instruments}`` in the help of an option stands for the names of all instruments.

They come from `twin._common.families`, which imports nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, final

import typer
from typer.core import TyperCommand

from twin._common import families
from twin.machine.classes import NAMES

LISTS: Final[Mapping[str, Sequence[str]]] = MappingProxyType(
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
        "product_formats": families.PRODUCT_FORMATS,
        "other_tolerances": ("", *(f"{name} {1e-3 * um:g}" for name, um in families.TABLE_TOLERANCES_UM.items())),
        "table_counts": tuple(
            f"{name}: default {most}; {fewer}" for name, (most, fewer) in families.TABLE_COUNTS.items()
        ),
        "control_formats": (*families.TABLE_FORMATS, *families.KINEMATICS_FORMATS),
        "effects": tuple(name for name in families.EFFECTS if name not in families.ERROR_MOTIONS),
    }
)
"""Lists by their name: values of options, and facts about formats."""


def one_of(which: str) -> dict[str, Any]:
    """Return the arguments of `typer.Option` for an option whose value is one name of a list.

    Args:
        which: one of `LISTS`.
    """

    def checked(value: str) -> str:
        names = LISTS[which]
        if value not in names:
            raise typer.BadParameter(f"{value!r} is not one of {', '.join(map(repr, names))}.")
        return value

    def completed(incomplete: str) -> list[str]:
        return [name for name in LISTS[which] if name.startswith(incomplete)]

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
                        setattr(option, attribute, text.replace(f"{{{which}}}", joint.join(LISTS[which])))
        super().format_help(ctx, formatter)
