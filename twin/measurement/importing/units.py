"""Units of imported columns, and their conversion into the units of a measurement table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType
from typing import Final, final

MOST_DIGITS: Final = 12
"""Number of digits from which a factor counts as rounded."""
_DEG_PER_RAD: Final = Decimal("57.29577951308232087679815481410517")


@final
@dataclass(frozen=True)
class Unit:
    """A unit.

    Attributes:
        name: its name in a mapping file.
        table_unit: unit of a measurement table into which it converts: the end of a column's name.
        factor: number of table units in one of it.
        zero: its zero in table units.
        words: further spellings, in lower case.
    """

    name: str
    table_unit: str
    factor: Decimal
    words: tuple[str, ...] = ()
    zero: Decimal = Decimal(0)

    def to_table(self, value: Decimal) -> Decimal:
        """Return a value in table units: exact where the factor is a finite decimal, else to 15 digits."""
        if self.factor == 1 and not self.zero:
            return value
        converted = value * self.factor + self.zero
        return converted if len(self.factor.as_tuple().digits) < MOST_DIGITS else Decimal(f"{converted:.15g}")


UNITS: Final = (
    Unit("mm", "mm", Decimal(1), ("millimeter", "millimetre", "millimeters")),
    Unit("m", "mm", Decimal(1000), ("meter", "metre", "meters")),
    Unit("cm", "mm", Decimal(10), ("centimeter",)),
    Unit("um", "mm", Decimal("0.001"), ("µm", "μm", "micron", "microns", "mikrometer", "my")),
    Unit("nm", "mm", Decimal("0.000001")),
    Unit("inch", "mm", Decimal("25.4"), ("in", "inches", "zoll", '"')),
    Unit("deg", "deg", Decimal(1), ("°", "degree", "degrees", "grad", "dd")),
    Unit("rad", "deg", _DEG_PER_RAD, ("radian", "radians", "radiant")),
    Unit("mrad", "deg", _DEG_PER_RAD / 1000),
    Unit("urad", "deg", _DEG_PER_RAD / 1_000_000, ("µrad", "μrad")),
    Unit("arcmin", "deg", 1 / Decimal(60), ("'",)),
    Unit("arcsec", "deg", 1 / Decimal(3600), ("''",)),
    Unit("degC", "degC", Decimal(1), ("°c", "celsius", "ºc", "c")),
    Unit("degF", "degC", Decimal(5) / 9, ("°f", "fahrenheit", "f"), Decimal(-160) / 9),
    Unit("K", "degC", Decimal(1), ("kelvin",), Decimal("-273.15")),
    Unit("s", "s", Decimal(1), ("sec", "sek", "seconds", "sekunden")),
    Unit("ms", "s", Decimal("0.001")),
    Unit("min", "s", Decimal(60), ("minutes", "minuten")),
    Unit("h", "s", Decimal(3600), ("hours", "stunden", "std")),
    Unit("rpm", "rpm", Decimal(1), ("1/min", "u/min", "min-1", "rev/min", "min^-1")),
    Unit("mm/min", "mm_min", Decimal(1), ("mm_min",)),
    Unit("m/min", "mm_min", Decimal(1000)),
    Unit("kg", "kg", Decimal(1)),
    Unit("g", "kg", Decimal("0.001")),
)
"""All units; an equal factor appears once for each quantity."""
_BY_WORD: Final[Mapping[str, Unit]] = MappingProxyType(
    {word: unit for unit in UNITS for word in (unit.name.casefold(), *unit.words)}
)


def unit_named(text: str) -> Unit | None:
    """Return the unit of that spelling, in any case; None if there is none."""
    return _BY_WORD.get(text.strip().casefold())


def table_unit(column: str) -> str:
    """Return the unit of a column of a measurement table: the end of its name; empty for words and directions."""
    ends = sorted({unit.table_unit for unit in UNITS}, key=len, reverse=True)
    return next((end for end in ends if column.endswith(f"_{end}")), "")


def units_of(column: str) -> tuple[Unit, ...]:
    """Return the units that can be converted into that of a column."""
    wanted = table_unit(column)
    return tuple(unit for unit in UNITS if unit.table_unit == wanted)
