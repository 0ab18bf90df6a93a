"""Where independent work runs: in this process, in a pool of processes, or on a Dask cluster.

One interface, :meth:`Engine.map`: a function over tasks, results in the order of the tasks, few of them held at once.
Whoever sums the results in that order gets the same bytes from every engine and any number of workers.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

from hybrid_dynamics.errors import ConfigError, HybridDynamicsError, InputError, needs_extra

Task = TypeVar("Task")
Result = TypeVar("Result")

ENGINES = ("local", "dask")
LOOPBACK = ("localhost", "127.0.0.1", "::1")


class Engine(Protocol):
    """Runs ``function``, a function of a module, on each of ``tasks``; an exception in one of them is raised here."""

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """The results in the order of the tasks, few of them held at once."""
        ...

    def unordered(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[int, Result]]:
        """Number of the task and result, as they are done: for results that are written down one by one."""
        ...


def one_thread() -> None:
    """In a worker: its own numerical libraries take one thread each, since the workers share the machine."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    threadpool_limits(1)


@dataclass(frozen=True)
class Local:
    """This machine: ``workers`` processes, or this process alone with one."""

    workers: int = 1

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise ConfigError(f"workers is {self.workers}; expected 1 or more")

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """See :class:`Engine`."""
        if self.workers == 1:
            yield from map(function, tasks)
            return
        with self._pool() as pool:
            yield from _in_order(lambda task: pool.submit(function, task), tasks, 2 * self.workers)

    def unordered(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[int, Result]]:
        """See :class:`Engine`."""
        if self.workers == 1:
            yield from enumerate(map(function, tasks))
            return
        with self._pool() as pool:
            numbers = {pool.submit(function, task): k for k, task in enumerate(tasks)}
            for done in as_completed(numbers):
                yield numbers.pop(done), done.result()

    @contextlib.contextmanager
    def _pool(self) -> Iterator[ProcessPoolExecutor]:
        # "spawn": a fork of a process that holds threads (Arrow, BLAS) may hang.
        pool = ProcessPoolExecutor(
            self.workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
        )
        try:
            yield pool
        except BrokenProcessPool:
            raise InputError(
                "a worker process was killed (out of memory?); use fewer workers, or engine=dask, which tries again"
            ) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _start_worker() -> None:
    # Ctrl-C reaches all processes of a terminal; the parent alone decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    one_thread()


@dataclass
class Cluster:
    """A Dask cluster: ``address`` of its scheduler, or ``workers`` processes of its own on this machine (loopback).

    A scheduler and its workers unpickle, that is execute, what they are sent. So an address that is not on this machine
    must be ``tls://host:port``, with ``certificates``: the authority's, the client's, and the client's key (PEM files).
    Use it as a context; a task whose worker died is given to another one.
    """

    address: str | None = None
    workers: int = 2
    memory_limit: str = "2GB"
    certificates: tuple[str, str, str] | None = None
    _client: Any = field(default=None, init=False, repr=False)
    _stack: contextlib.ExitStack = field(default_factory=contextlib.ExitStack, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise ConfigError(f"workers is {self.workers}; expected 1 or more")
        if self.address is None:
            return
        parts = urlsplit(self.address if "//" in self.address else f"tcp://{self.address}")
        if parts.scheme != "tls" and parts.hostname not in LOOPBACK:
            raise ConfigError(
                f"scheduler {self.address} is on another machine without encryption, and whoever can reach it can run "
                "code on it; expected tls://host:port and its certificates"
            )
        if parts.scheme == "tls" and self.certificates is None:
            raise ConfigError(f"scheduler {self.address} needs certificates: authority, client, key (PEM files)")
        for file in self.certificates or ():
            if not Path(file).is_file():
                raise ConfigError(f"{file}: no such file; expected a certificate or key for {self.address} (PEM)")

    def __enter__(self) -> Cluster:
        with needs_extra("dask", "engine=dask"):
            from distributed import Client, LocalCluster
            from distributed.security import Security
        if self.address is None:
            cluster = LocalCluster(
                n_workers=self.workers,
                threads_per_worker=1,
                memory_limit=self.memory_limit,
                host="127.0.0.1",
                dashboard_address=None,
            )
            self._client = self._stack.enter_context(Client(self._stack.enter_context(cluster)))
        else:
            security = None
            if self.certificates is not None:
                authority, certificate, key = self.certificates
                security = Security(
                    tls_ca_file=authority, tls_client_cert=certificate, tls_client_key=key, require_encryption=True
                )
            try:
                self._client = self._stack.enter_context(Client(self.address, security=security, timeout="20s"))
            except OSError as error:
                raise ConfigError(f"no Dask scheduler answers at {self.address} ({error}); start it first") from None
        return self

    def __exit__(self, *exception: Any) -> None:
        self._client = None
        self._stack.close()

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """See :class:`Engine`."""
        workers = max(len(self._running().scheduler_info()["workers"]), 1)
        yield from _in_order(lambda task: self._submit(function, task), tasks, 2 * workers)

    def unordered(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[int, Result]]:
        """See :class:`Engine`."""
        from distributed import as_completed as as_finished

        numbers = {self._submit(function, task): k for k, task in enumerate(tasks)}
        for done in as_finished(list(numbers)):
            yield numbers.pop(done), done.result()

    def _running(self) -> Any:
        if self._client is None:
            raise HybridDynamicsError("the cluster is not running; use it as a context: with Cluster() as engine")
        return self._client

    def _submit(self, function: Callable[[Task], Result], task: Task) -> Any:
        # A task runs again where its worker died (the scheduler sees to it), not where it failed.
        return self._running().submit(_alone, function, task, pure=False)


def _alone(function: Callable[[Task], Result], task: Task) -> Result:
    one_thread()
    return function(task)


def _in_order(submit: Callable[[Task], Any], tasks: Sequence[Task], ahead: int) -> Iterator[Any]:
    """Results in the order of the tasks, at most ``ahead`` under way or waiting: memory does not grow with the data."""
    pending: deque[Any] = deque()
    for task in tasks:
        pending.append(submit(task))
        if len(pending) >= ahead:
            yield pending.popleft().result()
    while pending:
        yield pending.popleft().result()


@contextlib.contextmanager
def engine_of(
    name: str, workers: int = 1, address: str | None = None, certificates: tuple[str, str, str] | None = None
) -> Iterator[Engine]:
    """The engine called ``name``: ``local``, or ``dask`` (with a scheduler's ``address``, or on this machine)."""
    if name == "local":
        yield Local(workers)
    elif name == "dask":
        with Cluster(address, workers, certificates=certificates) as cluster:
            yield cluster
    else:
        raise ConfigError(f"engine is {name!r}; expected one of {', '.join(ENGINES)}")
