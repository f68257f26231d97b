"""YAML files checked against a pydantic model, whose errors know file and line.

Only what a file of `twin` needs is read: text, numbers, true and false, lists and entries. A date is text. Depth, number of
entries and the size of the file are bounded, aliases included, so that reading always ends.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar, final, get_args

import yaml
from pydantic import BaseModel, ValidationError

from twin._common.errors import InputError, control_character, nearest
from twin._common.files import read_text

Schema = TypeVar("Schema", bound=BaseModel)
Place = tuple[str | int, ...]

MOST_BYTES: Final = 2**23
MOST_ENTRIES: Final = 50_000
"""Of one file, with every alias written out; a calibration of five axes has some thousand."""
DEEPEST: Final = 32
"""Levels of lists and entries in one another; a calibration has five."""
LONGEST_NUMBER: Final = 400
"""Characters of a number, and of what is written like one."""
LARGEST: Final = 1e15
"""Of any number in a file, whatever its unit: its square and what that is multiplied by are finite."""
_YAML: Final = "tag:yaml.org,2002:"
_SCALARS: Final[Mapping[str, str]] = {
    f"{_YAML}str": "text",
    f"{_YAML}int": "a whole number",
    f"{_YAML}float": "a number",
    f"{_YAML}bool": "true or false",
    f"{_YAML}null": "nothing",
}
"""Tags of the scalars that are read, and what each must be."""
_IN_WORDS: Final = {
    "missing": "this entry",
    "float_parsing": "a number",
    "float_type": "a number",
    "int_parsing": "a whole number",
    "int_type": "a whole number",
    "bool_parsing": "true or false",
    "string_type": "text",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "entries, each `name: value`",
    "model_type": "entries, each `name: value`",
    "mapping_type": "entries, each `name: value`",
}
"""What is expected, by pydantic's type of error."""


def load_yaml(path: Path, schema: type[Schema], name: str) -> tuple[Schema, Mapping[Place, int]]:
    """Return a YAML file checked against a pydantic model, and the line of every entry by its place in the file.

    Args:
        path: the file.
        schema: the model it must fit.
        name: the value its ``schema:`` entry must have.

    Raises:
        InputError: with the line, on anything that does not fit; a key given twice included.
    """
    data, lines = read_yaml(path)
    if not isinstance(data, dict):
        raise InputError("no entries", expected=f"a file with `schema: {name}`", file=path, line=lines.get(()))
    if data.get("schema") != name:
        raise InputError(
            "wrong kind of file",
            expected=f"schema: {name}",
            file=path,
            line=lines.get(("schema",), 1),
            value=data.get("schema"),
        )
    try:
        return schema.model_validate(data), lines
    except ValidationError as error:
        # An unknown key says more than the key that is missing because of it.
        found = error.errors()
        first = next((one for one in found if one["type"] == "extra_forbidden"), found[0])
        # pydantic names the member of a union it tried; the file has no such entry.
        place = tuple(part for part in first["loc"] if not (isinstance(part, str) and "[" in part))
        entry = ".".join(str(part) for part in place)
        known = _known(schema, first["loc"]) if first["type"] == "extra_forbidden" else []
        raise InputError(
            f"`{entry}` is missing" if first["type"] == "missing" else f"`{entry}` does not fit",
            expected=_expected(first, known),
            file=path,
            line=line_of(place, lines),
            # The value around a missing top-level entry is the whole file.
            value=None if first["type"] == "missing" and len(place) == 1 else first["input"],
            nearest=_meant(first, known),
        ) from error


def read_yaml(path: Path) -> tuple[Any, Mapping[Place, int]]:
    """Return the plain data of a YAML file, and the line of every entry by its place.

    Raises:
        InputError: with the line: no YAML, a tag or a value that is not read, a key given twice, too deep or too large.
    """
    text = read_text(path, most_bytes=MOST_BYTES)
    loader = None
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise InputError(
            "not YAML", expected="a YAML file", file=path, line=mark.line + 1 if mark else 1, value=error.problem
        ) from error
    except yaml.reader.ReaderError as error:
        raise InputError(
            "a control character in the text",
            expected="a YAML file",
            file=path,
            line=text.count("\n", 0, error.position) + 1,
        ) from error
    except yaml.YAMLError as error:
        raise InputError("not YAML", expected="a YAML file", file=path, line=1, value=error) from error
    finally:
        if loader is not None:
            loader.dispose()
    reading = _Reading(path)
    return (None if root is None else reading.plain(root, ())), reading.lines


