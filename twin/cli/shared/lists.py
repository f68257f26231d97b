"""Names that options list: ``{instruments}`` in the help of an option stands for the names of all instruments.

The modules with the names are imported only when a help text is printed, or when such an option is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, final

import typer
from typer.core import TyperCommand


def _classes() -> list[str]:
    from twin.machine.classes import NAMES

    return list(NAMES)


def _instruments() -> list[str]:
    from twin.measurement.instruments import INSTRUMENTS

    return _names(INSTRUMENTS)


def _relative_instruments() -> list[str]:
    from twin.planning.sequences import SET_UPS

    return list(SET_UPS)


def _sequences() -> list[str]:
    from twin.planning.sequences import SEQUENCES

    return _names(SEQUENCES)


def _drifts() -> list[str]:
    from twin.planning.drift import DRIFTS

    return _names(DRIFTS)


def _drift_instruments() -> list[str]:
    from twin.planning.drift import INSTRUMENTS

    return list(INSTRUMENTS)


def _measured_formats() -> list[str]:
    from twin.measurement.formats import FORMATS

    return _names(FORMATS)


def _table_formats() -> list[str]:
    from twin.machine.control import FORMATS

    return _names(FORMATS)


def _kinematics_formats() -> list[str]:
    from twin.machine.control.kinematics import KINEMATICS

    return _names(KINEMATICS)


def _other_tolerances() -> list[str]:
    from twin.machine.control import FORMATS

    usual_um = 1.0
    return ["", *(f"{one.name} {one.tolerance_um * 1e-3:g}" for one in FORMATS if one.tolerance_um != usual_um)]


def _table_counts() -> list[str]:
    from twin.machine.control import FORMATS

    return ["; ".join(f"{one.name}: default {one.tables}; {one.fewer_tables}" for one in FORMATS if one.tables)]


def _product_formats() -> list[str]:
    from twin.machine.control import FORMATS

    return _names(one for one in FORMATS if one.products)


LISTS: Final[Mapping[str, Callable[[], list[str]]]] = MappingProxyType(
    {
        "classes": _classes,
        "instruments": _instruments,
        "relative_instruments": _relative_instruments,
        "sequences": _sequences,
        "drifts": _drifts,
        "drift_instruments": _drift_instruments,
        "measured_formats": _measured_formats,
        "table_formats": _table_formats,
        "kinematics_formats": _kinematics_formats,
        "control_formats": lambda: [*_table_formats(), *_kinematics_formats()],
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


def _names(registered: Iterable[Any]) -> list[str]:
    return [one.name for one in registered]
