"""Tasks on processes of this computer: copies of this process where that is safe, which need no time to start, else new ones.

A copy (fork) has everything that this process has loaded and prepared. It is safe if no other thread could hold a lock, which would
never be released in the copy; those of OpenBLAS are ended before. New processes are loky's, which run neither the script that started
them nor the cells of a notebook again.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import get_context
from typing import Any, Final

from twin._common.errors import InputError, OutputError
from twin._common.threads import one_blas_thread
from twin.compute.native import only_idle_threads

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
