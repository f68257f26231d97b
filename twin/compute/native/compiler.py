"""Compiled code: the C++ compiler, the source made for a machine, libraries built once and kept."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import stat
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import Final, TypeVar, final

import casadi as ca
import numpy as np

from twin._common.files import scratch_folder
from twin.compute.native.tape import LOGICAL, OPERATIONS, Tape

CANDIDATES: Final = ("c++", "g++", "clang++")
FLAGS: Final = (
    "-std=c++17",
    "-O2",
    "-march=native",
    "-ffp-contract=fast",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-shared",
    "-fPIC",
)
"""Compiler flags. Not ``-ffast-math``: at most 6 % faster, and it would remove comparisons with not-a-number."""
GUARD_PROGRAM: Final = """
import os, signal, subprocess, sys, threading

def end_with_parent():
    os.read(int(sys.argv[1]), 1)  # returns when no process holds the other end
    os.killpg(0, signal.SIGKILL)

threading.Thread(target=end_with_parent, daemon=True).start()
sys.exit(subprocess.call(sys.argv[2:]))
"""
"""Program that runs the compiler in its own process group and kills the group when the parent process has ended."""
COMPILE_TIMEOUT_S: Final = 120.0
"""Timeout of the compiler, which takes one or two seconds."""


class CompilerError(Exception):
    """Compilation failed; the message is the compiler's."""


@final
@dataclass(frozen=True)
class Compiler:
    """A C++ compiler: its command line, and the first line of its version output."""

    command: tuple[str, ...]
    version: str

    @property
    def identity(self) -> str:
        """Text of all that affects the compiled code, except the source."""
        return "\n".join([*self.command, self.version, *FLAGS, processor()])

    def build(self, source: str, target: Path) -> None:
        """Compile C++ into a shared library; raise `CompilerError` if that fails or takes too long."""
        text = target.with_suffix(".cpp")
        try:
            text.write_text(source, encoding="utf-8")
            status, printed = _run([*self.command, *FLAGS, "-x", "c++", "-", "-o", str(target)], text)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CompilerError(str(error)) from error
        if status != 0 or not target.is_file():
            message = next((line for line in printed.splitlines() if "error" in line.lower()), printed.strip())
            raise CompilerError(f"{' '.join(self.command)}: {message or f'status {status}'}"[:300])


def _run(command: Sequence[str], source: Path) -> tuple[int, str]:
    """Run the compiler and return its status and its output on stderr; it cannot outlive this process.

    It reads the source from its standard input; its temporary files go into the folder of the source and are removed with it.
    """
    read_end, write_end = os.pipe()
    with open(read_end, "rb"), open(write_end, "wb") as alive, source.open("rb") as stream:
        guard = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", GUARD_PROGRAM, str(read_end), *command],
            stdin=stream,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            pass_fds=(read_end,),
            start_new_session=True,
            env={**os.environ, "TMPDIR": str(source.parent)},
            text=True,
            errors="replace",
        )
        with guard, alive:  # closing `alive` first ends a compiler that still runs
            printed = guard.communicate(timeout=COMPILE_TIMEOUT_S)[1]
    return guard.returncode, printed


def find_compiler() -> Compiler | None:
    """Return the compiler that ``CXX`` names, else the first of `CANDIDATES`; None if there is none."""
    return _found(os.environ.get("CXX", ""), os.environ.get("PATH", ""))


@cache
def _found(named: str, path: str) -> Compiler | None:
    try:
        own = tuple(shlex.split(named))
    except ValueError:  # an unmatched quotation mark
        return None
    for words in [own] if own else [(name,) for name in CANDIDATES]:
        program = shutil.which(words[0], path=path)
        if program is None:
            continue
        command = (program, *words[1:])
        try:
            answer = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=10.0, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        return Compiler(command, answer.stdout.split("\n", 1)[0].strip())
    return None


