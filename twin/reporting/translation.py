"""Translate the sentences of a rendered page and of its pictures with a catalogue: `wording/<language>_sentences.yaml`.

The catalogue maps an English sentence to its translation; names in braces stand for text that is translated in turn. A sentence
without translation stays English, is marked as English for screen readers, and is counted; nothing is translated in part.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import resources
from types import MappingProxyType
from typing import Any, Final, final

import yaml
from matplotlib.figure import Figure
from matplotlib.text import Text

from twin._common.families import Language
from twin.display import UNKNOWN
from twin.display.numbers import capital, with_joined_units
from twin.machine.machine import Machine
from twin.model.effects import MACHINE_EFFECTS, split_name
from twin.model.effects.specification import title_of

CLASSES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "L-POS": "positioning of the linear axes",
        "L-STR": "straightness of the linear axes",
        "L-SQU": "squareness between the linear axes",
        "L-ANG": "angular error motions of the linear axes",
        "R-POS": "angular positioning of the rotary axes",
        "R-RAX": "radial and axial error motions of the rotary axes",
        "R-POR": "position and orientation of the rotary axes",
        "R-ANG": "tilt error motions of the rotary axes",
        "control": "compensation by the control",
        "all": "all errors together",
    }
)


def named(name: str, machine: Machine) -> str:
    """Return an error, an effect or a class in words, or its symbol if there are no words for it.

    Args:
        name: ISO 230-1 name, ``reversal:Y``, or the class of ISO/TR 16907.
        machine: the machine it belongs to.
    """
    if name in CLASSES:
        return capital(CLASSES[name])
    if name.startswith("E_"):
        return _of_motion(name, machine)
    effect, colon, where = name.partition(":")
    if not colon:
        return name
    if effect == "control":
        return f"Table in the control: {where}"
    return _title(effect, where.partition("[")[0])


def motion_kind(name: str, machine: Machine) -> str:
    """Return the kind of an error of an axis.

    ``positioning``, ``straightness``, ``pitch`` (any angle), ``square``, ``displaced``, ``tilted``, ``angular_positioning``, ``tilt``,
    ``axial`` or ``radial``.

    Args:
        name: ISO 230-1 name.
        machine: the machine it belongs to.
    """
    component, average, axis = split_name(name)
    one = machine.by_name[axis]
    if average:
        return "square" if one.linear else "displaced" if component < 3 else "tilted"
    along = max(range(3), key=lambda i: abs(one.direction[i]))
    if one.linear:
        return "pitch" if component >= 3 else "positioning" if component == along else "straightness"
    if component >= 3:
        return "angular_positioning" if component == along + 3 else "tilt"
    return "axial" if component == along else "radial"


def _of_motion(name: str, machine: Machine) -> str:
    kind = motion_kind(name, machine)
    return _title("squareness", name) if kind == "square" else wording(Language.en).of_kind(kind, name)


def _title(effect: str, where: str) -> str:
    """Return the name of a machine effect at a place; a calibration holds no effects of instruments."""
    return title_of(
        {machine_effect.name: machine_effect for machine_effect in MACHINE_EFFECTS}.get(effect), effect, where
    )


# --- Wording of a report in several languages: one YAML file per language next to this module, in `wording`

DECIMAL_POINT: Final = re.compile(r"(?<=\d)\.(?=\d)")


@final
@dataclass(frozen=True)
class Wording:
    """Texts of one language.

    Attributes:
        texts: text by key; names in braces are filled in.
    """

    language: Language
    texts: Mapping[str, str]

    def __call__(self, key: str, **values: object) -> str:
        """Return a text with its values filled in.

        Raises:
            KeyError: there is no such text, or a value is missing.
        """
        return self.texts[key].format(**values)

    def number(self, text: str) -> str:
        """Return a number, formatted by `twin.display.numbers`, with the decimal mark and the words of the language."""
        if self.language is Language.de:
            text = DECIMAL_POINT.sub(",", text)
        return text.replace(UNKNOWN, self.texts["unknown"])

    def knows(self, name: str) -> bool:
        """Return whether an error has words in this language (`error`)."""
        return name.startswith("E_") or f"item_{name}" in self.texts

    def error(self, name: str, machine: Machine, to: str = "") -> str:
        """Return an error in words.

        Args:
            name: ISO 230-1 name, ``tool`` or ``tool_after``, or another effect, whose words are English.
            machine: the machine it belongs to.
            to: for a squareness, the reference axis; empty if unknown.
        """
        if not self.knows(name):
            return named(name, machine)
        if f"item_{name}" in self.texts:
            return self(f"item_{name}")
        kind = motion_kind(name, machine)
        return self.of_kind("square_about" if kind == "square" and not to else kind, name, to)

    def of_kind(self, key: str, name: str, to: str = "") -> str:
        """Return the words of a key for an ISO 230-1 name; ``to``: the reference axis of a squareness."""
        component, _, axis = split_name(name)
        return self(key, axis=axis, direction="xyz"[component % 3], to=to)


@cache
def wording(language: Language) -> Wording:
    """Return the texts of a language."""
    text = (resources.files("twin.reporting") / "wording" / f"{language.value}.yaml").read_text(encoding="utf-8")
    return Wording(language, yaml.safe_load(text))


# --- Translate the sentences of a rendered page and of its pictures with a catalogue: `wording/<language>_sentences.yaml`

INLINE: Final = r"(?:/?(?:b|code|i|em|sub|sup)\b)"
TAG: Final = re.compile(rf"(<style.*?</style>|<script.*?</script>|<(?!{INLINE})[^>]+>)", re.DOTALL)
"""Tags that end a sentence."""
BOLD: Final = re.compile(r"(</?b\b[^>]*>)")
CODE: Final = re.compile(r"<code>.*?</code>|`[^`]*`", re.DOTALL)
ATTRIBUTE: Final = re.compile(r'\b(alt|title|aria-label)="([^"]*)"')
SENTENCE: Final = re.compile(r"(?<=[.!?])\s+(?=[^a-z\s])")
NUMBER: Final = re.compile(r"(?<![\w./])(?<!\w-)(\d{1,3}(?:,\d{3})+|\d+)(\.\d+)?(?![\d\w/]|[.,]\d)")
NAME: Final = re.compile(r"[A-Z]{1,4}[0-9]*[A-Z]?|[A-Z]-[A-Z]+|\S*[\d_/]\S*|\S+\.\w+|[a-z]+:[A-Z]\w*|\W*|[xyzkp]")
"""Words that are the same in every language: symbols of errors, files, numbers; units are in the catalogue."""
VERBATIM: Final = "translate=no"
"""Attribute of a tag whose text is quoted from a file."""
ANY: Final = r"(?:[^()]|\((?:[^()]|\([^()]*\))*\))+?"
"""Any text in which brackets are closed."""
QUOTED: Final = "_quoted"
"""Name of a place whose text is not translated."""
PRIVATE: Final = 0xE000
"""First code point that stands for a piece of code, which is never translated."""


@final
@dataclass(frozen=True)
class SentencePattern:
    """One sentence of the catalogue.

    Attributes:
        english: expression that matches the English sentence.
        text: translation with named places.
        fixed: length of the English text without its places; longer ones are tried first.
    """

    english: re.Pattern[str]
    text: str
    fixed: int


@final
@dataclass
class Translator:
    """Translation into one language.

    Attributes:
        patterns: the sentences, the most specific first.
        same: words that are the same in both languages.
        missing: sentences without translation met so far.
    """

    language: Language
    patterns: tuple[SentencePattern, ...]
    same: frozenset[str]
    missing: dict[str, None] = field(default_factory=dict)
    _known: dict[str, str | None] = field(default_factory=dict)

    def text(self, english: str) -> str:
        """Return plain text, as of a label in a picture, in the language; unchanged if a line of it has no translation."""
        kept = english.replace("\N{NO-BREAK SPACE}", " ")
        lines = [self._plain(line) for line in kept.split("\n")]
        if None in lines:
            self.missing[kept] = None
            return english
        return "\n".join(line for line in lines if line is not None)

    def picture(self, figure: Figure) -> Figure:
        """Return a matplotlib figure with its labels and the numbers of its axes in the language."""
        for label in figure.findobj(Text):
            if label.get_text().strip():
                label.set_text(self.text(label.get_text()))
        for plot in figure.axes:
            for axis in (plot.xaxis, plot.yaxis):
                formatter = axis.get_major_formatter()
                formatter.format_ticks = partial(self._ticks, formatter.format_ticks)  # type: ignore[method-assign]
        return figure

    def _ticks(self, format_ticks: Callable[[Any], list[str]], values: Any) -> list[str]:
        return [self.text(text) if text else text for text in format_ticks(values)]

    def page(self, page: str) -> str:
        """Return HTML with its text and its text alternatives in the language."""
        parts = TAG.split(page)
        for i, part in enumerate(parts):
            if i % 2:
                parts[i] = ATTRIBUTE.sub(self._attribute, part)
            elif part.strip() and not (i and VERBATIM in parts[i - 1]):
                parts[i] = self._segment(part)
        return with_joined_units("".join(parts), "&nbsp;")

    def _attribute(self, found: re.Match[str]) -> str:
        return f'{found[1]}="{html.escape(self.text(html.unescape(found[2])))}"'

    def _segment(self, text: str) -> str:
        start, end = text[: len(text) - len(text.lstrip())], text[len(text.rstrip()) :]
        kept = " ".join(html.unescape(text.replace("&lt;", "&amp;lt;").replace("&gt;", "&amp;gt;")).split())
        found = self._plain(kept)
        if found is None:
            found = " ".join("".join(self._pieces(kept)).split())
        return f"{start}{_escaped(found)}{end}"

    def _pieces(self, text: str) -> Iterator[str]:
        """Yield the parts of a text in bold and their sentences, each translated or marked as English."""
        for part in BOLD.split(text):
            if BOLD.fullmatch(part) or not part.strip():
                yield part
                continue
            core = part.strip()
            sentences = [core] if self._plain(core) is not None else SENTENCE.split(core)
            before, _, after = part.partition(core)
            yield before + " ".join(self._or_marked(sentence) for sentence in sentences) + after

    def _or_marked(self, sentence: str) -> str:
        """Return a sentence in the language, or marked as English."""
        plain = self._plain(sentence)
        if plain is None:
            self.missing[sentence] = None
            return f"<span lang=en>{sentence}</span>"
        return plain

    def _plain(self, text: str) -> str | None:
        """Return a sentence in the language, or None if some part of it has no translation."""
        codes = CODE.findall(text)
        marked = text
        for i, code in enumerate(codes):
            marked = marked.replace(code, chr(PRIVATE + i), 1)
        plain = self._translated(marked)
        if plain is not None:
            for i, code in enumerate(codes):
                plain = plain.replace(chr(PRIVATE + i), code)
        return plain

    def _translated(self, text: str) -> str | None:
        if text not in self._known:
            # Set before the recursion, so that a sentence is never taken as a part of itself.
            self._known[text] = None
            self._known[text] = self._searched(text)
        return self._known[text]

    def _searched(self, text: str) -> str | None:
        if all(word in self.same or NAME.fullmatch(word) for word in re.split(r"</?b>|:?[\s,;()\[\]±≥<>=+]+|:$", text)):
            return self._numbers(text)
        for pattern in self.patterns:
            match = pattern.english.fullmatch(text)
            filled = None if match is None else self._filled(pattern, match.groupdict())
            if filled is not None:
                return filled
        sentences = SENTENCE.split(text)
        parts = [self._translated(sentence) for sentence in sentences] if len(sentences) > 1 else [None]
        return None if None in parts else " ".join(part for part in parts if part is not None)

    def _filled(self, pattern: SentencePattern, places: dict[str, str]) -> str | None:
        """Return the translation with its places filled in; None if one of them has no translation, or holds a further sentence."""
        text = pattern.text
        for name, part in places.items():
            own = part if name == QUOTED else None if SENTENCE.search(part) else self._translated(part)
            if own is None:
                return None
            text = text.replace(f"{{{name[1:]}}}", own, 1)
        return text

    def _numbers(self, text: str) -> str:
        return NUMBER.sub(
            lambda one: wording(self.language).number(one[0].replace(",", "\N{NARROW NO-BREAK SPACE}")), text
        )


def _escaped(text: str) -> str:
    """Return text with the characters escaped that are no part of a tag."""
    return re.sub(r"&(?!\w+;|#)", "&amp;", text)


def translator(language: Language) -> Translator:
    """Return a translation into a language with a catalogue, with an empty list of missing sentences."""
    patterns, same = _catalogue(language)
    return Translator(language, patterns, same)


@cache
def _catalogue(language: Language) -> tuple[tuple[SentencePattern, ...], frozenset[str]]:
    name = f"{language.value}_sentences.yaml"
    content = yaml.safe_load((resources.files("twin.reporting") / "wording" / name).read_text(encoding="utf-8"))
    english, own = wording(Language.en).texts, wording(language).texts
    shared = {english[key]: text for key, text in own.items() if english[key] and key in content["from_first_page"]}
    found = [_pattern(sentence, text) for sentence, text in {**shared, **content["sentences"]}.items()]
    return tuple(sorted(found, key=lambda one: -one.fixed)), frozenset(content["same"])


def _pattern(sentence: str, text: str) -> SentencePattern:
    """Return a compiled sentence; its first letter may have either case."""
    pieces = re.split(r"\{(\w+)\}", " ".join(sentence.split()))
    expression = "".join(_place(piece) if i % 2 else re.escape(piece) for i, piece in enumerate(pieces))
    first = pieces[0][:1]
    if first.isalpha():
        expression = f"[{first.lower()}{first.upper()}]{expression[1:]}"
    return SentencePattern(re.compile(expression), " ".join(text.split()), sum(map(len, pieces[::2])))


def _place(name: str) -> str:
    """Return the expression of a place: one word if its name is longer than a letter, any text else."""
    return f"(?P<_{name}>{ANY if len(name) == 1 or name == 'quoted' else r'[^ ]+'})"
