"""Independent tasks on many processes: on this computer, or on a Dask cluster given by the address of its scheduler.

Manual: `twin doc many`.

Independent tasks: in this process, on processes of this computer, or on a Dask cluster (joblib).

A task is a pure function of its arguments, including its seed, and runs with one thread of linear algebra. Its result therefore does
not depend on the number of workers nor on the worker that runs it, and a task whose worker died can be repeated. joblib is imported
only where it is needed.

Tasks on processes of this computer: copies of this process where that is safe, which need no time to start, else new ones.

A copy (fork) has everything that this process has loaded and prepared. It is safe if no other thread could hold a lock, which would
never be released in the copy; those of OpenBLAS are ended before. New processes are loky's, which run neither the script that started
them nor the cells of a notebook again.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import pickle
import platform
import signal
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import metadata
from importlib.util import find_spec
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, TypeVar, final

from twin._common.errors import InputError, OutputError
from twin._common.resources import one_blas_thread
from twin.compute.native import compiler, only_idle_threads

SUSPECT_DEATHS: Final = 2
"""Number of worker deaths after which the tasks in flight at each of them are run one at a time, to find the cause."""
MAX_DEATHS: Final = 4
"""Number of worker deaths during a task after which it is given up."""

_given: list[Any] = []
"""In a worker: the function and the shared value."""


def on_processes(
    function: Callable[[Any, Any], Any],
    shared: Any,
    tasks: Sequence[Any],
    processes: int,
    name: Callable[[int], str],
    most: int,
) -> Generator[tuple[int, Any], None, None]:
    """Run tasks and yield the index and the result of each in order of completion; the workers end with the generator.

    Args:
        function: function of the shared value and of one task.
        shared: value common to all tasks.
        tasks: the tasks; one whose worker dies is repeated.
        processes: number of workers.
        name: function that returns the name of a task by its index, for messages.
        most: largest number of tasks in flight.
    """
    left = dict.fromkeys(range(len(tasks)))
    deaths: Counter[int] = Counter()
    while left:
        suspect = next((index for index in left if deaths[index] >= SUSPECT_DEATHS), None)
        some = list(left) if suspect is None else [suspect]
        lost: list[int] = []
        with _pool(min(processes, len(some)), function, shared) as pool:
            for index, future in _completed(pool, tasks, some, most):
                try:
                    result = future.result()
                except BrokenProcessPool:
                    lost.append(index)
                    continue
                del left[index]
                yield index, result
        deaths.update(lost)
        if suspect is not None and deaths[suspect] >= MAX_DEATHS:
            del left[suspect]
            yield (
                suspect,
                InputError(
                    f"a worker process died {MAX_DEATHS} times while running this task",
                    expected="enough memory for the task, or fewer workers",
                    value=name(suspect),
                ),
            )


def _completed(
    pool: Executor, tasks: Sequence[Any], some: Sequence[int], most: int
) -> Iterator[tuple[int, Future[Any]]]:
    """Yield the ended tasks, of which at most ``most`` are in flight; none are sent after a worker has died."""
    import cloudpickle

    waiting = iter(some)
    running: dict[Future[Any], int] = {}
    while True:
        with suppress(BrokenProcessPool), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # Python's, of OpenBLAS's threads at a fork
            for index in islice(waiting, most - len(running)):
                running[pool.submit(_run, cloudpickle.dumps(tasks[index]))] = index
        if not running:
            return
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            yield running.pop(future), future


@contextmanager
def _pool(processes: int, function: Callable[[Any, Any], Any], shared: Any) -> Iterator[Executor]:
    """Yield workers that have the function and the shared value; they are ended at once if the context is left by an exception."""
    pool: Any
    if sys.platform == "linux" and only_idle_threads():
        pool = ProcessPoolExecutor(processes, get_context("fork"), _begin, (os.getpid(), (function, shared)))
    else:
        import cloudpickle
        from joblib.externals.loky import ProcessPoolExecutor as NewProcesses

        packed = cloudpickle.dumps((function, shared))
        pool = NewProcesses(processes, initializer=_begin_packed, initargs=(os.getpid(), packed))
    complete = False
    try:
        yield pool
        complete = True
    finally:
        for process in [] if complete else list((pool._processes or {}).values()):  # `terminate_workers` of Python 3.14
            process.terminate()
        pool.shutdown(wait=True)


def _begin_packed(parent: int, packed: bytes) -> None:
    _begin(parent, pickle.loads(packed))


def _begin(parent: int, given: tuple[Callable[[Any, Any], Any], Any]) -> None:
    """Prepare a worker: it ignores Ctrl-C, which its parent handles, and ends when its parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("SIGTERM", "SIGHUP"):  # of which Windows has one
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
    threading.Thread(target=_exit_with, args=(parent,), daemon=True).start()
    one_blas_thread(scipy=False)
    _given[:] = given


def _exit_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _run(packed: bytes) -> Any:
    """Return the result of a task; an `InputError` or `OutputError` is a result, too."""
    function, shared = _given
    try:
        return function(shared, pickle.loads(packed))
    except (InputError, OutputError) as error:
        return error


