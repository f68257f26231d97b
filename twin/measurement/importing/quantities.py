"""Quantities of other programs' tables: the number and unit of a cell, and which quantity a header names, by the vocabulary."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, final

import yaml

from twin.machine.machine import Machine
from twin.measurement.columns import ANGLE_COLUMNS, PLACE_COLUMNS, STATION_COLUMNS, table_columns
from twin.measurement.table import CHANNEL

# --- Units of imported columns, and their conversion into the units of a measurement table --------

MOST_DIGITS: Final = 12
"""Number of digits from which a factor counts as rounded."""
_DEG_PER_RAD: Final = Decimal("57.29577951308232087679815481410517")


@final
@dataclass(frozen=True)
class Unit:
    """A unit.

    ``table_unit``: unit of a measurement table into which it converts: the end of a column's name; ``factor``: number of table units in
    one of it; ``zero``: its zero in table units; ``packed``: degrees before the decimal sign, minutes and seconds in two digits each
    behind it, as theodolites show them (45.3030 is 45° 30′ 30″).
    """

    name: str
    table_unit: str
    factor: Decimal
    words: tuple[str, ...] = ()
    zero: Decimal = Decimal(0)
    packed: bool = False

    def to_table(self, value: Decimal) -> Decimal | None:
        """Return a value in table units: exact where the factor is a finite decimal, else to 15 digits; None if it is none.

        No value of a packed unit has 60 minutes or seconds, or more.
        """
        if self.packed:
            degrees, rest = divmod(abs(value), 1)
            minutes, seconds = divmod(100 * rest, 1)
            if minutes >= SIXTY or 100 * seconds >= SIXTY:
                return None
            size = degrees + minutes / SIXTY + 100 * seconds / SIXTY**2
            return Decimal(f"{size.copy_sign(value):.15g}")
        if self.factor == 1 and not self.zero:
            return value
        converted = value * self.factor + self.zero
        return converted if len(self.factor.as_tuple().digits) < MOST_DIGITS else Decimal(f"{converted:.15g}")


UNITS: Final = (
    Unit(
        "mm", "mm", Decimal(1), ("millimeter", "millimetre", "millimeters", "millimetres", "millimètre", "millimètres")
    ),
    Unit("m", "mm", Decimal(1000), ("meter", "metre", "meters", "metres", "metern", "mètre", "mètres")),
    Unit("cm", "mm", Decimal(10), ("centimeter", "centimetre", "centimeters", "centimetres", "zentimeter")),
    Unit(
        "um",
        "mm",
        Decimal("0.001"),
        ("µm", "μm", "micron", "microns", "mikrometer", "my", "micrometer", "micrometre", "micrometers", "micrometres"),
    ),
    Unit("nm", "mm", Decimal("0.000001")),
    Unit("inch", "mm", Decimal("25.4"), ("in", "inches", "zoll", "pouce", "pouces", '"')),
    Unit("deg", "deg", Decimal(1), ("°", "º", "degree", "degrees", "grad", "degré", "degrés", "dd")),
    Unit("d.mmss", "deg", Decimal(1), ("dms", "d.ms", "dd.mmss", "ddd.mmss", "gms", "g.mmss"), packed=True),
    Unit("gon", "deg", Decimal("0.9"), ("gons", "gradian", "gradians", "grads", "neugrad")),
    Unit("rad", "deg", _DEG_PER_RAD, ("radian", "radians", "radiant")),
    Unit("mrad", "deg", _DEG_PER_RAD / 1000),
    Unit("urad", "deg", _DEG_PER_RAD / 1_000_000, ("µrad", "μrad")),
    Unit("arcmin", "deg", 1 / Decimal(60), ("'", "′")),
    Unit("arcsec", "deg", 1 / Decimal(3600), ("''", "″", '"', "arcsecond", "arcseconds", "bogensekunden")),
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


def _by_word() -> dict[str, tuple[Unit, ...]]:
    by_word: dict[str, tuple[Unit, ...]] = {}
    for unit in UNITS:
        for word in (unit.name.casefold(), *unit.words):
            by_word[word] = (*by_word.get(word, ()), unit)
    return by_word


_BY_WORD: Final[Mapping[str, tuple[Unit, ...]]] = MappingProxyType(_by_word())


@lru_cache(maxsize=4096)
def unit_named(text: str, column: str = "") -> Unit | None:
    """Return the unit of that spelling, in any case; None if there is none.

    ``column``: column of a measurement table into whose unit it must convert: ``"`` is an inch or an arc second; Empty for any.
    """
    units = _BY_WORD.get(text.strip().casefold(), ())
    return next((unit for unit in units if not column or unit.table_unit == table_unit(column)), None)


@lru_cache(maxsize=4096)
def table_unit(column: str) -> str:
    """Return the unit of a column of a measurement table: the end of its name; empty for words and directions."""
    ends = sorted({unit.table_unit for unit in UNITS}, key=len, reverse=True)
    return next((end for end in ends if column.endswith(f"_{end}")), "")


def units_of(column: str) -> tuple[Unit, ...]:
    """Return the units that can be converted into that of a column."""
    wanted = table_unit(column)
    return tuple(unit for unit in UNITS if unit.table_unit == wanted)


# --- Numbers of table cells: the decimal sign from the content, and exact decimal values ----------

POINT: Final = "."
COMMA: Final = ","
SIGNS: Final = {POINT: "point", COMMA: "comma"}
"""Decimal signs with their names in a mapping file."""
MINUS: Final = str.maketrans({"−": "-", "–": "-", "\u00a0": " ", "\u202f": " ", "’": "'"})
_EXPONENT: Final = r"(?:[eE][-+]?\d{1,2})?"
_NUMBER: Final = {
    sign: re.compile(
        rf"[-+]?(?:\d+|\d{{1,3}}(?:['{other} ]\d{{3}})+)?(?:{re.escape(sign)}\d*)?{_EXPONENT}(?<=[\d{re.escape(sign)}])",
        re.ASCII,
    )
    for sign, other in ((POINT, COMMA), (COMMA, POINT))
}
_EITHER: Final = re.compile(r"[-+]?[\d.,' ]*\d[\d.,' ]*(?:[eE][-+]?\d+)?", re.ASCII)
_PLAIN: Final = re.compile(r"-?(?:0|[1-9]\d{0,11})(?:([.,])\d{1,12})?", re.ASCII)
"""Most numbers: digits, at most one sign between them, which may be a decimal sign."""
_GROUPED: Final = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)
"""A number whose only sign may be a decimal sign or a sign of thousands."""
_WITH_UNIT: Final = re.compile(
    r"([-+]?[\d.,' ]*\d[.,]?(?:[eE][-+]?\d{1,2})?)(\s*)([^\d\s.,+-][^\d]{0,11}|1/min)", re.ASCII
)
_SEXAGESIMAL: Final = re.compile(
    r"([-+]?)(\d{1,3})\s*[°ºd]\s*(\d{1,2})\s*['′m]\s*(?:(\d{1,2}(?:[.,]\d*)?)\s*(?:\"|''|″|s)?)?", re.ASCII
)
_DEGREES: Final = re.compile("[°ºd]")
SEXAGESIMAL: Final = "dms"
"""Unit of a cell in degrees, minutes and seconds."""
SIXTY: Final = 60
_SIGNS_ALONE: Final = re.compile(r"[-–—_*?.#/]+|#[\w/]+[!?]?")
NO_VALUE: Final = frozenset(
    "nan n/a na null none nil n.a. n.a k.a. n/v n.v. inf -inf missing invalid lost error fehler fehlt ungültig".split()
) | {
    "no value",
    "not measured",
    "nicht gemessen",
    "kein wert",
    "non mesuré",
    "keine messung",
    "out of range",
    "over range",
}
"""Words of a cell without a value, beside signs alone (``-``, ``***``) and errors of a spreadsheet (``#N/A``, ``#WERT!``)."""


class DecimalSign(NamedTuple):
    """Decimal sign of a file.

    ``ambiguous``: a cell with a sign that could be a decimal sign or a sign of thousands; empty if there is none; ``contrary``: a cell
    that is clear and has the other sign; empty otherwise.
    """

    sign: str
    ambiguous: str = ""
    contrary: str = ""


def looks_like_number(cell: str) -> bool:
    """Return whether a cell is a number with whatever decimal sign, alone or with a unit behind it."""
    if _PLAIN.fullmatch(cell):
        return True
    if len(cell) >= 60 or not any(sign.isdigit() for sign in cell):
        return False
    return _looks_plain(cell.translate(MINUS)) or bool(split_unit(cell)[1])


def _looks_plain(text: str) -> bool:
    return bool(_EITHER.fullmatch(text)) and any(p.fullmatch(text) for p in _NUMBER.values())


def split_unit(cell: str) -> tuple[str, str]:
    """Return the number and the unit of a cell such as ``250 mm``, ``-90°`` or ``27°56'39.8"``; the cell and no unit otherwise.

    The unit of degrees, minutes and seconds is `SEXAGESIMAL`. A unit of one letter needs a blank before it: ``2K`` is a name.
    """
    if cell[-1:].isdigit() and not _DEGREES.search(cell):  # most cells
        return cell, ""
    text = cell.translate(MINUS)
    if len(text) >= 60:
        return cell, ""
    if _SEXAGESIMAL.fullmatch(text):
        return text, SEXAGESIMAL
    match = _WITH_UNIT.fullmatch(text)
    if match is None:
        return cell, ""
    number, blank, unit = match[1], match[2], match[3].strip("[]() ")
    is_name = len(unit) == 1 and unit.isascii() and unit.isalpha() and not blank
    return (number, unit) if unit_named(unit) is not None and not is_name and _looks_plain(number) else (cell, "")


def is_no_value(cell: str, words: Iterable[str] = ()) -> bool:
    """Return whether a cell states that there is no value: empty, signs alone, an error of a spreadsheet, or one of some words."""
    if not words and cell[-1:].isdigit() and cell[0] != "#":  # most cells
        return False
    text = " ".join(cell.casefold().split())
    return not text or text in NO_VALUE or text in words or bool(_SIGNS_ALONE.fullmatch(text))


class CellNumber(NamedTuple):
    """Number of a cell. ``unit``: unit behind the number, as spelt; empty if there is none."""

    value: Decimal
    unit: str

    def to_table(self, column: str, unit: str | None) -> Decimal | None:
        """Return the number in the unit of a column of the measurement table; None if the cell's unit is not the one given.

        ``unit``: unit of the whole column; None for that of each cell, and of the table where a cell has none.
        """
        stated = "deg" if self.unit == SEXAGESIMAL else self.unit
        own = unit_named(stated, column) if stated else None
        given = unit_named(unit, column) if unit else None
        if stated and (own is None or (given is not None and given is not own)):
            return None
        used = given or own or next(iter(units_of(column)), None)
        return self.value if used is None else used.to_table(self.value)


def quantity_in(cell: str, sign: str) -> CellNumber | None:
    """Return the number of a cell and its unit; None if it has none with this decimal sign."""
    plain = _PLAIN.fullmatch(cell)
    if plain is not None and plain[1] in (None, sign):
        return CellNumber(Decimal(cell.replace(COMMA, POINT)), "")
    text, unit = split_unit(cell)
    if unit == SEXAGESIMAL:
        return _sexagesimal(text, sign)
    value = decimal_value(text, sign)
    return None if value is None else CellNumber(value, unit)


def _sexagesimal(text: str, sign: str) -> CellNumber | None:
    match = _SEXAGESIMAL.fullmatch(text)
    parts = [] if match is None else [decimal_value(part or "0", sign) for part in match.group(2, 3, 4)]
    if match is None or None in parts:
        return None
    degrees, minutes, seconds = (part for part in parts if part is not None)
    if minutes >= SIXTY or seconds >= SIXTY:
        return None
    size = degrees + minutes / SIXTY + seconds / SIXTY**2
    return CellNumber(Decimal(f"{-size if match[1] == '-' else size:.15g}"), SEXAGESIMAL)


def decimal_value(cell: str, sign: str) -> Decimal | None:
    """Return the exact number in a cell; None if it is not a number with this decimal sign.

    Thousands may be separated by the other sign, an apostrophe or a blank.
    """
    text = cell.translate(MINUS)
    if len(text) > 60 or not re.match(r"[-+]?[.,]?[0-9]", text) or not _NUMBER[sign].fullmatch(text):
        return None
    other = COMMA if sign == POINT else POINT
    value = Decimal(text.replace(other, "").replace("'", "").replace(" ", "").replace(sign, POINT))
    return value if abs(value.adjusted()) < 40 else None


def decimal_text(value: Decimal) -> str:
    """Return a number as a cell of a measurement table, in full and without digits lost."""
    return format(value, "f") if value else "0"


def decimal_sign(cells: Iterable[str]) -> DecimalSign:
    """Return the decimal sign of cells: the one that a clear cell has; a sign followed by three digits alone is ambiguous."""
    clear: dict[str, str] = {}
    unclear: dict[str, str] = {}
    for cell in cells:
        plain = _PLAIN.fullmatch(cell)
        if plain is not None and (not plain[1] or plain[1] in clear):
            continue
        text, unit = split_unit(cell)
        if unit == SEXAGESIMAL:  # of degrees, minutes and seconds, the seconds have the decimal sign
            match = _SEXAGESIMAL.fullmatch(text)
            text = "" if match is None else match[4] or ""
        text = text.translate(MINUS)
        signs = [sign for sign in text if sign in SIGNS]
        if not signs or len(text) > 60 or not _EITHER.fullmatch(text):
            continue
        last = signs[-1]
        if not _NUMBER[last].fullmatch(text):
            continue
        if _GROUPED.fullmatch(text):
            unclear.setdefault(last, cell)
        else:
            clear.setdefault(last, cell)
    if len(clear) == 1:
        (sign,) = clear
        return DecimalSign(sign, ambiguous=unclear.get(COMMA if sign == POINT else POINT, ""))
    if clear:
        return DecimalSign(COMMA, contrary=clear[POINT])
    if len(unclear) == 1:
        sign, cell = next(iter(unclear.items()))
        return DecimalSign(sign, ambiguous=cell)
    return DecimalSign(POINT, ambiguous=unclear.get(COMMA, ""))


# --- Meaning of a column's header ----------------------------------------------------------------

Words = frozenset[str]


def _words_of(part: Any) -> Any:
    """Return a part of the vocabulary with its words, which are separated by commas, as sets."""
    if isinstance(part, dict):
        return MappingProxyType({name: _words_of(words) for name, words in part.items()})
    return frozenset(word.strip() for word in part.split(","))


_VOCABULARY: Final = _words_of(yaml.safe_load(Path(__file__).with_name("vocabulary.yaml").read_text(encoding="utf-8")))
ROLES: Final[Mapping[str, Words]] = _VOCABULARY["roles"]
"""Role of a column, by its words beside the name of an axis."""
NAMES: Final[Mapping[str, Words]] = MappingProxyType(
    {kind: words | {""} if kind == "index" else words for kind, words in _VOCABULARY["names"].items()}
)
"""Meaning of a column without the name of an axis, by its words; a column without a name is an index."""
CARRIER_WORDS: Final[Mapping[str, str]] = MappingProxyType(
    {word: side for side, words in _VOCABULARY["carriers"].items() for word in words}
)
"""Sides of the machine, by the words of a cell."""
UP_WORDS, DOWN_WORDS, UNKNOWN_WORDS = (_VOCABULARY["directions"][name] for name in ("up", "down", "unknown"))
"""Words of a cell that give the direction of approach: towards larger positions, towards smaller ones, unknown."""
GEODETIC: Final[Mapping[str, str]] = MappingProxyType(
    {"easting": "x", "rechtswert": "x", "northing": "y", "hochwert": "y", "height": "z", "hoehe": "z"}
)
"""Coordinates of geodetic instruments: east, north and up are a right-handed frame."""
_LETTERS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
_ARROWS: Final = str.maketrans({"−": "-", "–": "-", "↑": "+", "→": "+", "↓": "-", "←": "-"})


def plain_words(text: str) -> str:
    """Return a text in lower case with German letters written as two, and other letters without accents."""
    plain = text.casefold().translate(_LETTERS).strip()
    return "".join(sign for sign in unicodedata.normalize("NFD", plain) if not unicodedata.combining(sign))


def direction_of(cell: str) -> int | None:
    """Return +1, −1 or 0 (unknown) for a cell that gives a direction of approach; None if it gives none."""
    word = plain_words(cell).translate(_ARROWS).strip("() ") if cell.strip("() ") else ""
    word = word.rstrip(".") or word
    if word in UP_WORDS:
        return 1
    if word in DOWN_WORDS:
        return -1
    return 0 if not word or word in UNKNOWN_WORDS else None


# --- Meaning of a column's header: which quantity of a measurement table it gives, and in which unit

_BRACKETS: Final = re.compile(r"\s*[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$")
_SUFFIX: Final = re.compile(r"(?:\s+in\s+|\s*[/,]\s*|\s+|_)([^\s_,/]+(?:/min)?)$")
_CAMEL: Final = re.compile(r"(?<=[a-zäöü])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-zäöü])")


class Meaning(NamedTuple):
    """Meaning of a header.

    Attributes:
        kind: ``exact`` (a column of a measurement table), a role (`twin.measurement.importing.quantities.ROLES`), ``bare`` (an axis
            without a role), a name (`NAMES`), ``sensor`` (a temperature), or empty if unknown.
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


INSTRUMENTS: Final = frozenset({"tracker", "lasertracker", "laser", "interferometer"})
"""Words of a header by which `Istposition` is what an instrument measured, not what the control reports."""


def meaning_of(header: str, machine: Machine) -> Meaning:
    """Return the meaning of a header."""
    if is_table_column(header, machine):
        return Meaning("exact", header)
    text, unit = without_unit(header)
    words = _words(text, machine)
    joined = " ".join(words)
    short = " ".join(word for word in words if word not in _VOCABULARY["numbering"]) or joined
    for kind, phrases in NAMES.items():
        is_named = joined in phrases or (kind in ("target", "station", "round") and short in phrases)
        if is_named and not (joined in ("", "t") and unit.casefold() in ("°c", "degc", "k", "c")):
            return Meaning(kind, kind, unit)
    axes = {axis.casefold(): axis for axis in machine.names}
    meant = [word for word in words if word in axes or word in ("x", "y", "z")]
    rest = [word for word in words if word not in meant and word not in _VOCABULARY["noise"]]
    known = unit_named(unit)
    temperature = ROLES["temperature"] & {*rest} or (known is not None and known.table_unit == "degC")
    if temperature:
        name = "_".join(word for word in [*meant, *rest] if word not in ROLES["temperature"]) or "air"
        return Meaning("temperature", axes.get(name, name), unit)
    if len(meant) != 1:
        order = ("approach", "deviation", "measured", "command") if not meant else ("approach", "deviation")
        return Meaning(next((role for role in order if {*rest} & ROLES[role]), ""), "", unit)
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
    if "readback" in roles and {*rest} & INSTRUMENTS:
        return Meaning("measured", axis, unit)
    role = roles[0]
    return Meaning(role, axis, unit, certain=len(roles) == 1 and all(word in ROLES[role] for word in rest))


def other_axis(header: str, machine: Machine) -> str:
    """Return the letter of a rotary axis A, B or C that a header names as a position and the machine does not have; empty if none."""
    text = header.removesuffix("_deg") if re.fullmatch("[A-C]_deg", header) else without_unit(header)[0]
    words = [
        word for word in _words(text, machine) if word not in _VOCABULARY["noise"] and word not in ROLES["command"]
    ]
    letter = words[0].upper() if len(words) == 1 else ""
    return letter if letter in ("A", "B", "C") and letter not in machine.by_name else ""


def without_unit(header: str) -> tuple[str, str]:
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
    for word in (GEODETIC.get(word, word) for word in words):
        axis = next((axis for axis in axes if word.startswith(axis) and word[len(axis) :] in roles - {"t", "u"}), None)
        last = next((axis for axis in axes if word.endswith(axis) and word[: -len(axis)] in roles - {"t"}), None)
        if word in roles or word in axes or (axis is None and last is None):
            found.append(word)
        elif axis is not None:
            found += [axis, word[len(axis) :]]
        elif last is not None:
            found += [word[: -len(last)], last]
    return found
