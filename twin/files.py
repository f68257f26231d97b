"""Files in and out: YAML whose errors know their line, and outputs that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from twin.errors import InputError

Schema = TypeVar("Schema", bound=BaseModel)
Place = tuple[str | int, ...]


def read_text(path: Path) -> str:
    """A UTF-8 text file.

    Raises:
        InputError: there is no such file, it cannot be read, or it is not UTF-8 text.
    """
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("not a text file", expected="UTF-8 text", file=path, value=error.reason) from error
    except OSError as error:
        raise InputError("cannot be read", expected="a readable file", file=path, value=error.strerror) from error


def load_yaml(path: Path, schema: type[Schema], name: str) -> tuple[Schema, Mapping[Place, int]]:
    """A YAML file checked against a pydantic model, and the line of every entry by its place in the file.

    Args:
        path: the file.
        schema: the model it must fit.
        name: the value its ``schema:`` entry must have.

    Raises:
        InputError: with the line, on anything that does not fit; a key given twice included.
    """
    try:
        root = yaml.compose(read_text(path), Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        raise InputError(
            "not YAML", expected="a YAML file", file=path, line=mark.line + 1 if mark else None, value=error.problem
        ) from error
    except yaml.YAMLError as error:
        raise InputError("not YAML", expected="a YAML file", file=path, value=error) from error
    if not isinstance(root, yaml.MappingNode):
        raise InputError("no entries", expected=f"a file with `schema: {name}`", file=path)
    lines: dict[Place, int] = {}
    data = _plain(root, (), lines, path)
    if data.get("schema") != name:
        raise InputError(
            "wrong kind of file",
            expected=f"schema: {name}",
            file=path,
            line=lines.get(("schema",)),
            value=data.get("schema"),
        )
    try:
        return schema.model_validate(data), lines
    except ValidationError as error:
        first = error.errors()[0]
        # pydantic names the member of a union it tried; the file has no such entry.
        place = tuple(part for part in first["loc"] if not (isinstance(part, str) and "[" in part))
        entry = ".".join(str(part) for part in place)
        expected = str(first.get("ctx", {}).get("expected") or first["msg"].removeprefix("Input should be "))
        raise InputError(
            f"`{entry}` does not fit",
            expected=expected,
            file=path,
            line=line_of(place, lines),
            value=first["input"],
        ) from error


def line_of(place: Place, lines: Mapping[Place, int]) -> int | None:
    """The line of an entry, or of the nearest entry around it."""
    while place and place not in lines:
        place = place[:-1]
    return lines.get(place)


def _plain(node: yaml.Node, place: Place, lines: dict[Place, int], path: Path) -> Any:
    lines[place] = node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        found: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            key = _scalar(key_node)
            if key in found:
                raise InputError(
                    "given twice", expected="each key once", file=path, line=key_node.start_mark.line + 1, value=key
                )
            found[key] = _plain(value_node, (*place, key), lines, path)
            lines[(*place, key)] = key_node.start_mark.line + 1
        return found
    if isinstance(node, yaml.SequenceNode):
        return [_plain(item, (*place, index), lines, path) for index, item in enumerate(node.value)]
    return _scalar(node)


def _scalar(node: yaml.Node) -> Any:
    value = yaml.constructor.SafeConstructor().construct_object(node, deep=True)
    if isinstance(value, str) and isinstance(node, yaml.ScalarNode) and node.style is None:
        # YAML 1.1 reads 1e-3 as text; a metrologist means the number.
        try:
            return float(value)
        except ValueError:
            return value
    return value


def check_writable(paths: Sequence[Path]) -> None:
    """Find out before the work that every output can be written.

    Raises:
        InputError: a folder is missing or not writable, an output is a folder, or two outputs are one file.
    """
    seen: set[Path] = set()
    for path in paths:
        folder = path.parent
        if path.resolve() in seen:
            raise InputError("two outputs are the same file", expected="a file each", file=path)
        seen.add(path.resolve())
        if path.is_dir():
            raise InputError("cannot be written", expected="a file, not a folder", file=path)
        if not folder.is_dir():
            raise InputError("cannot be written", expected=f"an existing folder {folder}", file=path)
        try:
            handle, probe = tempfile.mkstemp(dir=folder, prefix=f".{path.name}.")
        except OSError as error:
            raise InputError(
                "cannot be written", expected="a writable folder", file=path, value=error.strerror
            ) from error
        os.close(handle)
        os.unlink(probe)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file so that at every moment the old content or the new one is there, whole.

    Raises:
        InputError: it cannot be written.
    """
    with whole_file(path) as stream:
        stream.write(content.encode("utf-8") if isinstance(content, str) else content)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write bit by bit, which takes its place when all of it is there; where the writing breaks off, nothing is left.

    Raises:
        InputError: it cannot be written.
    """
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(temporary, 0o666 & ~_umask())
            os.replace(temporary, path)
        finally:
            Path(temporary).unlink(missing_ok=True)
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=path, value=error.strerror) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