@cache
def processor() -> str:
    """Return a description of the processor that ``-march=native`` compiles for."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split("\n\n", 1)[0].splitlines()
    except OSError:
        lines = []
    wanted = ("vendor_id", "cpu family", "model", "model name", "stepping", "flags", "Features", "CPU part")
    known = [line for line in lines if line.split(":")[0].strip() in wanted]
    return "\n".join([platform.system(), platform.machine(), platform.processor(), *known])


# --- Generation of C++ code from a tape, on SIMD registers: several poses per instruction, without branches and calls
# It uses the vector extensions of GCC and Clang, not `std::experimental::simd`: both compilers have them. Sine and cosine are our own,
# so that nothing needs ``-ffast-math`` and not-a-number and comparisons keep their meaning.

LARGEST_ANGLE: Final = 1e5
"""Largest angle in radians that the C++ reduces without loss, 16,000 turns of a table; poses beyond it are left to NumPy."""
ROUNDING: Final = 1e-10
"""Tolerance of that comparison, relative to the value or to one; rounding errors of either are a thousandth of it."""


def unused(name: str) -> str:
    """Return a C++ function in the place of a `routine` that is never called."""
    return f"INLINE void {name}(const V *, const double *, V *) {{}}\n"


def routine(name: str, tape: Tape) -> str:
    """Return the C++ function ``name(x, k, y)`` of inputs, constants and results."""
    first = tape.inputs + len(tape.constants)
    lines = [f"INLINE void {name}(const V *x, const double *k, V *y) {{"]
    turns: dict[int, str] = {}

    def text(value: int, *, needs_vector: bool = False) -> str:
        if value < tape.inputs:
            return f"x[{value}]"
        if value < first:
            number = f"k[{value - tape.inputs}]"
            return f"all({number})" if needs_vector else number
        return f"v{value - first}"

    for i, (kind, a, b) in enumerate(tape.nodes):
        if kind in ("sin", "cos"):
            if a not in turns:
                turns[a] = f"t{i}"
                lines.append(f"  const Turn t{i} = sincos({text(a, needs_vector=True)});")
            lines.append(f"  const V v{i} = {turns[a]}.{kind[0]};")
            continue
        operation = OPERATIONS[kind]
        needs_vector = operation.needs_vector or all(tape.inputs <= v < first for v in (a, b))
        body = operation.cpp.format(
            text(a, needs_vector=needs_vector), text(b, needs_vector=needs_vector) if b >= 0 else ""
        )
        lines.append(f"  const {'M' if kind in LOGICAL else 'V'} v{i} = {body};")
    lines += [f"  y[{i}] = {text(value, needs_vector=True)};" for i, value in enumerate(tape.results)]
    return "\n".join([*lines, "}", ""])


# --- Cache of compiled libraries in the user's cache directory ------------------------------------
# Loading a library runs its code, so a library is loaded only if this user wrote it and it is complete: folder and file belong to the
# user and are not writable by others, and the file has the digest recorded beside it. Otherwise it is built again, without such a
# folder (a home directory that is read-only or belongs to another user) in a temporary one.

try:
    import fcntl
except ImportError:  # no such locks on Windows: two processes then both build the library
    fcntl = None  # type: ignore[assignment]


def folder() -> Path:
    """Return ``$XDG_CACHE_HOME/twin`` or ``~/.cache/twin``, whether or not it exists."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification says that relative paths are ignored.
    return (Path(named) if os.path.isabs(named) else Path(os.path.expanduser("~")) / ".cache") / "twin"


def key(source: str, compiler: Compiler) -> str:
    """Return the cache key of a library: a digest of source, compiler and processor."""
    return hashlib.sha256(f"{compiler.identity}\0{source}".encode()).hexdigest()[:40]


def cached_library(name: str) -> ctypes.CDLL | None:
    """Return the cached library of that key, if it exists and is trusted."""
    place = folder()
    return _loaded_from_store(place / f"{name}.so") if _private(place) else None


def stored_library(source: str, compiler: Compiler) -> ctypes.CDLL:
    """Return the compiled library of a source from the cache; build and cache it if necessary.

    It raises `CompilerError` if it cannot be compiled, `OSError` if it can be stored nowhere or not be loaded.
    """
    place, name = folder(), key(source, compiler)
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        usable = _private(place) and os.access(place, os.W_OK | os.X_OK)
    except OSError:
        usable = False
    if not usable:
        found = cached_library(name)
        return found if found is not None else _build_temporary(source, compiler)
    target = place / f"{name}.so"
    with _locked(place / f"{name}.lock"):
        found = _loaded_from_store(target)
        if found is None:
            try:
                _build(source, compiler, target)
            except OSError:  # a full disc, or a folder that is not writable after all
                return _build_temporary(source, compiler)
            found = _loaded_from_store(target)
    return found if found is not None else _build_temporary(source, compiler)