@final
class _Loader(yaml.SafeLoader):
    """YAML nodes, bounded in depth and number while they are made."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        # No dates, no merge keys: a date is text, and `<<` is an unknown entry.
        self.yaml_implicit_resolvers = {
            first: [(tag, pattern) for tag, pattern in resolvers if tag in _SCALARS]
            for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
        }
        self.depth = 0
        self.count = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """As of PyYAML.

        Raises:
            MarkedYAMLError: too deep or too many.
        """
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        self.depth += 1
        self.count += 1
        if self.depth > DEEPEST:
            raise yaml.MarkedYAMLError(problem=f"more than {DEEPEST} levels", problem_mark=mark)
        if self.count > MOST_ENTRIES:
            raise yaml.MarkedYAMLError(problem=f"more than {MOST_ENTRIES} entries", problem_mark=mark)
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


@final
class _Reading:
    """Plain data of YAML nodes, with aliases written out.

    Attributes:
        lines: the line of every entry by its place.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: dict[Place, int] = {}
        self._around: list[yaml.Node] = []

    def plain(self, node: yaml.Node, place: Place) -> Any:
        """Return the plain data of a node.

        Raises:
            InputError: it is not read, too large, or contains itself.
        """
        line = node.start_mark.line + 1
        self.lines[place] = line
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node)
        if node.tag not in (f"{_YAML}map", f"{_YAML}seq"):
            raise self._fail("a tag that is not read", "entries or a list without a tag", line, node.tag)
        if any(one is node for one in self._around):
            raise self._fail("an alias inside its own anchor", "no recursion", line, None)
        if len(self.lines) > MOST_ENTRIES:
            raise self._fail(f"more than {MOST_ENTRIES} entries with its aliases", "a smaller file", line, None)
        self._around.append(node)
        try:
            if isinstance(node, yaml.SequenceNode):
                return [self.plain(item, (*place, index)) for index, item in enumerate(node.value)]
            return self._entries(node, place)
        finally:
            self._around.pop()

    def _entries(self, node: yaml.Node, place: Place) -> dict[Any, Any]:
        found: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise self._fail("a name that is a list or has entries", "`name: value`", line, None)
            key = self._scalar(key_node)
            if not isinstance(key, str):
                raise self._fail("a name that is no text", "quotes around it", line, key_node.value)
            if key in found:
                raise self._fail("given twice", "each key once", line, key)
            found[key] = self.plain(value_node, (*place, key))
            self.lines[(*place, key)] = line
        return found

    def _scalar(self, node: yaml.ScalarNode) -> Any:
        line, text = node.start_mark.line + 1, node.value
        expected = _SCALARS.get(node.tag)
        if expected is None:
            raise self._fail("a tag that is not read", "text, numbers, true or false", line, f"{node.tag} {text}")
        if node.tag == f"{_YAML}str":
            if control_character(text) is not None:
                raise self._fail("a control character in the text", "printable text", line, text)
            # YAML 1.1 reads 1e-3 as text; a metrologist means the number.
            return self._in_size(_number(text), text, line) if node.style is None else text
        if len(text) > LONGEST_NUMBER:
            raise self._fail(f"a number of {len(text)} characters", expected, line, text)
        try:
            value = yaml.constructor.SafeConstructor().construct_object(node)
        except (ArithmeticError, LookupError, ValueError):
            raise self._fail("another kind of value", expected, line, text) from None
        return self._in_size(value, text, line)

    def _in_size(self, value: Any, text: str, line: int) -> Any:
        # Infinity is left to the schema, which names the entry.
        if isinstance(value, int | float) and LARGEST < abs(value) < float("inf"):
            raise self._fail("too large a number", f"at most {LARGEST:g}", line, text)
        return value

    def _fail(self, what: str, expected: str, line: int, value: object) -> InputError:
        return InputError(what, expected=expected, file=self.path, line=line, value=value)


def _number(text: str) -> Any:
    try:
        return float(text) if len(text) <= LONGEST_NUMBER else text
    except ValueError:
        return text


def line_of(place: Place, lines: Mapping[Place, int]) -> int | None:
    """Return the line of an entry, or of the nearest entry around it."""
    while place and place not in lines:
        place = place[:-1]
    return lines.get(place)


def _expected(first: Any, known: Sequence[str]) -> str:
    """What is expected, in words of ours where pydantic's are about programs."""
    if known:
        return f"one of {', '.join(known)}"
    if first["type"] in _IN_WORDS:
        return _IN_WORDS[first["type"]]
    return str(first.get("ctx", {}).get("expected") or first["msg"].removeprefix("Input should be "))


def _meant(first: Any, known: Sequence[str]) -> str | None:
    """The known name nearest to an unknown key, or to a word that is not in a list."""
    if first["type"] == "literal_error":
        return nearest(str(first["input"]), re.findall(r"'([^']*)'", str(first.get("ctx", {}).get("expected"))))
    return nearest(str(first["loc"][-1]), known) if known else None


def _known(schema: type[BaseModel], place: Sequence[str | int]) -> list[str]:
    """The known keys at the place of an unknown one."""
    models: list[type[BaseModel]] = [schema]
    for part in place[:-1]:
        below = [
            field.annotation
            for model in models
            for name, field in model.model_fields.items()
            if part in (name, field.alias)
        ]
        models = [model for annotation in below for model in _models(annotation)] or models
    return [field.alias or name for model in models for name, field in model.model_fields.items()]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The models an annotation names, in whatever containers."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
