"""A Dask cluster as joblib's backend, with what that leaves out: is it there, is it fit, and does it still live.

joblib's own backend waits for ever where Dask gives a task up, where the scheduler ends, and where no worker is left (joblib 1.6).
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
from twin.compute.parallel.tls import Tls
from twin.compute.parallel.versions import apart, arithmetic, versions

CONNECT_S: Final = 5.0
"""Longest wait for an answer of the scheduler."""
WORKERS_S: Final = 20.0
"""Longest wait for a first worker."""
ALONE_S: Final = 60.0
"""Longest time without any worker in the middle of the work: a restarted one takes a few seconds."""


@final
class _Failure:
    """What Dask says instead of a result."""

    def __init__(self, error: BaseException, index: int) -> None:
        self.error = error
        self.index = index


@final
class GuardedBackend(DaskDistributedBackend):  # type: ignore[misc]
    """joblib's backend for Dask, in which a task that fails on the way, not in its function, is not waited for.

    Args:
        client: connected to the scheduler.
        name: of a task by its index, for messages.
    """

    def __init__(self, client: Client, name: Callable[[int], str]) -> None:
        super().__init__(client=client)
        self._name = name
        self._out: dict[Any, Callable[[Any], None]] = {}

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Two at least: where there is one, joblib would do the work in this process."""
        return max(n_jobs, 2)

    def submit(self, func: Any, callback: Any = None) -> Any:
        """As of joblib's backend."""
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
        """As of joblib's backend; a task that Dask gave up has that for its result, which joblib would wait for.

        Raises:
            InputError: the connection is lost, or no worker left.
        """
        if isinstance(out, InputError):
            raise out
        if isinstance(out, _Failure):
            return [(out.index, self._refusal(out))]
        if isinstance(out, BaseException):
            raise InputError("the connection to the scheduler is lost", expected="a scheduler that stays")
        return super().retrieve_result_callback(out)

    def _refusal(self, failure: _Failure) -> InputError:
        error, name = failure.error, self._name(failure.index)
        if isinstance(error, KilledWorker):
            return InputError(
                f"{error.allowed_failures + 1} workers of the cluster died, each while it had this task",
                expected="memory enough for it",
                value=name,
            )
        told = f"{type(error).__name__}: {error}".split("\n", 1)[0]
        return InputError(f"the cluster failed at a task: {told}", expected="a cluster that can run it", value=name)

    def give_up(self, why: InputError) -> None:
        """End the waiting for all that is out."""
        for callback in list(self._out.values()):
            callback(why)


@contextmanager
def connected(address: str, tls: Tls | None, name: Callable[[int], str]) -> Iterator[tuple[GuardedBackend, int]]:
    """The cluster of a scheduler, fit to work, and how many threads its workers have.

    Args:
        address: of the scheduler.
        tls: files for an encrypted connection; None for Dask's configuration.
        name: of a task by its index, for messages.

    Raises:
        InputError: none there, no workers, workers without `twin` or with other versions.
    """
    with _quiet(), _client(address, _security(tls)) as client:
        _check(client, address)
        backend = GuardedBackend(client, name)
        over = threading.Event()
        watch = threading.Thread(target=_watch, args=(client, address, backend, over), daemon=True)
        watch.start()
        try:
            yield backend, max(sum(client.nthreads().values()), 1)
        finally:
            over.set()
            watch.join(CONNECT_S)


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask's own messages kept back: what it would say of lost connections and dead workers is dealt with here."""
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
        # A client that finds nobody takes ten seconds to go away. In a thread of its own: a notebook has an event loop in this one.
        with ThreadPoolExecutor(1) as pool:
            pool.submit(asyncio.run, _greet(address, security)).result()
        client = Client(address, timeout=CONNECT_S, set_as_default=False, name="twin", security=security)
    except (OSError, ValueError, MemoryError) as error:  # who speaks something else may seem to announce exabytes
        raise InputError(
            "no Dask scheduler answers there",
            expected="its address, as `dask scheduler` prints it (tcp://host:8786)"
            + (", and certificates of one authority on both sides" if secure else ""),
            value=address,
        ) from error
    except (
        RuntimeError,
        TypeError,
    ) as error:  # encryption is required and the address has none; TLS without certificates
        raise InputError(
            "the scheduler's address and the TLS settings do not belong together",
            expected="certificates for a scheduler at tls://host:8786, none for one at tcp://host:8786",
            value=address,
        ) from error
    try:
        yield client
    finally:
        client.close(CONNECT_S)


def _security(tls: Tls | None) -> Security:
    """Return Dask's settings, read from files that fit.

    Raises:
        InputError: a file is missing or is no certificate or key.
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
            "TLS settings that cannot be used",
            expected="PEM files of an authority, of a certificate and of its key",
            file=None if tls is None else tls.certificate,
            value=error,
        ) from error
    return security


async def _greet(address: str, security: Security) -> None:
    # Its own time limit does not hold against who takes the call and says nothing.
    greeting = connect(address, timeout=CONNECT_S, **security.get_connection_args("client"))
    comm = await asyncio.wait_for(greeting, CONNECT_S + 1.0)
    comm.abort()


def _check(client: Client, address: str) -> None:
    """Nothing, if scheduler and workers can do the work and will find the same as this computer."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError as error:
        raise InputError(
            "a scheduler without workers", expected=f"some started with `dask worker {address}`", value=address
        ) from error
    mine = versions()
    # Asked by a function of the standard library: who has no twin has none of ours.
    there = client.run(metadata.version, "twin", on_error="return")
    try:
        client.run_on_scheduler(metadata.version, "twin")
    except metadata.PackageNotFoundError as error:
        raise InputError("the scheduler's computer has no twin", expected=f"twin {mine['twin']} there") from error
    for worker, told in there.items():
        if isinstance(told, BaseException):
            raise InputError("a worker without twin", expected=f"twin {mine['twin']} there", value=worker)
    for worker, found in client.run(versions, on_error="return").items():
        different = f"twin {there.get(worker)}" if isinstance(found, BaseException) else apart(mine, found)
        if different:
            raise InputError(
                f"a worker with other versions, which give other digits: {different}",
                expected="the same on all computers",
                value=worker,
            )
    other = [worker for worker, told in client.run(arithmetic, on_error="return").items() if told != arithmetic()]
    if other:
        logging.getLogger("twin").warning(
            "%d workers have another processor or compiler than this computer: last digits may differ", len(other)
        )


def _watch(client: Client, address: str, backend: GuardedBackend, over: threading.Event) -> None:
    """Tell the backend when nobody is left to wait for."""
    alone = 0.0
    while not over.wait(CONNECT_S):
        try:
            alone = 0.0 if client.nthreads() else alone + CONNECT_S
        except (OSError, RuntimeError):  # lost, or closed
            alone = ALONE_S
        if alone >= ALONE_S and not over.is_set():
            backend.give_up(InputError("no worker of the cluster is left", expected="workers that stay", value=address))
            return
