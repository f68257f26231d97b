"""Independent tasks: in this process, on processes of this computer, or on a Dask cluster (joblib).

A task is a pure function of its arguments, including its seed, and runs with one thread of linear algebra. Its result therefore does
not depend on the number of workers nor on the worker that runs it, and a task whose worker died can be repeated. joblib is imported
only where it is needed.
"""

from __future__ import annotations

import os
import pickle
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, Final, TypeVar, final

from twin._common.errors import InputError, OutputError
from twin._common.threads import one_blas_thread
from twin.compute.parallel.memory import keep_freed_memory
from twin.compute.parallel.tls import Tls
from twin.compute.parallel.versions import version_differences, versions

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
        from twin.compute.parallel.processes import on_processes  # slow to import, and rarely needed

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

    from twin.compute.parallel.cluster import connected  # Dask is optional and slow to import

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
