"""XML as a tree of elements with their lines. Document types, and with them entities that expand or read files, are refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final
from xml.parsers import expat

from twin._common.errors import InputError

MAX_NESTING: Final = 100
"""Deepest nesting of elements; a URDF needs six."""
MAX_ELEMENTS: Final = 200_000
"""Largest number of elements; each takes about 1 kB of memory."""


@final
@dataclass(frozen=True)
class Element:
    """One XML element with the number of its first line."""

    name: str  # its tag
    attributes: Mapping[str, str]
    line: int  # 1-based line of its start
    children: list[Element] = field(default_factory=list)  # directly below it
    parts: list[str] = field(default_factory=list)  # pieces of its own text, in order

    @property
    def text(self) -> str:
        """Text directly in the element, without blanks at both ends."""
        return "".join(self.parts).strip()

    def each(self, name: str) -> list[Element]:
        """Return the children of that name."""
        return [child for child in self.children if child.name == name]

    def within(self) -> Iterator[Element]:
        """Yield the element and all elements below it."""
        yield self
        for child in self.children:
            yield from child.within()


def parse_xml(text: str, path: Path, expected: str, *, namespaces: bool = False) -> Element:
    """Return the root element of XML text; `InputError`: not XML, a document type, too many elements, or nested too deeply.

    ``namespaces``: whether a name is its namespace, a blank and the local name; else as written, prefix included.
    """
    parser = expat.ParserCreate("utf-8", " " if namespaces else None)
    stack, count = [Element("", {}, 0)], 0

    def refuse(what: str, wanted: str) -> InputError:
        return InputError(what, expected=wanted, file=path, line=parser.CurrentLineNumber)

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS:
            raise refuse("too many elements", f"at most {MAX_ELEMENTS:,}")
        if len(stack) > MAX_NESTING:
            raise refuse("elements nested too deeply", f"at most {MAX_NESTING} levels")
        element = Element(name, attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def doctype(*_: object) -> None:
        raise refuse("a document type declaration", "XML without <!DOCTYPE>")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.CharacterDataHandler = lambda data: stack[-1].parts.append(data)
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as error:
        raise InputError("not XML", expected=expected, file=path, line=error.lineno, value=error) from error
    return stack[0].children[0]
