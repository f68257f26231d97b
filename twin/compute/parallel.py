"""Independent tasks in this process, on processes of this computer, or on a Dask cluster given by the address of its scheduler.

Manual: `twin doc many`.

A task is a pure function of its arguments, including its seed, and runs with one thread of linear algebra. Its result therefore does
not depend on the number of workers nor on the worker that runs it, and a task whose worker died can be repeated.

Processes and cluster are executors of `concurrent.futures`, so that one loop sends the tasks to either. `joblib.Parallel` is not used:
it does not tell which task was running when a worker died, and it waits forever for a task that Dask has abandoned (joblib 1.6).
"""

from __future__ import annotations

import asyncio
import ctypes
import hashlib
import logging
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
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import metadata
from importlib.util import find_spec
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, final

from twin._common.errors import InputError, OutputError
from twin._common.files import read_bytes
from twin._common.resources import one_blas_thread
from twin.compute.native import compiler
from twin.compute.native.compiler import only_idle_threads

if TYPE_CHECKING:
    from distributed import Client, Security

Shared = TypeVar("Shared")
Task = TypeVar("Task")
Result = TypeVar("Result")
Refusal = InputError | OutputError

TASKS_PER_WORKER: Final = 2
"""Tasks in flight per worker: one running and one waiting, which bounds memory without idle workers."""
MAX_DEATHS: Final = 4
"""Number of worker deaths during a task after which it is given up; Dask's own default."""


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
            what = "TLS files for a scheduler that does not use TLS"
            raise InputError(what, expected="a scheduler at tls://host:8786", value=self.scheduler)
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
    if own.scheduler is not None:
        found = _on_cluster(function, shared, tasks, name, own.scheduler, own.tls)
    elif processes <= 1:
        found = _in_this_process(function, shared, tasks)
    else:
        found = _on_processes(function, shared, tasks, name, processes)
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
    """Run tasks as `map_as_completed` and yield their results in the order of the tasks: sums are then reproducible to the last bit."""
    early: dict[int, Result] = {}
    following = 0
    with closing(map_as_completed(function, shared, tasks, workers, name=name)) as found:
        for index, result in found:
            early[index] = result  # type: ignore[assignment]  # no refusal: those were raised
            while following in early:
                yield early.pop(following)
                following += 1


def _cores() -> int:
    """Return the number of cores that this process may use, as joblib counts them."""
    from joblib import cpu_count

    return int(cpu_count())


def _in_this_process(
    function: Callable[[Any, Any], Any], shared: Any, tasks: Sequence[Any]
) -> Generator[tuple[int, Any], None, None]:
    for index, task in enumerate(tasks):
        with one_blas_thread(scipy=False):
            result = function(shared, task)
        yield index, result


def _completed(
    submit: Callable[[int], Future[Any]], indices: Sequence[int], most: int, check: Callable[[], None] | None = None
) -> Iterator[tuple[int, Future[Any]]]:
    """Submit tasks, at most ``most`` at a time, and yield each that has ended; none are submitted after a worker has died.

    ``check`` is called every `CHECK_S` while no task ends; it may raise to end the wait.
    """
    waiting, running = iter(indices), dict[Future[Any], int]()
    while True:
        with suppress(BrokenExecutor), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # Python's, of OpenBLAS's threads at a fork
            for index in islice(waiting, most - len(running)):
                running[submit(index)] = index
        if not running:
            return
        done, _ = wait(running, None if check is None else CHECK_S, FIRST_COMPLETED)
        for future in done:
            yield running.pop(future), future
        if not done and check is not None:
            check()


# --- On processes of this computer ----------------------------------------------------------------

_given: list[Any] = []
"""In a worker: the function and the shared value."""


def _on_processes(
    function: Callable[[Any, Any], Any], shared: Any, tasks: Sequence[Any], name: Callable[[Any], str], processes: int
) -> Generator[tuple[int, Any], None, None]:
    """Run tasks on new workers; those that were in flight when a worker died are repeated one at a time, to find the cause."""
    left = dict.fromkeys(range(len(tasks)))
    deaths: Counter[int] = Counter()
    while left:
        suspects = [index for index in left if deaths[index]]
        workers, most = (1, 1) if suspects else (min(processes, len(left)), TASKS_PER_WORKER * processes)
        with _pool(workers, function, shared) as pool:
            for index, future in _completed(lambda i: pool.submit(_run, tasks[i]), suspects or list(left), most):
                try:
                    result = future.result()
                except BrokenExecutor:
                    deaths[index] += 1
                    if deaths[index] < MAX_DEATHS:
                        continue
                    what = f"a worker process died {MAX_DEATHS} times while running this task"
                    expected = "enough memory for the task, or fewer workers"
                    result = InputError(what, expected=expected, value=name(tasks[index]))
                del left[index]
                yield index, result


