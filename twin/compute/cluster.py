"""A Dask cluster as a joblib backend, with checks that joblib's own backend lacks: availability, versions, and loss of workers.

joblib's backend waits forever if Dask abandons a task, if the scheduler ends, or if no worker remains (joblib 1.6).
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import metadata
from typing import Any, Final, final

from distributed import Client
from distributed.comm import connect
from distributed.scheduler import KilledWorker
from distributed.security import Security
from joblib._dask import DaskDistributedBackend

from twin._common.errors import InputError
from twin._common.files import read_bytes
from twin.compute.parallel import Tls, arithmetic, version_differences, versions

CONNECT_TIMEOUT_S: Final = 5.0
"""Timeout of the connection to the scheduler."""
FIRST_WORKER_TIMEOUT_S: Final = 20.0
"""Timeout for the first worker."""
NO_WORKER_TIMEOUT_S: Final = 60.0
"""Timeout without any worker during the work; a restarted worker takes a few seconds."""


@final
class _Failure:
    """An error of Dask in place of the result of a task."""

    def __init__(self, error: BaseException, index: int) -> None:
        self.error = error
        self.index = index


@final
class GuardedBackend(DaskDistributedBackend):  # type: ignore[misc]
    """joblib's backend for Dask that does not wait for a task that failed outside its function.

    Args:
        client: connected to the scheduler.
        name: function that returns the name of a task by its index, for messages.
    """

    def __init__(self, client: Client, name: Callable[[int], str]) -> None:
        super().__init__(client=client)
        self._name = name
        self._out: dict[Any, Callable[[Any], None]] = {}

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Return at least two; with one, joblib would do the work in this process."""
        return max(n_jobs, 2)

    def submit(self, func: Any, callback: Any = None) -> Any:
        """Submit a task as joblib's backend does, with failures reported to the callback."""
        future = super().submit(func, callback)
        self._out[future] = callback
        ((_, (index, *_), _),) = func.items

        def done(ended: Any) -> None:
            self._out.pop(ended, None)
            error = ended.exception()
            if error is not None:
                callback(_Failure(error, index))

        future.add_done_callback(done)
        return future

    def retrieve_result_callback(self, out: Any) -> Any:
        """Return a result as joblib's backend does; for a task that Dask abandoned, the error is its result.

        Raises:
            InputError: the connection is lost, or no worker remains.
        """
        if isinstance(out, InputError):
            raise out
        if isinstance(out, _Failure):
            return [(out.index, self._task_error(out))]
        if isinstance(out, BaseException):
            raise InputError("the connection to the scheduler was lost", expected="a scheduler that runs until the end")
        return super().retrieve_result_callback(out)

    def _task_error(self, failure: _Failure) -> InputError:
        error, name = failure.error, self._name(failure.index)
        if isinstance(error, KilledWorker):
            return InputError(
                f"{error.allowed_failures + 1} workers of the cluster died while running this task",
                expected="enough memory for the task",
                value=name,
            )
        description = f"{type(error).__name__}: {error}".split("\n", 1)[0]
        return InputError(
            f"the cluster failed to run a task: {description}", expected="a cluster that can run it", value=name
        )

    def give_up(self, why: InputError) -> None:
        """End the wait for all pending tasks with an error."""
        for callback in list(self._out.values()):
            callback(why)


