"""Runs a list of independent tasks through joblib: in this process, on processes of this computer (loky), or on a Dask cluster.

A task is a pure function of what is given to it, its seed included, and each runs with one thread of linear algebra: its result does
not depend on how many workers there are, nor on which of them had it. Because of that a task whose worker died is simply run again.
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
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, Final, TypeVar, final

import cloudpickle
from joblib import Parallel, cpu_count, delayed
from threadpoolctl import threadpool_limits

from twin._common.errors import InputError, OutputError
from twin.compute.parallel.tls import Tls
from twin.compute.parallel.versions import apart, versions

Shared = TypeVar("Shared")
Task = TypeVar("Task")
Result = TypeVar("Result")
Refusal = InputError | OutputError

AHEAD: Final = 2
"""Tasks handed out a worker: one at work and one waiting, so that neither workers nor memory wait."""
TOGETHER: Final = 2
"""Deaths of a worker after which those tasks that were out each time are run one at a time: then it is clear whose fault it is."""
DEATHS: Final = 4
"""Deaths of a worker after which a task that was out each time is given up."""

_one_at_a_time = threading.Lock()


@final
@dataclass(frozen=True)
class Workers:
    """Who does the work.

    Attributes:
        processes: of this computer; 1: this process itself; None: one a core. Not looked at where there is a scheduler.
        scheduler: address of a Dask scheduler, ``tcp://host:8786``; None for none. Its workers should have one thread each.
            Scheduler and workers run code of each other and of this computer: name only those you trust like your own code.
        tls: for a scheduler at ``tls://host:8786``; None for Dask's own configuration (``distributed.comm.tls``).

    Raises:
        InputError: fewer than one process; a scheduler, and Dask is not installed; TLS without a scheduler that uses it.
    """

    processes: int | None = None
    scheduler: str | None = None
    tls: Tls | None = None

    def __post_init__(self) -> None:
        if self.processes is not None and self.processes < 1:
            raise InputError("too few workers", expected="at least 1", value=self.processes)
        if self.tls is not None and not (self.scheduler or "").startswith("tls://"):
            raise InputError(
                "TLS files and a scheduler that does not use TLS", expected="tls://host:8786", value=self.scheduler
            )
        if self.scheduler is not None and find_spec("distributed") is None:
            raise InputError("a scheduler was named and Dask is not installed", expected="pip install 'twin[cluster]'")


def finished(
    function: Callable[[Shared, Task], Result],
    shared: Shared,
    tasks: Sequence[Task],
    workers: Workers | None = None,
    *,
    name: Callable[[Task], str] = str,
    refusals: bool = False,
) -> Generator[tuple[int, Result | Refusal], None, None]:
    """Results as they come, each with the index of its task.

    Args:
        function: of what all tasks share, and of one task; an importable one. What it keeps in the former (a ``cached_property``)
            stays there for a worker's next task.
        shared: the same for all tasks; goes to a worker as a pickle, without what it keeps.
        tasks: what sets them apart; each is asked for when it is handed out, and again if its worker dies.
        workers: None for one process a core.
        name: of a task, for messages.
        refusals: give the error of a task for its result, and go on with the others, instead of raising it.

    Raises:
        InputError: raised by a task; a worker died each time it had one; no cluster at that address, or one that is not fit.
    """
    own = Workers() if workers is None else workers
    processes = min(cpu_count() if own.processes is None else own.processes, len(tasks))
    if own.scheduler is None and processes <= 1:
        found = _here(function, shared, tasks)
    else:
        common = cloudpickle.dumps((function, shared))

        def told(index: int) -> str:
            return name(tasks[index])

        found = (
            _on_processes(common, tasks, processes, told)
            if own.scheduler is None
            else _on_cluster(common, tasks, own.scheduler, own.tls, told)
        )
    with closing(found):
        for index, result in found:
            if isinstance(result, InputError | OutputError) and not refusals:
                raise result
            yield index, result


def in_order(
    function: Callable[[Shared, Task], Result],
    shared: Shared,
    tasks: Sequence[Task],
    workers: Workers | None = None,
    *,
    name: Callable[[Task], str] = str,
) -> Iterator[Result]:
    """Results in the order of the tasks: what is added up in it comes out the same to the last bit. Else as `finished`."""
    early: dict[int, Result] = {}
    following = 0
    with closing(finished(function, shared, tasks, workers, name=name)) as found:
        for index, result in found:
            early[index] = result  # type: ignore[assignment]  # no refusal: those were raised
            while following in early:
                yield early.pop(following)
                following += 1


def _here(
    function: Callable[[Shared, Task], Result], shared: Shared, tasks: Sequence[Task]
) -> Generator[tuple[int, Result], None, None]:
    for index, task in enumerate(tasks):
        with threadpool_limits(limits=1, user_api="blas"):
            result = function(shared, task)
        yield index, result


def _on_processes(
    common: bytes, tasks: Sequence[Any], processes: int, name: Callable[[int], str]
) -> Generator[tuple[int, Any], None, None]:
    left = dict.fromkeys(range(len(tasks)))
    deaths: Counter[int] = Counter()
    while left:
        suspect = next((index for index in left if deaths[index] >= TOGETHER), None)
        out: set[int] = set()
        # Never fewer than two, for joblib would take one to be this process.
        pool = Parallel(
            n_jobs=max(2, processes),
            backend="loky",
            batch_size=1,
            pre_dispatch=AHEAD * max(2, processes),
            return_as="generator_unordered",
            max_nbytes=None,
            initializer=_start_worker,
            initargs=(os.getpid(),),
        )
        some = list(left) if suspect is None else [suspect]
        try:
            with _ended(pool(_calls(common, tasks, some, out, None))) as results:
                for index, result in results:
                    del left[index]
                    yield index, result
        except BrokenProcessPool:
            deaths.update(out & left.keys())
            if suspect is not None and deaths[suspect] >= DEATHS:
                del left[suspect]
                yield (
                    suspect,
                    InputError(
                        f"a worker process ended without a word each time it had this task, {DEATHS} times",
                        expected="memory enough for it, or fewer workers",
                        value=name(suspect),
                    ),
                )


def _start_worker(parent: int) -> None:
    """Let a worker process leave Ctrl-C to the process that started it, and end when that one is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _on_cluster(
    common: bytes, tasks: Sequence[Any], address: str, tls: Tls | None, name: Callable[[int], str]
) -> Generator[tuple[int, Any], None, None]:
    from twin.compute.parallel.cluster import connected  # Dask takes its time, and is not always installed

    with connected(address, tls, name) as (backend, threads):
        pool = Parallel(
            n_jobs=threads,
            backend=backend,
            batch_size=1,
            pre_dispatch=AHEAD * threads,
            return_as="generator_unordered",
        )
        with _ended(pool(_calls(common, tasks, range(len(tasks)), set(), versions()))) as results:
            for found in results:  # noqa: UP028  # `yield from` would close them past `_ended`
                yield found