@contextmanager
def _pool(processes: int, function: Callable[[Any, Any], Any], shared: Any) -> Iterator[Executor]:
    """Yield workers that have the function and the shared value; they are ended at once if the context is left by an exception.

    They are copies (fork) of this process if no other thread could hold a lock, which a copy would wait for forever. Copies start at
    once, while each new process spends two seconds on imports. New processes are loky's, which run neither the script that started
    them nor the cells of a notebook again.
    """
    pool: Any
    if sys.platform == "linux" and only_idle_threads():
        pool = ProcessPoolExecutor(processes, get_context("fork"), _begin, (os.getpid(), function, shared))
    else:
        from joblib.externals.loky import ProcessPoolExecutor as NewProcesses

        pool = NewProcesses(processes, initializer=_begin, initargs=(os.getpid(), function, shared))
    complete = False
    try:
        yield pool
        complete = True
    finally:
        for process in [] if complete else list((pool._processes or {}).values()):  # `terminate_workers` of Python 3.14
            process.terminate()
        pool.shutdown(wait=True)


def _begin(parent: int, function: Callable[[Any, Any], Any], shared: Any) -> None:
    """Prepare a worker: it ignores Ctrl-C, which its parent handles, and ends when its parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("SIGTERM", "SIGHUP"):  # of which Windows has one
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
    threading.Thread(target=_exit_with, args=(parent,), daemon=True).start()
    one_blas_thread(scipy=False)
    _given[:] = function, shared


def _exit_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _run(task: Any) -> Any:
    """Return the result of a task; an `InputError` or `OutputError` is a result, too."""
    function, shared = _given
    try:
        return function(shared, task)
    except (InputError, OutputError) as error:
        return error


# --- On a Dask cluster; Dask is optional, and imported only here ----------------------------------

CHECK_S: Final = 5.0
"""Time between checks whether the cluster still has workers."""
CONNECT_TIMEOUT_S: Final = 5.0
"""Timeout of the connection to the scheduler."""
FIRST_WORKER_TIMEOUT_S: Final = 20.0
"""Timeout for the first worker."""
NO_WORKER_TIMEOUT_S: Final = 60.0
"""Timeout without any worker during the work; a restarted worker takes a few seconds."""

_task_lock = threading.Lock()


def _on_cluster(
    function: Callable[[Any, Any], Any],
    shared: Any,
    tasks: Sequence[Any],
    name: Callable[[Any], str],
    address: str,
    tls: Tls | None,
) -> Generator[tuple[int, Any], None, None]:
    import cloudpickle
    from distributed.scheduler import KilledWorker

    # Pickled here, so that the scheduler need not be able to load them.
    common, expected = cloudpickle.dumps((function, shared)), versions()
    with _dask_logs_off(), _client(address, tls) as client:
        _check_versions(client, address)
        pool = client.get_executor(pure=False)

        def submit(index: int) -> Future[Any]:
            future: Future[Any] = pool.submit(_run_there, common, cloudpickle.dumps(tasks[index]), expected)
            return future

        seen = time.monotonic()

        def check_workers() -> None:
            nonlocal seen
            try:
                seen = time.monotonic() if client.nthreads() else seen
            except (OSError, RuntimeError):  # lost, or closed
                seen = -NO_WORKER_TIMEOUT_S
            if time.monotonic() - seen >= NO_WORKER_TIMEOUT_S:
                kept = "workers that run until the end"
                raise InputError("no worker of the cluster remains", expected=kept, value=address)

        try:
            most = TASKS_PER_WORKER * max(sum(client.nthreads().values()), 1)
            for index, future in _completed(submit, range(len(tasks)), most, check_workers):
                seen = time.monotonic()
                try:
                    result = future.result()
                except KilledWorker as error:
                    what = f"{error.allowed_failures + 1} workers of the cluster died while running this task"
                    result = InputError(what, expected="enough memory for the task", value=name(tasks[index]))
                except CancelledError as error:
                    kept = "a scheduler that runs until the end"
                    raise InputError("the connection to the scheduler was lost", expected=kept) from error
                except ModuleNotFoundError as error:
                    module = f"module {error.name} there"
                    result = InputError("a worker cannot import a module of the task", expected=module)
                yield index, result
        finally:
            pool.shutdown(wait=False)


def _run_there(common: bytes, packed: bytes, expected: dict[str, str]) -> Any:
    """Run a pickled task, with the pickled function and shared value, on a worker of a cluster as `_run`.

    ``expected``: the versions on the calling computer; a worker that joined later has not been checked.
    """
    # A Dask worker may have several threads, but only one at a time may use the shared value.
    with _task_lock:
        different = version_differences(expected, versions())
        if different:
            return _other_versions(different, f"{platform.node()}, process {os.getpid()}")
        one_blas_thread(scipy=False)
        keep_freed_memory()
        _given[:] = _unpacked(common)
        return _run(pickle.loads(packed))


@lru_cache(maxsize=2)
def _unpacked(common: bytes) -> Any:
    return pickle.loads(common)


@contextmanager
def _dask_logs_off() -> Iterator[None]:
    """Suppress Dask's own messages on lost connections and dead workers, which are handled here."""
    logs = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