@contextmanager
def connected(address: str, tls: Tls | None, name: Callable[[int], str]) -> Iterator[tuple[GuardedBackend, int]]:
    """Connect to the cluster of a scheduler, check it, and return a backend with the number of threads of its workers.

    Args:
        address: of the scheduler.
        tls: files for an encrypted connection; None for Dask's configuration.
        name: function that returns the name of a task by its index, for messages.

    Raises:
        InputError: there is no scheduler, it has no workers, or a worker has no `twin` or other versions.
    """
    with _dask_logs_off(), _client(address, _security(tls)) as client:
        _check(client, address)
        backend = GuardedBackend(client, name)
        stopped = threading.Event()
        watch = threading.Thread(target=_watch, args=(client, address, backend, stopped), daemon=True)
        watch.start()
        try:
            yield backend, max(sum(client.nthreads().values()), 1)
        finally:
            stopped.set()
            watch.join(CONNECT_TIMEOUT_S)


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
def _client(address: str, security: Security) -> Iterator[Client]:
    secure = address.startswith("tls://")
    try:
        # Check first: a client without a scheduler takes ten seconds to close. In another thread: a notebook has an event loop here.
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
        raise InputError(
            "the scheduler's address and the TLS settings do not match",
            expected="certificates for a scheduler at tls://host:8786, none for one at tcp://host:8786",
            value=address,
        ) from error
    try:
        yield client
    finally:
        client.close(CONNECT_TIMEOUT_S)


def _security(tls: Tls | None) -> Security:
    """Return Dask's security settings for the files.

    Raises:
        InputError: a file is missing or is not a certificate or key.
    """
    files = {} if tls is None else {"tls_ca_file": tls.ca_file, "tls_client_cert": tls.certificate}
    if tls is not None and tls.key is not None:
        files["tls_client_key"] = tls.key
    for file in files.values():
        read_bytes(file)
    try:
        security = Security(require_encryption=True if files else None, **{k: str(v) for k, v in files.items()})
        security.get_connection_args("client")
    except (OSError, TypeError, ValueError) as error:
        raise InputError(
            "unusable TLS files",
            expected="PEM files of an authority, a certificate and its key",
            file=None if tls is None else tls.certificate,
            value=error,
        ) from error
    return security


async def _probe(address: str, security: Security) -> None:
    # The timeout of connect does not apply if the other side accepts the connection and sends nothing.
    greeting = connect(address, timeout=CONNECT_TIMEOUT_S, **security.get_connection_args("client"))
    comm = await asyncio.wait_for(greeting, CONNECT_TIMEOUT_S + 1.0)
    comm.abort()


def _check(client: Client, address: str) -> None:
    """Raise `InputError` unless scheduler and workers can do the work with the versions of this computer."""
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_TIMEOUT_S)
    except TimeoutError as error:
        raise InputError(
            "scheduler without workers", expected=f"workers started with `dask worker {address}`", value=address
        ) from error
    mine = versions()
    # Use a function of the standard library, since a worker without twin cannot load functions of twin.
    there = client.run(metadata.version, "twin", on_error="return")
    try:
        client.run_on_scheduler(metadata.version, "twin")
    except metadata.PackageNotFoundError as error:
        raise InputError(
            "twin is not installed on the scheduler's computer", expected=f"twin {mine['twin']} there"
        ) from error
    for worker, version in there.items():
        if isinstance(version, BaseException):
            raise InputError("twin is not installed on a worker", expected=f"twin {mine['twin']} there", value=worker)
    for worker, found in client.run(versions, on_error="return").items():
        different = (
            f"twin {there.get(worker)}" if isinstance(found, BaseException) else version_differences(mine, found)
        )
        if different:
            raise InputError(
                f"a worker has other versions: {different}",
                expected="the same versions on all computers",
                value=worker,
            )
    other = [worker for worker, digest in client.run(arithmetic, on_error="return").items() if digest != arithmetic()]
    if other:
        logging.getLogger("twin").warning(
            "%d workers have another processor or compiler than this computer; the last digits of results may differ",
            len(other),
        )


def _watch(client: Client, address: str, backend: GuardedBackend, stopped: threading.Event) -> None:
    """End the wait of the backend when no worker remains."""
    without_workers = 0.0
    while not stopped.wait(CONNECT_TIMEOUT_S):
        try:
            without_workers = 0.0 if client.nthreads() else without_workers + CONNECT_TIMEOUT_S
        except (OSError, RuntimeError):  # lost, or closed
            without_workers = NO_WORKER_TIMEOUT_S
        if without_workers >= NO_WORKER_TIMEOUT_S and not stopped.is_set():
            backend.give_up(
                InputError("no worker of the cluster remains", expected="workers that run until the end", value=address)
            )
            return