@contextmanager
def _ended(results: Any) -> Iterator[Any]:
    """Results whose workers end with whoever reads them: on Ctrl-C, and where one result is enough."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that not all of them were read
            results.close()


def _calls(
    common: bytes, tasks: Sequence[Any], some: Sequence[int], out: set[int], expected: dict[str, str] | None
) -> Iterator[Any]:
    for index in some:
        out.add(index)
        yield delayed(work)(index, common, cloudpickle.dumps(tasks[index]), expected)


def work(index: int, common: bytes, packed: bytes, expected: dict[str, str] | None) -> tuple[int, Any]:
    """One task, on a worker: its index and result; what it refuses to do is a result too, else the others' would be lost with it.

    Args:
        index: of the task.
        common: the function and what its tasks share, pickled: Dask's scheduler reads what it hands on, and need not know these.
        packed: the task, pickled.
        expected: the versions of whoever asks; None where they are this computer's own.
    """
    # A worker of Dask's may have several threads, and what is shared belongs to one of them at a time.
    with _one_at_a_time:
        different = "" if expected is None else apart(expected, versions())
        if different:
            return index, InputError(
                f"a worker with other versions, which give other digits: {different}",
                expected="the same on all computers",
                value=_host(),
            )
        threadpool_limits(limits=1, user_api="blas")
        try:
            function, shared = _unpacked(common)
            task = pickle.loads(packed)
        except ModuleNotFoundError as error:
            return index, InputError(
                "a worker cannot load what it is to run", expected=f"a module {error.name} there", value=_host()
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