# --- Memory that a worker of a cluster keeps between arrays ---------------------------------------

NANNY_LIMIT: Final = "65536"
"""The limit that Dask's nanny sets (``distributed.nanny.pre-spawn-environ``), bytes."""
LARGEST_PIECE: Final = 32 << 20
"""Largest limit that glibc sets itself for a single piece of memory; that of all free memory is twice this (mallopt(3))."""
M_TRIM_THRESHOLD: Final = -1
M_MMAP_THRESHOLD: Final = -3


@cache
def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next array, as it does by default.

    With the limit of Dask's nanny, the memory of every larger array goes back to the system when it is freed, and that of the next one
    is cleared again: half of the processor time of a worker that compensates programs. A limit that the user has chosen is left.
    """
    if sys.platform != "linux" or os.environ.get("MALLOC_TRIM_THRESHOLD_") != NANNY_LIMIT:
        return
    adjust = getattr(ctypes.CDLL(None), "mallopt", None)
    if adjust is not None:  # else not the GNU C library, to which the limit means nothing
        adjust(M_MMAP_THRESHOLD, LARGEST_PIECE)
        adjust(M_TRIM_THRESHOLD, 2 * LARGEST_PIECE)


# --- Versions and hardware that affect the digits of a result: software here and on every worker, processor and compiler

PACKAGES: Final = ("numpy", "scipy", "casadi", "pin")
SOURCES: Final = (".py", ".cpp", ".hpp", ".j2")


@cache
def versions() -> dict[str, str]:
    """Return the versions by name: Python, `twin` with the digest of its source, and the numerical packages.

    The version alone would not distinguish two checkouts.
    """
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(path for path in package.rglob("*") if path.suffix in SOURCES):
        digest.update(f"{path.relative_to(package).as_posix()}\0".encode() + path.read_bytes())
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "twin": f"{metadata.version('twin')} ({digest.hexdigest()[:12]})",
        **{name: metadata.version(name) for name in PACKAGES},
    }


@cache
def arithmetic() -> str:
    """Return a digest of the processor, and of the compiler if compiled code may be used; where it differs, last digits may differ."""
    tool = compiler.find_compiler() if compiler.enabled() else None
    identity = f"{compiler.processor()}\0{'' if tool is None else tool.identity}"
    return hashlib.sha256(identity.encode()).hexdigest()


def version_differences(here: dict[str, str], there: dict[str, str]) -> str:
    """Return a description of the differences between two sets of versions; empty if there are none."""
    return ", ".join(
        f"{name} {there.get(name, 'none')} instead of {mine}" for name, mine in here.items() if there.get(name) != mine
    )


# --- TLS files for the connection to a cluster ----------------------------------------------------


@final
@dataclass(frozen=True)
class Tls:
    """PEM files with which a Dask scheduler and this computer authenticate each other; the connection is encrypted.

    Attributes:
        ca_file: the certificate authority that signed the scheduler's certificate.
        certificate: of this computer, signed by an authority that the scheduler accepts.
        key: of that certificate; None if the certificate file contains it.
    """

    ca_file: Path
    certificate: Path
    key: Path | None = None


# --- Independent tasks: in this process, on processes of this computer, or on a Dask cluster (joblib)

Shared = TypeVar("Shared")
Task = TypeVar("Task")
Result = TypeVar("Result")
Refusal = InputError | OutputError

TASKS_PER_WORKER: Final = 2
"""Tasks in flight per worker: one running and one waiting, which bounds memory without idle workers."""

_task_lock = threading.Lock()


@final
@dataclass(frozen=True)
class Workers:
    """Choice of where tasks run: on processes of this computer or on a Dask cluster.

    Attributes:
        processes: number of processes on this computer; 1: this process itself; None: one per core. Ignored with a scheduler.
        scheduler: address of a Dask scheduler, ``tcp://host:8786``, or None. Its workers should have one thread each. Scheduler and
            workers can run any code on each other and on this computer: use only those that you trust like your own code.
        tls: certificates for a scheduler at ``tls://host:8786``; None for Dask's own configuration (``distributed.comm.tls``).

    Raises:
        InputError: fewer than one process; a scheduler without Dask installed; TLS files without a ``tls://`` scheduler.

    Examples:
        >>> here = twin.Workers(processes=2)
        >>> cluster = twin.Workers(scheduler="tcp://host:8786")  # connects when it is used
    """

    processes: int | None = None
    scheduler: str | None = None
    tls: Tls | None = None

    def __post_init__(self) -> None:
        if self.processes is not None and self.processes < 1:
            raise InputError("number of workers too small", expected="at least 1", value=self.processes)
        if self.tls is not None and not (self.scheduler or "").startswith("tls://"):
            raise InputError(
                "TLS files for a scheduler that does not use TLS",
                expected="a scheduler at tls://host:8786",
                value=self.scheduler,
            )
        if self.scheduler is not None and find_spec("distributed") is None:
            raise InputError("a scheduler needs Dask, which is not installed", expected="pip install 'twin[cluster]'")


def map_as_completed(
    function: Callable[[Shared, Task], Result],
    shared: Shared,
    tasks: Sequence[Task],
    workers: Workers | None = None,
    *,
    name: Callable[[Task], str] = str,
    return_errors: bool = False,
) -> Generator[tuple[int, Result | Refusal], None, None]:
    """Run tasks and yield their results in order of completion, each with the index of its task.

    Args:
        function: importable function of the shared value and of one task. What it caches in the shared value (a
            ``cached_property``) is kept for the worker's next task.
        shared: value common to all tasks, sent to a worker as a pickle, without its caches.
        tasks: the arguments of the tasks; each is read when it is sent, and again if its worker dies.
        workers: None for one process per core.
        name: function that returns the name of a task, for messages.
        return_errors: whether to yield the error of a task as its result and go on with the others, instead of raising it.

    Raises:
        InputError: raised by a task; workers died repeatedly during one task; there is no usable cluster at the address.
    """
    own = Workers() if workers is None else workers
    processes = min(_cores() if own.processes is None else own.processes, len(tasks))

    def task_name(index: int) -> str:
        return name(tasks[index])

    if own.scheduler is not None:
        found = _on_cluster(function, shared, tasks, own.scheduler, own.tls, task_name)
    elif processes <= 1:
        found = _in_this_process(function, shared, tasks)
    else:
        found = on_processes(function, shared, tasks, processes, task_name, TASKS_PER_WORKER * processes)
    with closing(found):
        for index, result in found:
            if isinstance(result, InputError | OutputError) and not return_errors:
                raise result
            yield index, result


def map_in_order(
    function: Callable[[Shared, Task], Result],
    shared: Shared,
    tasks: Sequence[Task],
    workers: Workers | None = None,
    *,
    name: Callable[[Task], str] = str,
) -> Iterator[Result]:
    """Run tasks as `map_as_completed` and yield their results in the order of the tasks.

    Sums over the results are then reproducible to the last bit.
    """
    early: dict[int, Result] = {}
    following = 0
    with closing(map_as_completed(function, shared, tasks, workers, name=name)) as found:
        for index, result in found:
            early[index] = result  # type: ignore[assignment]  # no refusal: those were raised
            while following in early:
                yield early.pop(following)
                following += 1


def _in_this_process(
    function: Callable[[Shared, Task], Result], shared: Shared, tasks: Sequence[Task]
) -> Generator[tuple[int, Result], None, None]:
    for index, task in enumerate(tasks):
        with one_blas_thread(scipy=False):
            result = function(shared, task)
        yield index, result


def _cores() -> int:
    """Return the number of cores that this process may use, as joblib counts them."""
    from joblib import cpu_count

    return int(cpu_count())


def _on_cluster(
    function: Callable[[Shared, Task], Result],
    shared: Shared,
    tasks: Sequence[Task],
    address: str,
    tls: Tls | None,
    name: Callable[[int], str],
) -> Generator[tuple[int, Any], None, None]:
    import cloudpickle
    from joblib import Parallel, delayed

    from twin.compute.cluster import connected  # Dask is optional and slow to import

    common, expected = cloudpickle.dumps((function, shared)), versions()
    with connected(address, tls, name) as (backend, threads):
        pool = Parallel(
            n_jobs=threads,
            backend=backend,
            batch_size=1,
            pre_dispatch=TASKS_PER_WORKER * threads,
            return_as="generator_unordered",
        )
        calls = (delayed(work)(i, common, cloudpickle.dumps(task), expected) for i, task in enumerate(tasks))
        with _closing(pool(calls)) as results:
            for found in results:  # noqa: UP028  # `yield from` would close them without `_closing`
                yield found


@contextmanager
def _closing(results: Any) -> Iterator[Any]:
    """Close the results on leaving the context, which ends the tasks, also on Ctrl-C and after a partial read."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # not all results were read
            results.close()