def _build(source: str, compiler: Compiler, target: Path) -> None:
    """Build beside the target; the digest is renamed into place last, and until then the library is not loaded."""
    with scratch_folder(target.parent) as scratch:
        made, noted = scratch / "made.so", scratch / "noted"
        compiler.build(source, made)
        os.chmod(made, 0o600)
        noted.write_text(_digest(made), encoding="ascii")
        os.replace(made, target)
        os.replace(noted, _note(target))


def _build_temporary(source: str, compiler: Compiler) -> ctypes.CDLL:
    with scratch_folder() as scratch:
        made = scratch / "made.so"
        compiler.build(source, made)
        return ctypes.CDLL(str(made))


def _loaded_from_store(path: Path) -> ctypes.CDLL | None:
    note = _note(path)
    try:
        if not (_is_private(path, stat.S_ISREG) and _is_private(note, stat.S_ISREG)):
            return None
        if note.read_text(encoding="ascii", errors="replace").strip() != _digest(path):
            return None
        return ctypes.CDLL(str(path))
    except OSError:
        return None


def _note(path: Path) -> Path:
    return path.with_suffix(".sha256")


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _private(place: Path) -> bool:
    try:
        return _is_private(place, stat.S_ISDIR)
    except OSError:
        return False


def _is_private(path: Path, kind: object) -> bool:
    """Return whether a path has the given kind (not a link), belongs to this user and is not writable by others."""
    status = path.lstat()
    mine = not hasattr(os, "geteuid") or (status.st_uid == os.geteuid() and not status.st_mode & 0o022)
    return mine and callable(kind) and bool(kind(status.st_mode))


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock between processes; where files cannot be locked, each process builds its own library."""
    with contextlib.ExitStack() as stack:
        if fcntl is not None:
            with contextlib.suppress(OSError):
                file = stack.enter_context(open(path, "w", encoding="ascii"))
                os.chmod(path, 0o600)
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


# --- Decision whether to compile a C++ source, and the compiled libraries; shared by all modules with C++ code

SWITCH_VARIABLE: Final = "TWIN_NATIVE"
"""Environment variable: 0 switches the compiled code off."""
WORTH_COMPILING: Final = 50_000
"""Number of rows in one call from which compiled code is used, after compiling it if necessary.

NumPy takes a fifth of a second for this number, the compiler one or two seconds, once. Only the rows of the call count, or those of
the work that it is a portion of (`equal_portions`), neither earlier calls nor cached libraries, so that the same work gives the same
digits the first time and later.
"""
PORTION: Final = 32_768
"""Rows per chunk of a thread."""
ROW_THREADS: Final = "rows"
"""First part of the names of these threads."""

Part = TypeVar("Part")

_HERE: Final = Path(__file__).parent
_portions: ContextVar[float] = ContextVar("portions", default=1.0)
_failed: dict[str, str] = {}
"""Sources that are no longer used, with the reason."""
_loaded: dict[str, ctypes.CDLL] = {}


def cpp_text(name: str) -> str:
    """Return the text of a C++ file in this package."""
    return (_HERE / name).read_text(encoding="utf-8")


def enabled() -> bool:
    """Return whether compiled code may be used."""
    return os.environ.get(SWITCH_VARIABLE, "") != "0"


def worth_compiling(rows: int) -> bool:
    """Return whether compiled code may be used and is worth its time for this number of rows in one call (see `equal_portions`)."""
    return rows * _portions.get() >= WORTH_COMPILING and enabled()


@contextmanager
def equal_portions(portions: float) -> Iterator[None]:
    """Mark the calls within as one of a number of equal portions of the same work; holds for the current context.

    Nested, the numbers are multiplied: parts of a program that is one of many.
    """
    token = _portions.set(_portions.get() * portions)
    try:
        yield
    finally:
        _portions.reset(token)


def library(source: str) -> ctypes.CDLL | None:
    """Return the compiled library of a source: loaded before, from the cache, or compiled now; None if that fails."""
    tool = find_compiler()
    if tool is None or source in _failed:
        return None
    name = key(source, tool)
    if name not in _loaded:
        try:
            _loaded[name] = stored_library(source, tool)
        except (CompilerError, OSError) as error:
            disable(source, str(error))
            return None
    return _loaded[name]


def confirmed_library(
    package: str, file: str, jobs: Mapping[str, type[ctypes.Structure]], agrees: Callable[[ctypes.CDLL], bool]
) -> ctypes.CDLL | None:
    """Return the compiled library of a C++ file of a package; None if it cannot be compiled, or its results are wrong.

    Each function takes a pointer to one structure (``jobs``). ``agrees``: whether a library gives the results of Python on a sample.
    """
    source = resources.files(package).joinpath(file).read_text(encoding="utf-8")
    confirmed_library = library(source)
    if confirmed_library is None:
        return None
    for name, job in jobs.items():
        function = getattr(confirmed_library, name)
        function.argtypes, function.restype = (ctypes.POINTER(job),), None
    if not agrees(confirmed_library):
        disable(source, f"{file} does not agree with Python")
        return None
    return confirmed_library


def point_to(job: ctypes.Structure, arrays: Mapping[str, np.ndarray]) -> None:
    """Set the fields of a structure to the addresses of arrays, which must outlive the call that takes it."""
    for name, values in arrays.items():
        setattr(job, name, values.ctypes.data)


def disable(source: str, why: str) -> None:
    """Stop using the compiled code of a source; only the first failure is reported."""
    if not _failed:
        warnings.warn(f"solving without compiled code: {why}", RuntimeWarning, stacklevel=2)
    _failed[source] = why


@cache
def _lanes(tool: Compiler) -> int:
    return int(stored_library(cpp_text("simd.hpp") + '\nextern "C" int lanes() { return W; }\n', tool).lanes())


def map_row_chunks(rows: int, work: Callable[[slice], Part]) -> list[Part]:
    """Apply a function to chunks of rows in threads and return the results; ctypes releases the GIL during the calls."""
    return map_parts([slice(start, min(start + PORTION, rows)) for start in range(0, rows, PORTION)], work)


def map_parts(parts: list[slice], work: Callable[[slice], Part]) -> list[Part]:
    """The same for parts given."""
    if len(parts) <= 1:
        return [work(part) for part in parts]
    return list(_pool(os.getpid()).map(work, parts))


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process, which are started once: starting them for every call takes longer than many a call."""
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix=f"{ROW_THREADS}-{process}")


