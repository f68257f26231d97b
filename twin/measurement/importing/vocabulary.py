"""Words of column headers, English and German, and what each of them means. All words of `twin import` are in this file."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

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