def work(index: int, common: bytes, packed: bytes, expected: dict[str, str]) -> tuple[int, Any]:
    """Run one task on a worker of a cluster and return its index with its result; an `InputError` or `OutputError` is a result, too.

    Args:
        index: of the task.
        common: the function and the shared value, pickled, so that Dask's scheduler need not be able to load them.
        packed: the task, pickled.
        expected: the versions on the calling computer.
    """
    # A Dask worker may have several threads, but only one at a time may use the shared value.
    with _task_lock:
        different = version_differences(expected, versions())
        if different:
            return index, InputError(
                f"a worker has other versions: {different}",
                expected="the same versions on all computers",
                value=_host(),
            )
        one_blas_thread(scipy=False)
        keep_freed_memory()
        try:
            function, shared = _unpacked(common)
            task = pickle.loads(packed)
        except ModuleNotFoundError as error:
            return index, InputError(
                "a worker cannot import a module of the task", expected=f"module {error.name} there", value=_host()
            )
        try:
            return index, function(shared, task)
        except (InputError, OutputError) as error:
            return index, error


@lru_cache(maxsize=2)
def _unpacked(common: bytes) -> Any:
    return pickle.loads(common)


def _host() -> str:
    return f"{os.uname().nodename}, process {os.getpid()}" if hasattr(os, "uname") else f"process {os.getpid()}"