def only_idle_threads() -> bool:
    """Return whether this process has no other threads than this one and those of `map_parts`, which then wait for work."""
    here = threading.current_thread()
    return all(one is here or one.name.startswith(ROW_THREADS) for one in threading.enumerate())


def solver_description() -> str:
    """Return a description of the solver for large batches; compiles a few lines to find out."""
    if not enabled():
        return f"NumPy ({SWITCH_VARIABLE}=0)"
    tool = find_compiler()
    if tool is None:
        return "NumPy (no C++ compiler found)"
    try:
        lanes = _lanes(tool)
    except (CompilerError, OSError) as error:
        return f"NumPy ({error})"
    return f"compiled from {WORTH_COMPILING:,} poses on: {lanes} per instruction, {tool.version}, cached in {folder()}"


# --- A CasADi function as one C++ routine, compiled together with a file of this package that runs it over many points

LARGEST_TAPE: Final = 5_000
"""Largest number of instructions that is compiled; the compiler takes a third of a millisecond for each."""


@final
class CompiledRoutine:
    """The routine of a function in a library, called ``row`` in the C++ file, with the sizes N inputs and O outputs."""

    def __init__(self, function: ca.Function, file: str) -> None:
        self._function, self._file = function, file
        self._library: ctypes.CDLL | None = None
        self._refused = False

    @cached_property
    def tape(self) -> Tape | None:
        """The instructions; None if one of them is not supported."""
        return Tape.of(self._function)

    @cached_property
    def constants(self) -> np.ndarray:
        """The constants of the instructions."""
        return np.array(self.tape.constants if self.tape is not None else ())

    def library(self, entry: str) -> ctypes.CDLL | None:
        """Return the library, whose function ``entry`` returns an integer; None if it cannot be compiled, or is too long for that."""
        if self._refused or self.tape is None or len(self.tape.nodes) > LARGEST_TAPE:
            return None
        if self._library is None:
            self._library = library(self._source)
            if self._library is not None:
                getattr(self._library, entry).restype = ctypes.c_int64
        return self._library

    def refuse(self) -> None:
        """Stop using the library, whose results are wrong."""
        self._refused = True
        disable(self._source, "its results are wrong")

    @cached_property
    def _source(self) -> str:
        tape = self.tape
        if tape is None:
            return ""
        sizes = f"enum {{ N = {tape.inputs}, O = {tape.outputs} }};"
        return "\n".join([cpp_text("simd.hpp"), sizes, routine("row", tape), cpp_text(self._file)])
