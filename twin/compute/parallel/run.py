"""Independent tasks run through joblib: in this process, on processes of this computer (loky), or on a Dask cluster.

A task is a pure function of its arguments, including its seed, and runs with one thread of linear algebra. Its result therefore does
not depend on the number of workers nor on the worker that runs it, and a task whose worker died can be repeated. joblib is imported
with the first tasks: a command for one program has none.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, Final, TypeVar, final

from threadpoolctl import threadpool_limits

from twin._common.errors import InputError, OutputError
from twin.compute.parallel.tls import Tls
from twin.compute.parallel.versions import version_differences, versions

Shared = TypeVar("Shared")
Task = TypeVar("Task")
Result = TypeVar("Result")
Refusal = InputError | OutputError

TASKS_PER_WORKER: Final = 2
"""Tasks in flight per worker: one running and one waiting, which bounds memory without idle workers."""
SUSPECT_DEATHS: Final = 2
"""Number of worker deaths after which the tasks in flight at each of them are run one at a time, to find the cause."""
MAX_DEATHS: Final = 4
"""Number of worker deaths during a task after which it is given up."""

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
    import cloudpickle
    from joblib import cpu_count

    own = Workers() if workers is None else workers
    processes = min(cpu_count() if own.processes is None else own.processes, len(tasks))
    if own.scheduler is None and processes <= 1:
        found = _in_this_process(function, shared, tasks)
    else:
        common = cloudpickle.dumps((function, shared))

        def task_name(index: int) -> str:
            return name(tasks[index])

        found = (
            _on_processes(common, tasks, processes, task_name)
            if own.scheduler is None
            else _on_cluster(common, tasks, own.scheduler, own.tls, task_name)
        )
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
        with threadpool_limits(limits=1, user_api="blas"):
            result = function(shared, task)
        yield index, result


def _on_processes(
    common: bytes, tasks: Sequence[Any], processes: int, name: Callable[[int], str]
) -> Generator[tuple[int, Any], None, None]:
    from concurrent.futures.process import BrokenProcessPool

    from joblib import Parallel

    left = dict.fromkeys(range(len(tasks)))
    deaths: Counter[int] = Counter()
    while left:
        suspect = next((index for index in left if deaths[index] >= SUSPECT_DEATHS), None)
        out: set[int] = set()
        # At least two, since joblib would run a single job in this process.
        pool = Parallel(
            n_jobs=max(2, processes),
            backend="loky",
            batch_size=1,
            pre_dispatch=TASKS_PER_WORKER * max(2, processes),
            return_as="generator_unordered",
            max_nbytes=None,
            initializer=_prepare_worker,
            initargs=(os.getpid(),),
        )
        some = list(left) if suspect is None else [suspect]
        try:
            with _closing(pool(_calls(common, tasks, some, out, None))) as results:
                for index, result in results:
                    del left[index]
                    yield index, result
        except BrokenProcessPool:
            deaths.update(out & left.keys())
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


def _prepare_worker(parent: int) -> None:
    """Make a worker process ignore Ctrl-C, which its parent handles, and end when its parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with, args=(parent,), daemon=True).start()


def _exit_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _on_cluster(
    common: bytes, tasks: Sequence[Any], address: str, tls: Tls | None, name: Callable[[int], str]
) -> Generator[tuple[int, Any], None, None]:
    from joblib import Parallel

    from twin.compute.parallel.cluster import connected  # Dask is optional and slow to import

    with connected(address, tls, name) as (backend, threads):
        pool = Parallel(
            n_jobs=threads,
            backend=backend,
            batch_size=1,
            pre_dispatch=TASKS_PER_WORKER * threads,
            return_as="generator_unordered",
        )
        with _closing(pool(_calls(common, tasks, range(len(tasks)), set(), versions()))) as results:
            for found in results:  # noqa: UP028  # `yield from` would close them without `_closing`
                yield found


@contextmanager
def _closing(results: Any) -> Iterator[Any]:
    """Close the results on leaving the context, which ends the workers, also on Ctrl-C and after a partial read."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # not all results were read
            results.close()


def _calls(
    common: bytes, tasks: Sequence[Any], some: Sequence[int], out: set[int], expected: dict[str, str] | None
) -> Iterator[Any]:
    import cloudpickle
    from joblib import delayed

    for index in some:
        out.add(index)
        yield delayed(work)(index, common, cloudpickle.dumps(tasks[index]), expected)


def work(index: int, common: bytes, packed: bytes, expected: dict[str, str] | None) -> tuple[int, Any]:
    """Run one task on a worker and return its index with its result; an `InputError` or `OutputError` is a result, too.

    Args:
        index: of the task.
        common: the function and the shared value, pickled, so that Dask's scheduler need not be able to load them.
        packed: the task, pickled.
        expected: the versions on the calling computer; None for a worker on the same computer.
    """
    # A Dask worker may have several threads, but only one at a time may use the shared value.
    with _task_lock:
        different = "" if expected is None else version_differences(expected, versions())
        if different:
            return index, InputError(
                f"a worker has other versions: {different}",
                expected="the same versions on all computers",
                value=_host(),
            )
        threadpool_limits(limits=1, user_api="blas")
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
