"""Files in and out: text that is read, and outputs that appear whole or not at all.

**Machine** (`schema: twin.machine/1`): see `urdf/dmu50.yaml`. Axes in command order with joint, kind, range (mm, degrees, or
`unlimited`), least increment and, where the joint's own frame will not do, `error_frame_rpy_deg`; `frames` names the tool and
work links and the axis coordinates at which the URDF's linear joints are zero; `programs` the words that switch the control's
kinematics (`tcp_on`, `tcp_off`) and a default tool length. `plausible` (optional) says how large errors can be before anything is
measured, one standard deviation: `{motion: {um: 200, urad: 200}, location: {um: 5000, urad: 5000}}`; 1000 µm and µrad if it does not.

**Calibration** (`schema: twin.calibration/1`): see `urdf/dmu50.calibration.yaml`.

    schema: twin.calibration/1
    machine: DMU 50 eVolution
    source: where the numbers come from, in words
    datum: as given                  # or mean lines, end points; computed where it is missing (twin doc datum)
    curves:
      E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [10.1, 11.4], source: …}   # covariance: [[…]] if known
      E_ZC: {unit: um, domain: [0, 360], basis: fourier, coefficients: [0, 3.2, -1.1]}
    squareness: {E_C0Y: 22.0}        # µrad
    location: {E_X0C: 4.0, E_A0C: -12.0}   # µm, µrad

`identify` adds a joint section `covariance:` with `parameters` (`E_XX[0]`, `E_XX[1]`, …, `E_C0Y`, `E_X0C`, in the units above)
and `lower`, the lower triangle, one row a line. It takes the place of the curves' own. `settled: false` says that the estimate did
not settle: no program and no table is made of such a file. `simulated: true` says that readings it comes from were simulated;
`identify`, `axis-run` and `diagnose --extended` write it, even where only one of several tables was simulated. `illustrative`,
`simulated`, `settled: false` and errors without a covariance are warnings: programs, tables of a control, reports and JSON
(`warnings`: a list of `name` and `text`) made from the file repeat them.

A curve is Σ c_k f_k(q), q in mm or degrees. `power`: f_k = u^k with u = (2q − lo − hi)/(hi − lo). `bernstein`: f_k = C(n,k) x^k
(1 − x)^(n−k), x = (q − lo)/(hi − lo), n = coefficients − 1: the same polynomials, the curve between its smallest and largest
coefficient. `fourier` (rotary axes): f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself. `cubic_spline` has
`knots: [0, 120, 500]` beside its coefficients, both ends of the domain among them (`twin doc curves`). Outside its domain a
curve is an error; an unlimited axis is wrapped into it. A linear axis moves, then errs: T(q)·E(q); a rotary axis is located,
errs in the frame that does not turn, then moves: L·E(θ)·R(θ); E = Trans(e_X, e_Y, e_Z)·Exp([e_A, e_B, e_C]).

`effects:` has what a diagnosis added beside these: `{effect: reversal, where: Y, parameters: {size: 5.1}}`. One of them has no known
cause: it shifts a side of the machine by what was measured, and is refused outside `range`.

    effects:
    - effect: empirical
      where: tool by X_mm, C_deg     # side, and columns of the table it depends on
      cause: unknown
      along: base                    # axes of the base frame, or of the frame that carries the targets: tool, work
      columns:
      - {column: X_mm, functions: half_waves, order: 8, range: [0.0, 500.0]}
      - {column: C_deg, functions: whole_turns, order: 4}
      parameters: {'x[1,0]': 0.42, 'z[3,c2]': -1.7}   # µm along x: function 1 of X; along z: function 3 of X times cos 2C

`half_waves` k: cos(k π (value − low)/(high − low)). `whole_turns` ck, sk: cos kθ, sin kθ. `direction` (`approach_<axis>`): +1 or −1.
0 means the constant 1. Columns are axes, directions of approach and temperatures; one or two.

**Measurements** (`*.csv`): one row a measured point: `X_mm … C_deg` commanded, `target`, `carrier` (`tool` or `work`), `x_mm,
y_mm, z_mm` in the station's frame (an empty field was not measured; the interferometer's length stands in `x_mm`), and
optionally `station`, `round`, `time_s`, `approach_<axis>`, `readback_<axis>_…`, `T_<axis or sensor>_degC`, `u_x_mm …`.
`twin.measurement.table.load` lists every row it sets aside, with the reason. A plan is the same table without the coordinates.
A comment that begins with `simulated` says that the readings are: `twin simulate` writes it.
Optional and ours: `place_x_mm, place_y_mm, place_z_mm`, the target's known place on its carrier (tool: frame of the spindle
nose; work: work frame), and `station_x_mm … station_z_mm, station_a_deg … station_c_deg`, the station's known origin and
rotation vector in the base frame; one row of a target or station is enough, contradictions are refused. In a plan
`planned_place_x_mm …`, `planned_station_x_mm …` say where they are meant to go: for `simulate`, never taken for known. A plan
that gives them is simulated with them; the measured file names them only in its comments.

**Report** (`--json`, `schema: twin.compensation/1`): `before` and `after` (RMS and maximum at the functional point in µm, of
the tool axis in µrad and its tilt about x and y of the tool (fused-like angles: independent of order), the worst line),
`classes`, `rounding_um`, `largest_correction`, `uncertainty`, `headline`, `complete` and `strictly_complete` (exit status 0 without and
with `--strict`), `not_corrected` (one entry a reason: `kind`, `blocks`, all `lines` of the input, those the exit status counts
as `missed`, the `worst`) and `notes` (what passed through as written, what was assumed). `identify --json` (`schema:
twin.identification/1`): `errors`, `table` (how the rotary axes' average lines tilt it, in fused-like angles),
`verdict` (a sentence), `not_identifiable` (with the `prior` of what is in the calibration all the same), `stations`, `targets`,
`misfit`, `orders`, `set_aside`, `notices`.

**Another machine.** A URDF and a machine file, nothing else: `twin compensate part.nc -o out.nc --machine mine.yaml`.
`urdf/trunnion_ac.*` (A–C trunnion, Y under the table) and `urdf/xyzbc_trunnion.*` (B–C trunnion, TCP by `M428`) are there to
copy. The z axis of the tool link points from the tip into the spindle. The rotary joint's frame has its axis along z, or the
file says how the error frame is turned. The error frames of linear axes are turned alike (that of the first is the machine
frame, in which squareness is named), or lean by less than 45° against the base link. Programs need three linear axes along x, y, z of
the work frame and at most two rotary ones, on either side; kinematics needs only a chain.
"""

