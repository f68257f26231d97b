"""Wording of a report in several languages: one YAML file per language next to this module, in `wording`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Final, final

import yaml

from twin._common.language import Language
from twin.display import UNKNOWN
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.reporting.words import motion_kind, named

DECIMAL_POINT: Final = re.compile(r"(?<=\d)\.(?=\d)")


@final
@dataclass(frozen=True)
class Wording:
    """Texts of one language.

    Attributes:
        language: the language.
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
        component, _, axis = split_name(name)
        kind = motion_kind(name, machine)
        key = "square_about" if kind == "square" and not to else kind
        return self(key, axis=axis, direction="xyz"[component % 3], to=to)


@cache
def wording(language: Language) -> Wording:
    """Return the texts of a language."""
    text = (resources.files("twin.reporting") / "wording" / f"{language.value}.yaml").read_text(encoding="utf-8")
    return Wording(language, yaml.safe_load(text))
