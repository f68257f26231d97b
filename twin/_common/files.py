"""File formats: machine, calibration, measurement table, reports; how they are read and written.

**Machine** (`schema: twin.machine/1`): see `urdf/dmu50.yaml`. Axes in command order with joint, kind, range (mm, degrees, or
`unlimited`), least increment and, where the error frame is turned against the joint's own frame, `error_frame_rpy_deg`. `frames`
names the tool and work links and the axis coordinates at which the URDF's linear joints are zero. `programs` gives the words that
switch tool centre point control on and off (`tcp_on`, `tcp_off`), words of the machine's builder that leave positions, frames,
offsets and modes alone (`harmless: [M51, M88, AIRBLAST]`), and a default tool length. `plausible` (optional) gives the prior
standard deviation of errors before anything is measured: `{motion: {um: 200, urad: 200}, location: {um: 5000, urad: 5000}}`; the
default is 1000 µm and 1000 µrad.

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

`identify` adds a joint section `covariance:` with `parameters` (`E_XX[0]`, `E_XX[1]`, …, `E_C0Y`, `E_X0C`, in the units above) and
its lower triangle: `lower`, one row per line, for up to 20 parameters, otherwise `compressed` with `sha256`, at the end of the file
(base64 of a zlib stream of float64 numbers, little-endian, row by row, their bytes grouped by position; the hash is that of the
ungrouped bytes). It replaces the covariances of the curves. `settled: false` means that the estimate did not converge: no program and
no compensation table can be made from such a file. `simulated: true` means that some of the readings
were simulated; `identify`, `axis-run` and `diagnose --extended` write it, even if only one of several tables was simulated.

`identify`, `axis-run` and `diagnose --extended` also write what is not known:

    instruments: [tracker]
    set_up: {stations: 1, targets_on_tool: 3, targets_on_work: 3, points: 840}
    misfit: {verdict: consistent, says: …, rms_um: 0.9, reduced_chi2: 1.0, dof: 2100.0, p_value: 0.4, held_out_rms_um: 1.0}
    not_identifiable:
    - {name: E_X0B, why: cannot be separated from station 1 and the targets; enter the targets' places}
    not_estimated: [E_C0Y]           # left out on request (`--only`): counts as zero

`verdict`: `consistent`, `systematic` (a repeatable part of the residuals is not described), `larger` (than the stated noise) or
`untested` (too few readings). An error under `not_identifiable` has no value, and is not zero: U at the tool includes the `plausible`
size of the machine file for it. One that has a value nevertheless, because other errors refer to it, has that size in the covariance.
`not_estimated` only bars kinematics with such a location. `diagnose --extended` keeps the given entries. It adds errors that are
confounded with a cause and, if the given file has no `set_up`, those that its readings could not show. Its `misfit` replaces the given
one if all axes moved or if it is worse. All of these entries are optional.

`illustrative`, `simulated`, `settled: false`, `not_identifiable`, a `misfit` that is not `consistent`, and errors without a covariance
are warnings. Programs, control tables, reports and JSON (`warnings`: a list of `name` and `text`) made from the file repeat them.

A curve is Σ c_k f_k(q), q in mm or degrees. `power`: f_k = u^k with u = (2q − lo − hi)/(hi − lo). `bernstein`: f_k = C(n,k) x^k (1 −
x)^(n−k), x = (q − lo)/(hi − lo), n = coefficients − 1: the same polynomials, bounded by the smallest and the largest coefficient.
`fourier` (rotary axes): f = 1, cos θ, sin θ, cos 2θ, sin 2θ, …, θ the axis angle itself. `cubic_spline` has `knots: [0, 120, 500]`
beside its coefficients, both ends of the domain among them (`twin doc curves`). Evaluating a curve outside its domain is an error; an
unlimited axis is wrapped into it. For a linear axis the error follows the motion: T(q)·E(q). For a rotary axis the location comes
first, then the error in the non-rotating frame, then the motion: L·E(θ)·R(θ). E = Trans(e_X, e_Y, e_Z)·Exp([e_A, e_B, e_C]).

`effects:` holds the effects that a diagnosis added: `{effect: reversal, where: Y, parameters: {size: 5.1}}`. An `empirical` effect
has no known cause: it is a fitted displacement of the tool or work side, and cannot be evaluated outside `range`.

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
Function 0 is the constant 1. One or two columns: axes, directions of approach, temperatures.

**Thermal records** (`*.csv`) and **thermal models** (`schema: twin.thermal-model/1`): see `twin doc thermal`.

**Columns of other tables** (`schema: twin.columns/1`): a mapping that `twin import` proposes and applies; see `twin doc import`.

**Measurements** (`*.csv`): one row per measured point: `X_mm … C_deg` commanded, `target`, `carrier` (`tool` or `work`), `x_mm,
y_mm, z_mm` in the station's frame (an empty field was not measured; an interferometer's length goes into `x_mm`), and optionally
`station`, `round`, `time_s`, `approach_<axis>`, `readback_<axis>_…`, `T_<axis or sensor>_degC`, `spindle_rpm`, `load_kg` (the mass
that the spindle, the gripper or the table carries in this row, 0 if nothing), `u_x_mm …`. `Measurements.load` lists
every row that it excludes, with the reason. A plan is the same table without the coordinates. A comment that begins with
`simulated` marks simulated readings; `twin simulate` writes it. A comment such as `measured 2026-03-02 08:10` gives the date (`twin
watch`). Further optional columns: `place_x_mm, place_y_mm, place_z_mm`, the target's known place on its carrier (tool: frame of the
spindle nose; work: work frame), and `station_x_mm … station_z_mm, station_a_deg … station_c_deg`, the station's known origin and
rotation vector in the base frame; one row of a target or station is enough, contradictions are errors. In a plan,
`planned_place_x_mm …` and `planned_station_x_mm …` give the intended set-up. `simulate` uses them, but nothing treats them as
known; the simulated table gives them only in its comments.

`station_carrier` (`base`, `tool`, `work`) is the side on which the station rides; its readings and pose are then in the frame of that
side. `instrument` names the instrument of the station; without it the readings indicate it. Instruments that measure the tool relative
to the table:

    instrument              station on   target on   reading
    probe                   tool (tip)   work        0, 0, 0: X_mm … are the positions at which the tip was at the sphere's centre
    r-test                  work         tool        x, y, z of the ball in the nest
    ball-bar                work         tool        length in x_mm
    linear-interferometer   base, work   tool        coordinate along the beam in x_mm

The comment `# ball bar length: 150 mm` states the nominal length of a ball bar; `twin convert` and `twin plan` write it, and `simulate`
keeps it. Readings below half of that length are deviations from it. A table has the readings of one length.

A table has at most 10 million cells (one for `import` 3 million), a text file 256 MB. Instead of a file a command reads a pipe
(`/dev/stdin`, `<(…)` of a shell) to its end; it refuses a pipe that no program writes to within five seconds, devices and sockets. A
calibration, a table, a thermal model and a URDF are read back before they replace the file of that name. Outputs of two runs that write
the same files at the same time are all of one run.

**Report** (`--json`, `schema: twin.compensation/1`): `before` and `after` (RMS and maximum at the functional point in µm, of the tool
axis in µrad and its tilt about x and y of the tool (angles independent of order), the worst line), `classes`, `rounding_um`,
 `largest_correction`, `uncertainty`, `headline`, `complete` and `strictly_complete` (exit status 0 without and with
`--strict`), `not_corrected` (one entry per reason: `kind`, `blocks`, all `lines` of the input, those that count for the exit status
as `missed`, the `worst`) and `notes` (blocks passed through unchanged, assumptions). `identify --json` (`schema:
twin.identification/1`): `errors`, `table` (how the rotary axes' average lines tilt it), `verdict` (a sentence),
`not_identifiable` (with the `prior` of those that the calibration contains nevertheless), `stations`, `targets`, `misfit`, `orders`,
`set_aside`, `notices`.

**Another machine** needs a URDF and a machine file: `twin compensate part.nc -o out.nc --machine mine.yaml`. `urdf/trunnion_ac.*`
(A–C trunnion, Y under the table) and `urdf/xyzbc_trunnion.*` (B–C trunnion, TCP by `M428`) serve as templates. The z axis of the tool
link points from the tip into the spindle. A rotary joint turns about z of its frame; for any other direction the machine file gives
the rotation of the error frame. The error frames of linear axes are parallel (that of the first is the machine frame, in which
squareness is named), or inclined by less than 45° to the base link. Programs need three linear axes along x, y, z of the work frame
and at most two rotary axes, on either side; the kinematics alone needs only a chain.
"""

