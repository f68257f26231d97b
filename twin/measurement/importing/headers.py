"""Meaning of a column's header: which quantity of a measurement table it gives, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType
from typing import Final, NamedTuple, final

from twin.machine.machine import Machine
from twin.measurement.columns import ANGLE_COLUMNS, PLACE_COLUMNS, STATION_COLUMNS, table_columns
from twin.measurement.table import CHANNEL

ROLES: Final[Mapping[str, frozenset[str]]] = MappingProxyType(
    {
        "command": frozenset(
            "soll sollwert sollwerte sollposition nominal nom nominals nominalwert nenn nennwert nennmass command commanded cmd set "
            "setpoint programmed prog target ref reference theo theoretical theor vorgabe vorgegeben angefahren "
            "anfahrposition".split()
        ),
        "measured": frozenset(
            "ist istwert istwerte actual act actuals meas measured measurement measure gemessen messwert messwerte mess istmass mp "
            "aktuell reading".split()
        ),
        "readback": frozenset(
            "readback encoder control reported display anzeige steuerung rueckmeldung geber massstab nc".split()
        ),
        "deviation": frozenset(
            "dev deviation deviations abw abweichung abweichungen delta diff difference differenz error err fehler residual tol "
            "toleranz tolerance d utol ltol otol utl ltl out outtol dx dy dz dmag mag dist distance".split()
        ),
        "uncertainty": frozenset(
            "u uncertainty unc uncert unsicherheit messunsicherheit standardunsicherheit sigma std stdabw stdev stddev stabw "
            "standardabweichung".split()
        ),
        "approach": frozenset(
            "approach anfahrrichtung anfahrt direction dir richtung fahrtrichtung verfahrrichtung".split()
        ),
        "temperature": frozenset("t temp temperature temperatur temps".split()),
    }
)
"""Role of a column, by its words beside the name of an axis."""

NOISE: Final = frozenset(
    "pos position positions achse axis axes koordinate koordinaten coordinate coordinates coord wert value values der die das the of "
    "des in for von und and linear rotary machine maschine maschinen tool tip drehtisch "
    "tisch table rundtisch schwenkachse drehachse linearachse".split()
)
"""Words without a meaning of their own in the name of a column."""

NAMES: Final[Mapping[str, frozenset[str]]] = MappingProxyType(
    {
        "target": frozenset(
            {"target", "target name", "reflector", "reflektor", "smr", "ball", "kugel", "sphere", "prism", "nest", "reflector name"}
        ),
        "point": frozenset(
            {
                "point", "point name", "point id", "pt", "punkt", "punktname", "punkt name", "punkt nr", "punktnummer", "messpunkt",
                "messpunkt nr", "name", "id", "label", "bezeichnung", "feature", "feature name", "feature id", "merkmal", "element",
                "object", "objekt", "messstelle", "measuring point", "punkt id", "point no", "point number", "target id", "p",
            }
        ),
        "index": frozenset(
            {"nr", "no", "lfd nr", "lfd", "nummer", "number", "index", "row", "zeile", "line", "i", "n",
             "messung nr", "seq", "satz", ""}
        ),
        "carrier": frozenset({"carrier", "traeger", "seite", "side", "mounted on", "montiert an", "befestigt an", "sits on"}),
        "station": frozenset(
            {"station", "standpunkt", "aufstellung", "instrument station", "station name", "geraetestandpunkt", "setup"}
        ),
        "round": frozenset(
            {
                "round", "runde", "durchgang", "lauf", "run", "serie", "series", "cycle", "zyklus", "wiederholung", "repeat",
                "repetition", "messreihe", "pass",
            }
        ),
        "datetime": frozenset(
            {"timestamp", "zeitstempel", "date time", "datetime", "datum zeit", "datum uhrzeit", "date and time", "time stamp"}
        ),
        "date": frozenset({"date", "datum", "tag", "day"}),
        "time": frozenset({"time", "zeit", "uhrzeit", "clock", "t", "messzeit", "elapsed", "elapsed time", "time of day"}),
        "spindle_rpm": frozenset({"spindle speed", "spindle", "speed", "drehzahl", "spindeldrehzahl", "rpm", "spindle rpm"}),
        "feed_mm_min": frozenset({"feed", "feed rate", "feedrate", "vorschub", "f", "bahnvorschub"}),
        "load_kg": frozenset({"load", "last", "beladung", "zuladung", "gewicht", "mass", "masse", "payload"}),
        "ignored": frozenset({"remark", "bemerkung", "bemerkungen", "comment", "kommentar", "note",
             "notiz", "operator", "pruefer", "bediener"}),
    }
)  # fmt: skip
"""Meaning of a column without the name of an axis, by its words."""

CARRIER_WORDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        **dict.fromkeys(
            ("tool", "werkzeug", "spindel", "spindle", "head", "kopf", "werkzeugseite", "tool side"), "tool"
        ),
        **dict.fromkeys(
            (
                "work",
                "werkstueck",
                "workpiece",
                "tisch",
                "table",
                "drehtisch",
                "rotary table",
                "werkstueckseite",
                "work side",
            ),
            "work",
        ),
    }
)
"""Sides of the machine, by the words of a cell."""

UP_WORDS: Final = frozenset(
    "+ 1 +1 up pos positive positiv vor vorwaerts forward forwards fwd hin aufwaerts auf > plus".split()
)
DOWN_WORDS: Final = frozenset(
    "- -1 down neg negative negativ zurueck rueckwaerts backward backwards bwd back rueck abwaerts ab < minus reverse".split()
)
UNKNOWN_WORDS: Final = frozenset("0 none unknown unbekannt ? n/a".split())
"""Words of a cell that give the direction of approach: towards larger positions, towards smaller ones, unknown."""

_LETTERS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "é": "e"})


def plain_words(text: str) -> str:
    """Return a text in lower case with German letters written as two."""
    return text.casefold().translate(_LETTERS).strip()


def direction_of(cell: str) -> int | None:
    """Return +1, −1 or 0 (unknown) for a cell that gives a direction of approach; None if it gives none."""
    word = plain_words(cell).replace("−", "-").replace("↑", "+").replace("↓", "-")
    if word in UP_WORDS:
        return 1
    if word in DOWN_WORDS:
        return -1
    return 0 if not word or word in UNKNOWN_WORDS else None


# --- Units of imported columns, and their conversion into the units of a measurement table --------

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


# --- Meaning of a column's header: which quantity of a measurement table it gives, and in which unit

_BRACKETS: Final = re.compile(r"\s*[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$")
_SUFFIX: Final = re.compile(r"(?:\s+in\s+|\s*[/,]\s*|\s+|_)([^\s_,/]+(?:/min)?)$")
_CAMEL: Final = re.compile(r"(?<=[a-zäöü])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-zäöü])")


class Meaning(NamedTuple):
    """Meaning of a header.

    Attributes:
        kind: ``exact`` (a column of a measurement table), a role (`twin.measurement.importing.headers.ROLES`), ``bare`` (an axis
            without a role), a name (`NAMES`), ``sensor`` (a temperature), or empty if unknown.
        name: name of the column, axis or sensor.
        unit: unit that the header gives; empty if none.
        certain: whether all words are known.
    """

    kind: str = ""
    name: str = ""
    unit: str = ""
    certain: bool = True


def table_names(machine: Machine) -> tuple[str, ...]:
    """Return the columns that a measurement table of this machine can have, without temperatures and channels."""
    angles = tuple(f"{prefix}{name}" for prefix in ("", "u_") for name in ANGLE_COLUMNS)
    return (
        *(name for part in table_columns(machine) for name in part.columns),
        *angles,
        *PLACE_COLUMNS,
        *STATION_COLUMNS,
    )


def is_table_column(name: str, machine: Machine) -> bool:
    """Return whether a measurement table of this machine can have a column of this name."""
    return name in table_names(machine) or bool(re.fullmatch(r"T_.+_degC", name) or CHANNEL.fullmatch(name))


def meaning_of(header: str, machine: Machine) -> Meaning:
    """Return the meaning of a header."""
    if is_table_column(header, machine):
        return Meaning("exact", header)
    text, unit = _without_unit(header)
    words = _words(text, machine)
    joined = " ".join(words)
    for kind, phrases in NAMES.items():
        if joined in phrases and not (joined in ("", "t") and unit.casefold() in ("°c", "degc", "k", "c")):
            return Meaning(kind, kind, unit)
    axes = {axis.casefold(): axis for axis in machine.names}
    meant = [word for word in words if word in axes or word in ("x", "y", "z")]
    rest = [word for word in words if word not in meant and word not in NOISE]
    known = unit_named(unit)
    temperature = ROLES["temperature"] & {*rest} or (known is not None and known.table_unit == "degC")
    if temperature:
        name = "_".join(word for word in [*meant, *rest] if word not in ROLES["temperature"]) or "air"
        return Meaning("temperature", axes.get(name, name), unit)
    if len(meant) != 1:
        role = next(
            (role for role, known in ROLES.items() if {*rest} & known and role in ("approach", "deviation")), ""
        )
        return Meaning(role, "", unit)
    axis = axes.get(meant[0], meant[0])
    if not rest:
        return Meaning("bare", axis, unit)
    roles = [
        role
        for role in ("deviation", "uncertainty", "approach", "readback", "command", "measured")
        if ROLES[role] & {*rest}
    ]
    if not roles:
        # Few programs give anything but the position of a rotary axis; a linear axis has offsets, corrections and more.
        is_rotary = axis in machine.by_name and not machine.by_name[axis].linear
        return Meaning("bare" if is_rotary else "", axis, unit, certain=not is_rotary)
    role = roles[0]
    return Meaning(role, axis, unit, certain=len(roles) == 1 and all(word in ROLES[role] for word in rest))


def _without_unit(header: str) -> tuple[str, str]:
    """Return a header without its unit, and the unit; empty if it gives none."""
    for pattern in (_BRACKETS, _SUFFIX):
        match = pattern.search(header)
        if match and match.start() and unit_named(match[1]) is not None and len(match[1]) + (pattern is _BRACKETS) > 1:
            return header[: match.start()], match[1]
    match = re.fullmatch(r"(.*\S)\s*([°µ\"]\S*)", header)
    if match and unit_named(match[2]) is not None:
        return match[1], match[2]
    return header, ""


def _words(text: str, machine: Machine) -> list[str]:
    """Return the words of a name in lower case; ``XIst``, ``x_ist`` and ``Xist`` give two words."""
    split = _CAMEL.sub(" ", text)
    words = [word for word in re.split(r"[^a-z0-9+]+", plain_words(split)) if word]
    axes = {"x", "y", "z", *(axis.casefold() for axis in machine.names)}
    roles = frozenset().union(*ROLES.values())
    found = []
    for word in words:
        axis = next((axis for axis in axes if word.startswith(axis) and word[len(axis) :] in roles - {"t", "u"}), None)
        last = next((axis for axis in axes if word.endswith(axis) and word[: -len(axis)] in roles - {"t"}), None)
        if word in roles or word in axes or (axis is None and last is None):
            found.append(word)
        elif axis is not None:
            found += [axis, word[len(axis) :]]
        elif last is not None:
            found += [word[: -len(last)], last]
    return found
