"""YAML files validated against a pydantic model; errors name file and line.

Only what a file of `twin` needs is accepted: text, numbers, true and false, lists and mappings. A date is text. Nesting depth, number
of entries and file size are bounded, with aliases expanded, so that reading always ends.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar, final, get_args

import yaml
from pydantic import BaseModel, ValidationError

from twin._common.errors import InputError, closest_name, control_character
from twin._common.files import other_kind, read_text

Schema = TypeVar("Schema", bound=BaseModel)
EntryPath = tuple[str | int, ...]

MAX_BYTES: Final = 2**23
MAX_ENTRIES: Final = 50_000
"""Most entries of a file with all aliases expanded; a calibration of five axes has a few thousand."""
MAX_DEPTH: Final = 32
"""Most levels of nesting; a calibration has five."""
MAX_NUMBER_LENGTH: Final = 400
"""Most characters of a number, or of text that looks like one."""
MAX_VALUE: Final = 1e15
"""Largest absolute value of a number in any unit; products such as its square stay finite."""
_NUMBER: Final = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_YAML: Final = "tag:yaml.org,2002:"
_SCALARS: Final[Mapping[str, str]] = {
    f"{_YAML}str": "text",
    f"{_YAML}int": "a whole number",
    f"{_YAML}float": "a number",
    f"{_YAML}bool": "true or false",
    f"{_YAML}null": "nothing",
}
"""Accepted scalar tags, with the expected value in words."""
_EXPECTED_WORDS: Final = {
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
"""Expected value in words, by pydantic's error type."""


def _refuse_other_kind(path: Path, name: str) -> None:
    kind = other_kind(read_text(path), "a calibration", "a machine file", "another file of twin")
    if kind is not None:
        raise InputError(f"{kind}, not a YAML file", expected=f"a file with `schema: {name}`", file=path)


def load_yaml(path: Path, schema: type[Schema], name: str) -> tuple[Schema, Mapping[EntryPath, int]]:
    """Return a YAML file validated against a pydantic model whose ``schema:`` is ``name``, and the line of every entry by its path."""
    try:
        data, lines = read_yaml(path)
    except InputError:
        _refuse_other_kind(path, name)
        raise
    if not isinstance(data, dict) or "schema" not in data:
        _refuse_other_kind(path, name)
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
        # Report an unknown key before the missing key that it probably stands for.
        errors = error.errors()
        first = next((entry for entry in errors if entry["type"] == "extra_forbidden"), errors[0])
        # pydantic puts the tried member of a union into the path; the file has no such entry.
        place = tuple(part for part in first["loc"] if not (isinstance(part, str) and "[" in part))
        entry = ".".join(str(part) for part in place)
        known = _known_keys(schema, first["loc"]) if first["type"] == "extra_forbidden" else []
        raise InputError(
            f"`{entry}` is missing" if first["type"] == "missing" else f"`{entry}` is invalid",
            expected=_expected(first, known),
            file=path,
            line=line_of(place, lines),
            # The value enclosing a missing top-level entry would be the whole file.
            value=None if first["type"] == "missing" and len(place) == 1 else first["input"],
            nearest=_suggested(first, known),
        ) from error


def read_yaml(path: Path) -> tuple[Any, Mapping[EntryPath, int]]:
    """Return the plain data of a YAML file, and the line of every entry by its path.

    Raises `InputError` with the line: not YAML, a tag or value that is not accepted, a duplicate key, nested too deeply or too large.
    """
    text = read_text(path, most_bytes=MAX_BYTES)
    root = _root(text, path)
    converter = _NodeConverter(path)
    return (None if root is None else converter.plain(root, ())), converter.lines


def _root(text: str, path: Path) -> yaml.Node | None:
    """Return the root of the nodes of a text.

    The C parser of PyYAML is ten times faster, where it is installed; its messages differ, so that a text it refuses is parsed again.
    """
    if _FastLoader is not None:
        with suppress(yaml.YAMLError):
            return _composed(_FastLoader(text))
    try:
        return _composed(_Loader(text))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise InputError(
            "not YAML", expected="a YAML file", file=path, line=mark.line + 1 if mark else 1, value=error.problem
        ) from error
    except yaml.reader.ReaderError as error:
        raise InputError(
            "control character in the text",
            expected="a YAML file",
            file=path,
            line=text.count("\n", 0, error.position) + 1,
        ) from error
    except yaml.YAMLError as error:
        raise InputError("not YAML", expected="a YAML file", file=path, line=1, value=error) from error


def _composed(loader: Any) -> yaml.Node | None:
    try:
        return loader.get_single_node()
    finally:
        loader.dispose()


