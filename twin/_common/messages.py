"""Messages: text with an identifier and arguments, which a page can show in another language.

The identifier is the English format string, as in GNU gettext, so that English stands where the message is made. As a `str` every
message is English: text, JSON and the terminal need no catalogue. Within `translated`, `say` and the templates return the language of a
catalogue. Other text (names of errors, files, units) is the same in every language.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from string import Formatter
from typing import Any, Final, final

PLACE: Final = re.compile(r"\{[^}]*\}")
GROUP: Final = re.compile(r"(?<=\d),(?=\d)")
SHORT: Final = re.compile(r"[.]\dg")
HUNDREDS: Final = re.compile(r"-?\d(?:[.]\d+)?e[+]0\d")
"""A number below 10¹⁰ that a format of few digits writes with an exponent."""
POINT: Final = re.compile(r"(?<=\d)\.(?=\d)")


@final
class Number(str):
    """A number as text, perhaps with a unit: its decimal mark depends on the language."""


@final
class Quoted(str):
    """English text from a file: it has no translation."""


@final
class Message(str):
    """English text with its identifier and arguments.

    Examples:
        >>> message = Message("backlash of {axis}", axis="X")
        >>> message
        'backlash of X'
        >>> message.identifier
        'backlash of {axis}'
    """

    identifier: str  # English format string
    arguments: Mapping[str, Any]  # values by name: messages, numbers, or text that is the same in every language
    capitalised: bool  # whether the first letter is a capital one, whatever the identifier says

    def __new__(cls, identifier: str, /, **arguments: Any) -> Message:
        """Return the message, in English."""
        return cls._made(_ENGLISH.vformat(identifier, (), arguments), " ".join(identifier.split()), arguments)

    @classmethod
    def _made(cls, english: str, identifier: str, arguments: Mapping[str, Any], capitalised: bool = False) -> Message:
        message = super().__new__(cls, english)
        message.identifier, message.arguments, message.capitalised = identifier, arguments, capitalised
        return message

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how it is made again, for pickle and copy."""
        return Message._made, (str(self), self.identifier, self.arguments, self.capitalised)

    def __add__(self, other: str) -> Message:
        """Return the message followed by other text, which keeps its own translation."""
        return joined("", [self, other])

    def __radd__(self, other: str) -> Message:
        """Return other text followed by the message."""
        return joined("", [other, self])

    def starting(self, letter: str) -> Message:
        """Return the message with another first letter in English; a small letter keeps nouns of other languages as they are."""
        return Message._made(letter + self[1:], self.identifier, self.arguments, letter.isupper())


def joined(separator: str, parts: Sequence[str]) -> Message:
    """Return parts with a separator between them; a separator without letters needs no translation."""
    places = {f"part{i}": part for i, part in enumerate(parts)}
    identifier = separator.join(f"{{{name}}}" for name in places)
    return Message._made(identifier.format(**places), identifier, places)


def parts(text: str) -> list[str]:
    """Return the parts of a text that was made by `joined` or by addition; other text is one part."""
    if isinstance(text, Message) and "part0" in text.arguments:
        return [one for part in text.arguments.values() for one in parts(part)]
    return [text]


def message_data(text: str) -> Any:
    """Return a message as plain data for a file: its format string (``text``) and arguments; a list if joined by commas; other text."""
    if not isinstance(text, Message):
        return str(text)
    if text.identifier == ", ".join(f"{{part{i}}}" for i in range(len(text.arguments))):
        return [message_data(part) for part in text.arguments.values()]
    return {"text": text.identifier} | {
        name: message_data(value if isinstance(value, str) else str(value)) for name, value in text.arguments.items()
    }


def message_from(data: object) -> str:
    """Return the text that `message_data` described; `ValueError` if it is empty, or its places are not its arguments."""
    if isinstance(data, str) and data:
        return data
    if isinstance(data, list) and data:
        return joined(", ", [message_from(part) for part in data])
    if not isinstance(data, Mapping) or not isinstance(data.get("text"), str):
        raise ValueError("expected text, or `text` with the values of its places")
    given = {str(name): message_from(value) for name, value in data.items() if name != "text"}
    if {*PLACE.findall(data["text"])} != {f"{{{name}}}" for name in given} or not all(map(str.isidentifier, given)):
        raise ValueError("the values are not those of the places in braces")
    return Message(data["text"], **given)


@dataclass
class Translation:
    """Translation into the language of a catalogue, with decimal comma."""

    catalogue: Mapping[str, str]  # format string by identifier
    missing: dict[str, None] = field(default_factory=dict)  # texts without translation met so far

    def text(self, value: str, *, as_html: bool = False) -> str:
        """Return text in the language. Text without translation stays English; HTML is escaped, and marks such text as English."""
        if isinstance(value, Number):
            value = POINT.sub(",", GROUP.sub("\N{NARROW NO-BREAK SPACE}", value))
        if isinstance(value, Message):
            known = self.catalogue.get(value.identifier)
            if known is None and not any(letter.isalpha() for letter in PLACE.sub("", value.identifier)):
                known = value.identifier
            if known is not None:
                return self._filled(known, value, as_html)
        own = html.escape(value, quote=False) if as_html else value
        if isinstance(value, Message | Quoted):
            self.missing[str(value)] = None
            return f"<span lang=en>{own}</span>" if as_html else own
        return own

    def _filled(self, known: str, message: Message, as_html: bool) -> str:
        format_string = html.escape(known, quote=False) if as_html else known
        filled = _Filler(self, as_html).vformat(format_string, (), message.arguments)
        # An identifier has no blanks around it.
        before, after = len(message) - len(message.lstrip()), len(message.rstrip())
        filled = message[:before] + filled.strip() + message[max(after, before) :]
        return filled[:1].upper() + filled[1:] if message.capitalised else filled


class _Digits(Formatter):
    """Fills the places of a format string; ``.3g`` gives 1010, not 1.01e+03."""

    def format_field(self, value: Any, format_spec: str) -> Any:
        text = format(value, format_spec)
        return f"{float(text):.0f}" if SHORT.fullmatch(format_spec) and HUNDREDS.fullmatch(text) else text


_ENGLISH: Final = _Digits()


class _Filler(_Digits):
    """Fills the places of a translated format string."""

    def __init__(self, translation: Translation, as_html: bool) -> None:
        self._translation, self._as_html = translation, as_html

    def format_field(self, value: Any, format_spec: str) -> str:
        text = value if isinstance(value, str) else Number(super().format_field(value, format_spec))
        return self._translation.text(text, as_html=self._as_html)


_current: ContextVar[Translation | None] = ContextVar("translation", default=None)


@contextmanager
def translated(translation: Translation | None) -> Iterator[None]:
    """Set the language of the page that is made inside; None for English."""
    before = _current.set(translation)
    try:
        yield
    finally:
        _current.reset(before)


def say(text: str, /, **arguments: Any) -> str:
    """Return text (a message, a number, or the identifier of a message and its arguments) in the language of the page being made.

    Text in braces without arguments is finished text, not an identifier, and has no translation.
    """
    if type(text) is str and not arguments and "{" in text:
        return text
    message = Message(text, **arguments) if type(text) is str else text
    translation = _current.get()
    return message if translation is None else translation.text(message)


def say_html(text: str, *, quote: bool = True) -> str:
    """Return text as HTML in the language of the page that is being made."""
    translation = _current.get()
    return html.escape(text, quote=quote) if translation is None else translation.text(text, as_html=True)


def is_translated(value: object) -> bool:
    """Return whether a value differs in the language of the page that is being made."""
    return _current.get() is not None and isinstance(value, Message | Number | Quoted)