@contextmanager
def _client(address: str, tls: Tls | None) -> Iterator[Client]:
    """Connect to a scheduler; raise `InputError` if there is none at the address, or address and TLS files do not match."""
    from distributed import Client

    security, secure = _security(tls), address.startswith("tls://")
    try:
        # Check first: a client waits forever for a server that does not answer. In another thread: a notebook has an event loop here.
        with ThreadPoolExecutor(1) as pool:
            pool.submit(asyncio.run, _probe(address, security)).result()
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False, name="twin", security=security)
    except (OSError, ValueError, MemoryError) as error:  # another protocol may look like a message of exabytes
        raise InputError(
            "no Dask scheduler at this address",
            expected="the address of a scheduler, as `dask scheduler` prints it (tcp://host:8786)"
            + (", and certificates of one authority on both sides" if secure else ""),
            value=address,
        ) from error
    except (
        RuntimeError,
        TypeError,
    ) as error:  # encryption required by Dask's configuration, but not in the address; or TLS without certificates
        what = "the scheduler's address and the TLS settings do not match"
        expected = "certificates for a scheduler at tls://host:8786, none for one at tcp://host:8786"
        raise InputError(what, expected=expected, value=address) from error
    try:
        yield client
    finally:
        client.close(CONNECT_TIMEOUT_S)


def _security(tls: Tls | None) -> Security:
    """Return Dask's security settings for the files; raise `InputError` if one is missing or is not a certificate or key."""
    from distributed.security import Security

    files = {} if tls is None else {"tls_ca_file": tls.ca_file, "tls_client_cert": tls.certificate}
    if tls is not None and tls.key is not None:
        files["tls_client_key"] = tls.key
    for file in files.values():
        read_bytes(file)
    try:
        security = Security(require_encryption=True if files else None, **{k: str(v) for k, v in files.items()})
        security.get_connection_args("client")
    except (OSError, TypeError, ValueError) as error:
        what, expected = "unusable TLS files", "PEM files of an authority, a certificate and its key"
        raise InputError(what, expected=expected, file=None if tls is None else tls.certificate, value=error) from error
    return security


async def _probe(address: str, security: Security) -> None:
    from distributed.comm import connect

    # The timeout of connect does not apply if the other side accepts the connection and sends nothing.
    greeting = connect(address, timeout=CONNECT_TIMEOUT_S, **security.get_connection_args("client"))
    comm = await asyncio.wait_for(greeting, CONNECT_TIMEOUT_S + 1.0)
    comm.abort()


def _check_versions(client: Client, address: str) -> None:
    """Raise `InputError` unless scheduler and workers can do the work with the versions of this computer."""
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_TIMEOUT_S)
    except TimeoutError as error:
        kept = f"workers started with `dask worker {address}`"
        raise InputError("scheduler without workers", expected=kept, value=address) from error
    there = f"twin {versions()['twin']} there"
    try:
        client.run_on_scheduler(metadata.version, "twin")
    except metadata.PackageNotFoundError as error:
        raise InputError("twin is not installed on the scheduler's computer", expected=there) from error
    # A function of the standard library first, since a worker without twin cannot load functions of twin.
    installed = client.run(metadata.version, "twin", on_error="return")
    for worker, version in installed.items():
        if isinstance(version, BaseException):
            raise InputError("twin is not installed on a worker", expected=there, value=worker)
    for worker, found in client.run(versions, on_error="return").items():
        failed = isinstance(found, BaseException)
        different = f"twin {installed.get(worker)}" if failed else version_differences(versions(), found)
        if different:
            raise _other_versions(different, worker)
    other = [worker for worker, digest in client.run(arithmetic, on_error="return").items() if digest != arithmetic()]
    if other:
        logging.getLogger("twin").warning(
            "%d workers have another processor or compiler than this computer; the last digits of results may differ",
            len(other),
        )


def _other_versions(different: str, where: str) -> InputError:
    return InputError(
        f"a worker has other versions: {different}", expected="the same versions on all computers", value=where
    )


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