class _BoundedComposer(yaml.composer.Composer, yaml.resolver.Resolver):
    """A composer of YAML nodes that bounds their depth and number."""

    def __init__(self) -> None:
        yaml.composer.Composer.__init__(self)
        yaml.resolver.Resolver.__init__(self)
        # Resolve neither dates nor merge keys: a date is text, and `<<` an unknown entry.
        self.yaml_implicit_resolvers = {
            first: [(tag, pattern) for tag, pattern in resolvers if tag in _SCALARS]
            for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
        }
        self.depth = 0
        self.count = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a node as PyYAML does; raise `MarkedYAMLError` beyond `MAX_DEPTH` or `MAX_ENTRIES`."""
        mark = self.peek_event().start_mark  # type: ignore[attr-defined]
        self.depth += 1
        self.count += 1
        if self.depth > MAX_DEPTH:
            raise yaml.MarkedYAMLError(problem=f"more than {MAX_DEPTH} levels", problem_mark=mark)
        if self.count > MAX_ENTRIES:
            raise yaml.MarkedYAMLError(problem=f"more than {MAX_ENTRIES} entries", problem_mark=mark)
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


@final
class _Loader(_BoundedComposer, yaml.reader.Reader, yaml.scanner.Scanner, yaml.parser.Parser):
    def __init__(self, text: str) -> None:
        yaml.reader.Reader.__init__(self, text)
        yaml.scanner.Scanner.__init__(self)
        yaml.parser.Parser.__init__(self)
        _BoundedComposer.__init__(self)


_FastLoader: Any = None
if yaml.__with_libyaml__:
    from yaml._yaml import CParser

    @final
    class _CLoader(_BoundedComposer, CParser):
        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            _BoundedComposer.__init__(self)

    _FastLoader = _CLoader


@final
class _NodeConverter:
    """Conversion of YAML nodes to plain data, with aliases expanded; ``lines`` holds the line of every entry by its path."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: dict[EntryPath, int] = {}
        self._open_nodes: list[yaml.Node] = []

    def plain(self, node: yaml.Node, place: EntryPath) -> Any:
        """Return the plain data of a node; raise `InputError` if its kind is not accepted, it is too large, or contains itself."""
        line = node.start_mark.line + 1
        self.lines[place] = line
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node)
        if node.tag not in (f"{_YAML}map", f"{_YAML}seq"):
            raise self._error("unsupported tag", "entries or a list without a tag", line, node.tag)
        if any(open_node is node for open_node in self._open_nodes):
            raise self._error("alias inside its own anchor", "no recursion", line, None)
        if len(self.lines) > MAX_ENTRIES:
            raise self._error(f"more than {MAX_ENTRIES} entries with aliases expanded", "a smaller file", line, None)
        self._open_nodes.append(node)
        try:
            if isinstance(node, yaml.SequenceNode):
                return [self.plain(item, (*place, index)) for index, item in enumerate(node.value)]
            return self._entries(node, place)
        finally:
            self._open_nodes.pop()

    def _entries(self, node: yaml.Node, place: EntryPath) -> dict[Any, Any]:
        entries: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise self._error("list or mapping used as a key", "`name: value`", line, None)
            key = self._scalar(key_node)
            if not isinstance(key, str):
                raise self._error("key that is not text", "quotes around it", line, key_node.value)
            if key in entries:
                raise self._error("duplicate key", "each key once", line, key)
            entries[key] = self.plain(value_node, (*place, key))
            self.lines[(*place, key)] = line
        return entries

    def _scalar(self, node: yaml.ScalarNode) -> Any:
        line, text = node.start_mark.line + 1, node.value
        expected = _SCALARS.get(node.tag)
        if expected is None:
            raise self._error("unsupported tag", "text, numbers, true or false", line, f"{node.tag} {text}")
        if node.tag == f"{_YAML}str":
            if control_character(text) is not None:
                raise self._error("control character in the text", "printable text", line, text)
            # YAML 1.1 reads 1e-3 as text, but the number is meant.
            return self._checked_size(_number(text), text, line) if not node.style else text
        if len(text) > MAX_NUMBER_LENGTH:
            raise self._error(f"number of {len(text)} characters", expected, line, text)
        try:
            value = yaml.constructor.SafeConstructor().construct_object(node)
        except (ArithmeticError, LookupError, ValueError):
            raise self._error("wrong kind of value", expected, line, text) from None
        return self._checked_size(value, text, line)

    def _checked_size(self, value: Any, text: str, line: int) -> Any:
        # The schema rejects infinity, and its error names the entry.
        if isinstance(value, int | float) and MAX_VALUE < abs(value) < float("inf"):
            raise self._error("number too large", f"at most {MAX_VALUE:g}", line, text)
        return value

    def _error(self, what: str, expected: str, line: int, value: object) -> InputError:
        return InputError(what, expected=expected, file=self.path, line=line, value=value)


def _number(text: str) -> Any:
    return float(text) if len(text) <= MAX_NUMBER_LENGTH and _NUMBER.fullmatch(text) else text


def yaml_text(data: Any) -> str:
    """Return plain data as YAML, which `read_yaml` reads as the same data, in the same order; but it refuses control characters."""
    return str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None))


def quoted(text: str) -> str:
    """Return a text in double quotes, on one line of a YAML file."""
    return str(yaml.dump(text, allow_unicode=True, width=float("inf"), default_style='"')).rstrip("\n")


class _Dumper(yaml.SafeDumper):
    """A dumper that quotes every text which `read_yaml` takes for a number."""


def _quoted_number(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    style = None if _number(text) is text else "'"
    return dumper.represent_scalar(f"{_YAML}str", text, style=style)


_Dumper.add_representer(str, _quoted_number)


def line_of(place: EntryPath, lines: Mapping[EntryPath, int]) -> int | None:
    """Return the line of an entry, or of the closest enclosing entry."""
    while place and place not in lines:
        place = place[:-1]
    return lines.get(place)


def _expected(first: Any, known: Sequence[str]) -> str:
    """Return what is expected, in plain words instead of pydantic's."""
    if known:
        return f"one of {', '.join(known)}"
    if first["type"] in _EXPECTED_WORDS:
        return _EXPECTED_WORDS[first["type"]]
    return str(first.get("ctx", {}).get("expected") or first["msg"].removeprefix("Input should be "))


def _suggested(first: Any, known: Sequence[str]) -> str | None:
    """Return the known name closest to an unknown key, or the allowed word closest to another."""
    if first["type"] == "literal_error":
        return closest_name(str(first["input"]), re.findall(r"'([^']*)'", str(first.get("ctx", {}).get("expected"))))
    return closest_name(str(first["loc"][-1]), known) if known else None


def _known_keys(schema: type[BaseModel], place: Sequence[str | int]) -> list[str]:
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
    """Return the models an annotation contains, in whatever containers."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