from __future__ import annotations

import io
import json
import math
import os
import platform
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, Final, final

from twin._common.errors import InputError
from twin._common.output_locks import OutputLocks
from twin._common.pipes import is_readable_device, read_pipe

MAX_TEXT_BYTES: Final = 2**28
"""Largest text file in bytes; a table of a million rows needs a third of it."""
TEMPORARY_PREFIX: Final = ".twin-"
"""Prefix of the names of all temporary files and folders; process id, random part and computer name follow."""


def register_input(path: Path) -> None:
    """Register a file as an input of the running command, if there is one.

    Raises:
        InputError: the command is going to write it.
    """
    tracker = _COMMAND.get()
    if tracker is not None:
        tracker.add_input(path)


def folder_entries(folder: Path, what: str) -> list[Path]:
    """Return the paths in a folder by name.

    Args:
        folder: the folder.
        what: what it is, in words, for the message.

    Raises:
        InputError: it is not a folder that can be read.
    """
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{what} cannot be read", expected="a folder", file=folder, value=error.strerror) from error


def names_beside(path: Path) -> list[str]:
    """Return the names of the files in the same folder; empty if there is no such folder."""
    try:
        return [file.name for file in path.parent.iterdir() if file.is_file()]
    except OSError:
        return []


def read_bytes(path: Path, *, most_bytes: int | None = None) -> bytes:
    """Return the content of a file.

    Args:
        path: the file.
        most_bytes: size beyond which it is refused; None: any.

    Raises:
        InputError: there is no such file, it cannot be read, it is too large, or the running command is going to write it.
    """
    try:
        with open_input(path) as stream:
            data = stream.read(-1 if most_bytes is None else most_bytes + 1)
    except InputError:
        raise
    except (OSError, ValueError) as error:
        value = error.strerror if isinstance(error, OSError) else error
        raise InputError("cannot be read", expected="a readable file", file=path, value=value) from error
    if most_bytes is not None and len(data) > most_bytes:
        raise InputError("too large", expected=f"at most {most_bytes >> 20} MB of text", file=path)
    return data