from __future__ import annotations

import json
import math
import os
import platform
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, Final, final

from twin._common.errors import InputError

MOST_BYTES: Final = 2**29
"""Of a text file; a table of a million rows has a third of it."""
TEMPORARY: Final = ".twin-"
"""How the names of all temporary files and folders begin; process, random part and computer follow."""


def note_input(path: Path) -> None:
    """Tell the running command, if there is one, that this file is read.

    Raises:
        InputError: the command is going to write it.
    """
    run = _COMMAND.get()
    if run is not None:
        run.add_input(path)


def read_bytes(path: Path, *, most_bytes: int | None = None) -> bytes:
    """Return the content of a file.

    Args:
        path: the file.
        most_bytes: size beyond which it is refused; None: any.

    Raises:
        InputError: there is no such file, it cannot be read, it is too large, or the running command is going to write it.
    """
    note_input(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(-1 if most_bytes is None else most_bytes + 1)
    except (OSError, ValueError) as error:
        value = error.strerror if isinstance(error, OSError) else error
        raise InputError("cannot be read", expected="a readable file", file=path, value=value) from error
    if most_bytes is not None and len(data) > most_bytes:
        raise InputError("too large", expected=f"at most {most_bytes >> 20} MB of text", file=path)
    return data


def read_text(path: Path, *, most_bytes: int = MOST_BYTES) -> str:
    """Return the content of a UTF-8 text file.

    Args:
        path: the file.
        most_bytes: size beyond which it is refused.

    Raises:
        InputError: as `read_bytes`; it is not UTF-8 text.
    """
    data = read_bytes(path, most_bytes=most_bytes)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError("not a text file", expected="UTF-8 text", file=path, line=line, value=error.reason) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError("not a text file", expected="UTF-8 text without NUL", file=path, line=line)
    return text


def read_lines(path: Path) -> list[str]:
    """Return the lines of a UTF-8 text file, ended by LF, CR LF or CR and by no other character.

    Raises:
        InputError: as of `read_text`.
    """
    lines = read_text(path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if lines[-1] == "" else lines


def read_json(path: Path, expected: str) -> Any:
    """Return the data of a JSON file.

    Args:
        path: the file.
        expected: what it should be, for messages.

    Raises:
        InputError: as of `read_text`; it is not JSON, too deep, or has a number that is too long.
    """
    text = read_text(path)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError("not JSON", expected=expected, file=path, line=error.lineno, value=error.msg) from None
    except (RecursionError, ValueError):
        raise InputError("lists too deep or numbers too long", expected=expected, file=path) from None


@final
class CommandFiles:
    """The files that one command reads and writes; a file cannot be both.

    Attributes:
        read: input files by their resolved paths.
        outputs: output files by their resolved paths.
        written: those of them that are complete: reading them back is allowed.
    """

    def __init__(self) -> None:
        self.read: set[Path] = set()
        self.outputs: set[Path] = set()
        self.written: set[Path] = set()

    def add_input(self, path: Path) -> None:
        """Note that a file is read.

        Raises:
            InputError: the command is going to write it.
        """
        file = _resolved(path)
        if file in self.outputs - self.written:
            raise _also_an_input(path)
        self.read.add(file)

    def add_output(self, path: Path) -> None:
        """Note that a file is going to be written.

        Raises:
            InputError: the command has read it, under this name or another one.
        """
        file = _resolved(path)
        if file in self.written:
            return
        if any(_same_file(file, one) for one in self.read):
            raise _also_an_input(path)
        self.outputs.add(file)


_COMMAND: Final[ContextVar[CommandFiles | None]] = ContextVar("files of the running command", default=None)


@contextmanager
def command_files() -> Iterator[CommandFiles]:
    """Keep account of all files that are read and written meanwhile, so that no input is overwritten.

    Outside of it (in a notebook or a script) a file may be read, changed and saved under its own name. A nested one is the outer one.
    """
    running = _COMMAND.get()
    if running is not None:
        yield running
        return
    files = CommandFiles()
    token = _COMMAND.set(files)
    try:
        yield files
    finally:
        _COMMAND.reset(token)


def _also_an_input(path: Path) -> InputError:
    return InputError("an output is one of the inputs", expected="another file", file=path)


def _same_file(one: Path, other: Path) -> bool:
    try:
        return one == other or one.samefile(other)
    except (OSError, ValueError):
        return False


def _resolved(path: Path) -> Path:
    """Return the path without symbolic links.

    Raises:
        InputError: the operating system does not take it for a path.
    """
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError("not a path", expected="the path of a file", file=path, value=error) from error


def check_writable(paths: Sequence[Path]) -> None:
    """Find out before the work whether every output can be written, and clear away what killed runs left beside them.

    Raises:
        InputError: a folder is missing or not writable; an output is an input, no regular file or read-only; two outputs are one file.
    """
    run = _COMMAND.get()
    seen: set[Path] = set() if run is None else set(run.outputs)
    for path in paths:
        file = _resolved(path)
        if file in seen:
            raise InputError("two outputs are the same file", expected="a file each", file=path)
        seen.add(file)
        check_folder(_target(path).parent, path)


def check_folder(folder: Path, path: Path) -> None:
    """Find out whether files can be made in a folder, and clear away what killed runs left there.

    Args:
        folder: the folder.
        path: the output that is to go there, for the message.

    Raises:
        InputError: it is not writable.
    """
    _sweep(folder)
    try:
        os.unlink(_created(folder))
    except OSError as error:
        raise InputError("cannot be written", expected="a writable folder", file=path, value=error.strerror) from error


def _target(path: Path) -> Path:
    """Return the file that a write to the path replaces: a symbolic link is followed.

    Raises:
        InputError: as `check_writable`, of one path.
    """
    file = _resolved(path)
    run = _COMMAND.get()
    if run is not None:
        run.add_output(path)
    try:
        mode = path.stat().st_mode if path.exists() else None
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=path, value=error.strerror) from error
    if mode is not None and not stat.S_ISREG(mode):
        expected = "a file, not a folder" if stat.S_ISDIR(mode) else "a regular file, not a device or a pipe"
        raise InputError("cannot be written", expected=expected, file=path)
    if mode is not None and not (mode & 0o222 and os.access(file, os.W_OK)):
        raise InputError("cannot be written", expected="a file that is not read-only", file=path)
    if not file.parent.is_dir():
        raise InputError("cannot be written", expected=f"an existing folder {file.parent}", file=path)
    return file


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file atomically: at every moment the path holds the old content or the new one.

    Raises:
        InputError: it cannot be written.
    """
    with whole_file(path) as stream:
        stream.write(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def write_json(path: Path, data: Any) -> None:
    """Write JSON atomically; a number that is not finite is written as null, which means unknown.

    Raises:
        InputError: it cannot be written.
    """
    write_whole(path, json.dumps(_finite(data), indent=1, allow_nan=False) + "\n")


def _finite(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    return [_finite(value) for value in data] if isinstance(data, list | tuple) else data


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that takes the path's place when all of it is written; on an error nothing is left.

    An existing file keeps its mode and, where permitted, its owner; a symbolic link stays, and its target is replaced.

    Raises:
        InputError: it cannot be written.
    """
    target = _target(path)
    try:
        temporary = _created(target.parent)
        try:
            with temporary.open("wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            move_into_place(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=path, value=error.strerror) from error


def move_into_place(made: Path, path: Path) -> None:
    """Replace an output by a complete file from the same file system.

    Raises:
        InputError: the output cannot be written.
        OSError: the operating system refuses.
    """
    target = _target(path)
    if target.exists():
        old = target.stat()
        with suppress(PermissionError):
            os.chown(made, old.st_uid, old.st_gid)
        os.chmod(made, stat.S_IMODE(old.st_mode))
    os.replace(made, target)
    run = _COMMAND.get()
    if run is not None:
        run.written.add(target)


@contextmanager
def scratch_folder(parent: Path | None = None) -> Iterator[Path]:
    """Make a folder for temporary files, in TMPDIR unless a parent is given; it is removed afterwards.

    What a killed run left is removed by the next one that makes a folder or writes a file there.

    Raises:
        OSError: it cannot be made.
    """
    place = Path(tempfile.gettempdir()) if parent is None else parent
    _sweep(place)
    folder = place / _temporary_name()
    os.mkdir(folder, 0o700)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _created(folder: Path) -> Path:
    """Create an empty temporary file, with the mode that a new file gets."""
    path = folder / _temporary_name()
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return path


def _temporary_name() -> str:
    return f"{TEMPORARY}{os.getpid()}-{secrets.token_hex(6)}-{platform.node()}"


def _sweep(folder: Path) -> None:
    """Remove temporary files and folders of this user whose process, on this computer, is gone."""
    try:
        left = [Path(entry.path) for entry in os.scandir(folder) if entry.name.startswith(TEMPORARY)]
    except OSError:
        return
    for path in left:
        pid, _, rest = path.name.removeprefix(TEMPORARY).partition("-")
        with suppress(OSError):
            ours = path.lstat().st_uid == os.geteuid() and rest.partition("-")[2] == platform.node()
            if not (ours and pid.isdecimal()) or _runs(int(pid)):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
