"""Files in and out: YAML whose errors know their line, and outputs that appear whole or not at all.

**Machine** (`schema: twin.machine/1`): see `urdf/dmu50.yaml`. Axes in command order with joint, kind, range (mm, degrees, or
`unlimited`), least increment and, where the joint's own frame will not do, `error_frame_rpy_deg`; `frames` names the tool and
work links and the axis coordinates at which the URDF's linear joints are zero; `programs` the words that switch the control's
kinematics (`tcp_on`, `tcp_off`) and a default tool length.

**Calibration** (`schema: twin.calibration/1`): see `urdf/dmu50.calibration.yaml`.

    schema: twin.calibration/1
    machine: DMU 50 eVolution
    source: where the numbers come from, in words
    curves:
      E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [10.1, 11.4], source: …}   # covariance: [[…]] if known
      E_ZC: {unit: um, domain: [0, 360], basis: fourier, coefficients: [0, 3.2, -1.1]}
    squareness: {E_C0Y: 22.0}        # µrad
    location: {E_X0C: 4.0, E_A0C: -12.0}   # µm, µrad

`identify` adds a joint section `covariance:` with `parameters` (`E_XX[0]`, `E_XX[1]`, …, `E_C0Y`, `E_X0C`, in the units above)
and `lower`, the lower triangle, one row a line. It takes the place of the curves' own. `settled: false` says that the estimate did
not settle: no program and no table is made of such a file.

A curve is Σ c_k f_k(q), q in mm or degrees. `power`: f_k = u^k with u = (2q − lo − hi)/(hi − lo). `bernstein`: f_k = C(n,k) x^k
(1 − x)^(n−k), x = (q − lo)/(hi − lo), n = coefficients − 1: the same polynomials, the curve between its smallest and largest
coefficient. `fourier` (rotary axes): f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself. Outside its domain a
curve is an error; an unlimited axis is wrapped into it. A linear axis moves, then errs: T(q)·E(q); a rotary axis is located,
errs in the frame that does not turn, then moves: L·E(θ)·R(θ); E = Trans(e_X, e_Y, e_Z)·Exp([e_A, e_B, e_C]).

**Measurements** (`*.csv`): one row a measured point: `X_mm … C_deg` commanded, `target`, `carrier` (`tool` or `work`), `x_mm,
y_mm, z_mm` in the station's frame (an empty field was not measured; the interferometer's length stands in `x_mm`), and
optionally `station`, `round`, `time_s`, `approach_<axis>`, `readback_<axis>_…`, `T_<axis or sensor>_degC`, `u_x_mm …`.
`twin.measurement.load` lists every row it sets aside, with the reason. A plan is the same table without the coordinates.
Optional and ours: `place_x_mm, place_y_mm, place_z_mm`, the target's known place on its carrier (tool: frame of the spindle
nose; work: work frame), and `station_x_mm … station_z_mm, station_a_deg … station_c_deg`, the station's known origin and
rotation vector in the base frame; one row of a target or station is enough, contradictions are refused. In a plan
`planned_place_x_mm …`, `planned_station_x_mm …` say where they are meant to go: for `simulate`, never taken for known. A plan
that gives them is simulated with them; the measured file names them only in its comments.

**Report** (`--json`, `schema: twin.compensation/1`): `before` and `after` (RMS and maximum at the functional point in µm, of
the tool axis in µrad and its tilt about x and y of the tool (fused-like angles: independent of order), the worst line),
`classes`, `rounding_um`, `largest_correction`, `uncertainty`, and lists of lines: `out_of_range`, `not_met`,
`orientation_left`, `notes` (what passed through as written, what was assumed). `identify --json` (`schema:
twin.identification/1`): `errors`, `table` (how the rotary axes' average lines tilt it, in fused-like angles),
`not_identifiable`, `stations`, `targets`, `misfit`, `orders`, `set_aside`, `notices`.

**Another machine.** A URDF and a machine file, nothing else: `twin compensate part.nc -o out.nc --machine mine.yaml`.
`urdf/trunnion_ac.*` (A–C trunnion, Y under the table) and `urdf/xyzbc_trunnion.*` (B–C trunnion, TCP by `M428`) are there to
copy. The z axis of the tool link points from the tip into the spindle. The rotary joint's frame has its axis along z, or the
file says how the error frame is turned. Programs need three linear axes along x, y, z of the work frame and at most two rotary
ones, on either side; kinematics needs only a chain.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from twin.errors import InputError, nearest

Schema = TypeVar("Schema", bound=BaseModel)
Place = tuple[str | int, ...]
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
"""What pydantic's kinds of errors want."""


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
        # A key that nobody knows says more than the one that is therefore missing.
        told = error.errors()
        first = next((one for one in told if one["type"] == "extra_forbidden"), told[0])
        # pydantic names the member of a union it tried; the file has no such entry.
        place = tuple(part for part in first["loc"] if not (isinstance(part, str) and "[" in part))
        entry = ".".join(str(part) for part in place)
        known = _known(schema, first["loc"]) if first["type"] == "extra_forbidden" else []
        raise InputError(
            f"`{entry}` is missing" if first["type"] == "missing" else f"`{entry}` does not fit",
            expected=_expected(first, known),
            file=path,
            line=line_of(place, lines),
            # Of a whole file it would be all of it.
            value=None if first["type"] == "missing" and len(place) == 1 else first["input"],
            nearest=_meant(first, known),
        ) from error


def _expected(first: Any, known: Sequence[str]) -> str:
    """What should stand there, in words of ours where pydantic's are about programs."""
    if known:
        return f"one of {', '.join(known)}"
    if first["type"] in _IN_WORDS:
        return _IN_WORDS[first["type"]]
    return str(first.get("ctx", {}).get("expected") or first["msg"].removeprefix("Input should be "))


def _meant(first: Any, known: Sequence[str]) -> str | None:
    """What a key nobody knows, or a word that is none of a list, was probably meant to be."""
    if first["type"] == "literal_error":
        return nearest(str(first["input"]), re.findall(r"'([^']*)'", str(first.get("ctx", {}).get("expected"))))
    return nearest(str(first["loc"][-1]), known) if known else None


def _known(schema: type[BaseModel], place: Sequence[str | int]) -> list[str]:
    """The keys there are where one stands that nobody knows."""
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