def open_input(path: Path) -> BinaryIO:
    """Open an input file: a regular file, a terminal, or a pipe that another program writes, such as ``<(…)`` of a shell.

    Raises:
        InputError: it is a device or a socket, no program writes to the pipe, or the running command is going to write it.
        OSError: it cannot be read.
    """
    register_input(path)
    mode = path.stat().st_mode
    if stat.S_ISFIFO(mode):
        return io.BytesIO(read_pipe(path, MAX_TEXT_BYTES))
    if stat.S_ISSOCK(mode) or stat.S_ISBLK(mode) or (stat.S_ISCHR(mode) and not is_readable_device(path)):
        raise InputError("a device or a socket", expected="a file, or a pipe that another program writes", file=path)
    return path.open("rb")


def read_text(path: Path, *, most_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the content of a UTF-8 text file.

    Args:
        path: the file.
        most_bytes: size beyond which it is refused.

    Raises:
        InputError: as `read_bytes`, or it is not UTF-8 text.
    """
    data = read_bytes(path, most_bytes=most_bytes)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if data.startswith(b"PK"):
            expected = "UTF-8 text (`twin import` reads spreadsheets)"
            raise InputError("a spreadsheet or zip file, not a text file", expected=expected, file=path) from error
        line = data.count(b"\n", 0, error.start) + 1
        is_table = path.suffix.lower() in (".csv", ".txt", ".tsv")
        expected = "UTF-8 text" + (" (`twin import` reads tables in other encodings)" if is_table else "")
        raise InputError("not a text file", expected=expected, file=path, line=line, value=error.reason) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError("not a text file", expected="UTF-8 text without NUL", file=path, line=line)
    return text


def read_lines(path: Path) -> list[str]:
    """Return the lines of a UTF-8 text file, split at LF, CR LF and CR only.

    Raises:
        InputError: as `read_text`.
    """
    lines = read_text(path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if lines[-1] == "" else lines


def read_json(path: Path, expected: str) -> Any:
    """Return the data of a JSON file.

    Args:
        path: the file.
        expected: what the file should contain, for messages.

    Raises:
        InputError: as `read_text`, or it is not JSON, nested too deeply, or has a number with too many digits.
    """
    text = read_text(path)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError("not JSON", expected=expected, file=path, line=error.lineno, value=error.msg) from None
    except (RecursionError, ValueError):
        raise InputError("lists nested too deeply or numbers too long", expected=expected, file=path) from None


@final
class CommandFiles:
    """The files that one command reads and writes; a file cannot be both.

    Attributes:
        read: input files by their resolved paths.
        outputs: output files by their resolved paths.
        written: complete output files, which may be read back.
        locks: locks of the output files, from the first that is complete to the end of the command.
    """

    def __init__(self) -> None:
        self.read: set[Path] = set()
        self.outputs: set[Path] = set()
        self.written: set[Path] = set()
        self._identities: set[tuple[int, int]] = set()
        self.locks = OutputLocks()

    def add_input(self, path: Path) -> None:
        """Register an input file.

        Raises:
            InputError: the command is going to write it.
        """
        file = _resolved(path)
        if file in self.outputs - self.written:
            raise _input_conflict(path)
        self.read.add(file)
        self._identities |= _identity(file)

    def add_output(self, path: Path, file: Path) -> None:
        """Register an output file.

        Args:
            path: its path as given, for the message.
            file: its resolved path.

        Raises:
            InputError: the command has read it, under this name or another one.
        """
        if file in self.written:
            return
        if file in self.read or _identity(file) & self._identities:
            raise _input_conflict(path)
        self.outputs.add(file)


_COMMAND: Final[ContextVar[CommandFiles | None]] = ContextVar("files of the running command", default=None)


@contextmanager
def tracked_files() -> Iterator[CommandFiles]:
    """Track all files read and written inside the context, so that no input is overwritten.

    Without it (in a notebook or a script) a file may be read, changed and saved under its own name. A nested call returns the outer
    tracker.
    """
    outer = _COMMAND.get()
    if outer is not None:
        yield outer
        return
    files = CommandFiles()
    token = _COMMAND.set(files)
    try:
        yield files
    finally:
        _COMMAND.reset(token)
        files.locks.release()


def _input_conflict(path: Path) -> InputError:
    return InputError("output file is also an input", expected="another file", file=path)


def _identity(file: Path) -> set[tuple[int, int]]:
    """Return device and number of a file, which all its names share; empty if there is no such file."""
    try:
        found = file.stat()
    except (OSError, ValueError):
        return set()
    return {(found.st_dev, found.st_ino)}


def _resolved(path: Path) -> Path:
    """Return the path without symbolic links.

    Raises:
        InputError: the operating system rejects the path.
    """
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError("not a path", expected="the path of a file", file=path, value=error) from error


def check_writable(paths: Sequence[Path]) -> None:
    """Check that every output can be written, before the work starts, and remove what killed runs left in their folders.

    Raises:
        InputError: a folder is missing or not writable; an output is an input, not a regular file, or read-only; two outputs are the
            same file.
    """
    tracker = _COMMAND.get()
    seen: set[Path] = set() if tracker is None else set(tracker.outputs)
    for path in paths:
        file = _resolved(path)
        if file in seen:
            raise InputError("two outputs are the same file", expected="different files", file=path)
        seen.add(file)
        check_folder(_target(path).parent, path)


def check_folder(folder: Path, path: Path) -> None:
    """Check that files can be created in a folder, and remove what killed runs left there.

    Args:
        folder: the folder.
        path: the output to be written there, for the message.

    Raises:
        InputError: it is not writable.
    """
    _remove_leftovers(folder)
    try:
        os.unlink(_new_temporary(folder))
    except OSError as error:
        raise InputError("cannot be written", expected="a writable folder", file=path, value=error.strerror) from error


def _target(path: Path) -> Path:
    """Return the file that writing to a path replaces, following symbolic links.

    Raises:
        InputError: as `check_writable`, for one path.
    """
    file = _resolved(path)
    tracker = _COMMAND.get()
    if tracker is not None:
        tracker.add_output(path, file)
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
        expected = f"an existing folder: create {path.parent} first"
        raise InputError("cannot be written: its folder does not exist", expected=expected, file=path)
    return file


def write_atomic(path: Path, content: str | bytes, *, check: Callable[[Path], object] | None = None) -> None:
    """Write a file atomically: at every moment the path holds the old content or the new one.

    Args:
        path: the file.
        content: its content; text as UTF-8.
        check: reads the complete file, under a temporary name in the same folder, before it replaces the path. If it raises an
            `InputError`, the path keeps its old content.

    Raises:
        InputError: it cannot be written, or the check refuses it.
    """
    with atomic_file(path, check) as stream:
        stream.write(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def write_json(path: Path, data: Any, *, check: Callable[[Path], object] | None = None) -> None:
    """Write JSON atomically; a number that is not finite is written as null, meaning unknown.

    Args:
        path: the file.
        data: its content.
        check: as for `write_atomic`.

    Raises:
        InputError: it cannot be written, or the check refuses it.
    """
    write_atomic(path, json.dumps(_finite(data), indent=1, allow_nan=False) + "\n", check=check)


def _finite(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    return [_finite(value) for value in data] if isinstance(data, list | tuple) else data


@contextmanager
def atomic_file(path: Path, check: Callable[[Path], object] | None = None) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces the path when it is complete; after an error nothing remains.

    An existing file keeps its mode and, if permitted, its owner; a symbolic link is kept and its target replaced. ``check`` is that of
    `write_atomic`.

    Raises:
        InputError: it cannot be written.
    """
    target = _target(path)
    try:
        temporary = _new_temporary(target.parent)
        try:
            with temporary.open("wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if check is not None:
                _check_written(temporary, path, check)
            _replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=path, value=error.strerror) from error


def _check_written(temporary: Path, path: Path, check: Callable[[Path], object]) -> None:
    """Read a file before it replaces the path, without registering its temporary name as an input of the command."""
    token = _COMMAND.set(None)
    try:
        check(temporary)
    except InputError as error:
        raise InputError(
            f"not written, because it would not be read back: {error.what}",
            expected=error.expected,
            file=path,
            value=error.value,
        ) from error
    finally:
        _COMMAND.reset(token)


def move_into_place(made: Path, path: Path) -> None:
    """Replace an output with a complete file on the same file system.

    Raises:
        InputError: the output cannot be written.
        OSError: the operating system refuses.
    """
    _replace(made, _target(path))


def _replace(made: Path, target: Path) -> None:
    tracker = _COMMAND.get()
    if tracker is not None:
        tracker.locks.acquire({*tracker.outputs, target})
    if target.exists():
        old = target.stat()
        with suppress(PermissionError):
            os.chown(made, old.st_uid, old.st_gid)
        os.chmod(made, stat.S_IMODE(old.st_mode))
    os.replace(made, target)
    if tracker is not None:
        tracker.written.add(target)


@contextmanager
def scratch_folder(parent: Path | None = None) -> Iterator[Path]:
    """Make a folder for temporary files, in TMPDIR unless a parent is given, and remove it afterwards.

    Folders left by a killed run are removed by the next run that makes a folder or writes a file in the same place.

    Raises:
        OSError: it cannot be made.
    """
    place = Path(tempfile.gettempdir()) if parent is None else parent
    _remove_leftovers(place)
    folder = place / _temporary_name()
    os.mkdir(folder, 0o700)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _new_temporary(folder: Path) -> Path:
    """Create an empty temporary file with the mode of a new file and return its path."""
    path = folder / _temporary_name()
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return path


def _temporary_name() -> str:
    return f"{TEMPORARY_PREFIX}{os.getpid()}-{secrets.token_hex(6)}-{platform.node()}"


def _remove_leftovers(folder: Path) -> None:
    """Remove this user's temporary files and folders whose process, on this computer, no longer runs."""
    try:
        candidates = [Path(entry.path) for entry in os.scandir(folder) if entry.name.startswith(TEMPORARY_PREFIX)]
    except OSError:
        return
    for path in candidates:
        pid, _, rest = path.name.removeprefix(TEMPORARY_PREFIX).partition("-")
        with suppress(OSError):
            ours = path.lstat().st_uid == os.geteuid() and rest.partition("-")[2] == platform.node()
            if not (ours and pid.isdecimal()) or _is_running(int(pid)):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
