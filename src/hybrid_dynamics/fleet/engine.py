"""Where the loops of a fleet run: one call for all, so that a cluster can take the place of local processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Protocol, TypeVar

from hybrid_dynamics.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")


class Engine(Protocol):
    """Calls a function on every item, somewhere."""

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[tuple[int, Result]]:
        """(position, result) of every item, in the order in which they are done. ``function`` must be importable."""
        ...


@dataclass(frozen=True)
class LocalEngine:
    """``workers`` processes of this machine; with one, everything stays in this process."""

    workers: int = 1

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[tuple[int, Result]]:
        """See :class:`Engine`; :class:`InputError` where a worker was killed (of what was done nothing is lost)."""
        if self.workers <= 1 or len(items) <= 1:
            for k, item in enumerate(items):
                yield k, function(item)
            return
        # Linear algebra in one thread each: more of them beside busy processes cost more than they bring.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        # A forked child of a process with threads (Arrow has some) may hang; a fresh one takes seconds longer.
        context = multiprocessing.get_context("spawn")
        workers = min(self.workers, len(items))
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_leave_interrupts_to_the_parent)
        try:
            futures: dict[Future[Result], int] = {pool.submit(function, item): k for k, item in enumerate(items)}
            while futures:
                for future in wait(futures, return_when=FIRST_COMPLETED).done:
                    yield futures.pop(future), future.result()
        except BrokenProcessPool:
            raise InputError(
                "a worker process was killed (out of memory?); run again with fewer --workers: what is done is kept"
            ) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _leave_interrupts_to_the_parent() -> None:
    """Ctrl-C reaches all processes of a terminal; the parent alone decides what becomes of it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
