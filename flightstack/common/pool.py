"""Worker processes whose results are returned as they arrive; no result is lost if a worker dies or hangs.

The workers are forked and use the modules and code that this process has loaded and compiled. If a fork is
not safe (``may_fork``), the workers are spawned.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from flightstack.common.processes import LaunchError, forget_handlers, may_fork

T = TypeVar("T")
R = TypeVar("R")
START_S = 1800.0  # time-out of a worker's start, including compilation on a slow computer, s


class WorkersError(LaunchError):
    """A worker process ended, or hung, before it received its first item."""


class _LostError(Exception):
    """A worker died or hung; ``items``: submitted items without a result."""

    def __init__(self, items: Iterable[Any], what: str) -> None:
        super().__init__(what)
        self.items = [*items]


class Processes(ProcessPoolExecutor):
    """Processes that call ``start`` before their work; the exit of the context kills them."""

    def __init__(self, number: int, start: Callable[..., object], arguments: tuple[Any, ...]) -> None:
        self._forks = may_fork()
        context = multiprocessing.get_context("fork" if self._forks else "spawn")
        super().__init__(number, context, _begin, (start, arguments))

    def submit(self, work: Callable[..., R], /, *arguments: Any, **named: Any) -> Future[R]:
        with contextlib.nullcontext() if self._forks else _without_main():
            return super().submit(work, *arguments, **named)

    def __exit__(self, *_: object) -> None:
        for process in [*(self._processes or {}).values()]:
            process.kill()
        self.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _without_main() -> Iterator[None]:
    """Prevent new processes from running the main script, which then needs no ``__main__`` guard."""
    main = sys.modules["__main__"]
    file, main.__spec__, spec = vars(main).pop("__file__", None), None, main.__spec__
    try:
        yield
    finally:
        main.__spec__ = spec
        if file is not None:
            main.__file__ = file


def _begin(start: Callable[..., object], arguments: tuple[Any, ...]) -> None:
    """Prepare a worker: it ignores Ctrl-C and ends with its parent; then call ``start``."""
    forget_handlers()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_end_after, args=(parent,), daemon=True).start()
    start(*arguments)


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def results(
    executor: Executor, work: Callable[[T], R], waiting: deque[T], ahead: Callable[[], int],
    limit_s: float | None = None,
) -> Iterator[tuple[T, Future[R]]]:  # fmt: skip
    """Yield items with their finished futures, in any order; at most ``ahead()`` items are in progress."""
    running: dict[Future[R], T] = {}
    try:
        while waiting or running:
            while waiting and len(running) < ahead():
                future = executor.submit(work, waiting[0])
                running[future] = waiting.popleft()
            done = wait(running, limit_s, FIRST_COMPLETED).done
            if not done:
                raise _LostError(running.values(), "did not end")
            for future in done:
                if isinstance(future.exception(), BrokenProcessPool):
                    raise BrokenProcessPool
            yield from [(running.pop(future), future) for future in done]
    except BrokenProcessPool:
        raise _LostError(running.values(), "ended its worker") from None


def in_processes(
    work: Callable[[T], R], items: Iterable[T], number: int, failed: Callable[[T, str], R], *,
    start: Callable[..., object] = bool, arguments: tuple[Any, ...] = (), limit_s: float | None = None,
) -> Iterator[R]:  # fmt: skip
    """Yield the results of ``work`` as they arrive, in any order, from ``number`` processes.

    If a worker dies or hangs, each submitted item can be the cause. These items are submitted again, one at a
    time; ``failed`` returns the result of an item whose worker dies a second time, or again exceeds
    ``limit_s``. Raises WorkersError: no worker starts.
    """
    waiting, suspects = deque(items), deque[T]()
    try:
        multiprocessing.Lock()
    except (OSError, NotImplementedError) as error:  # /dev/shm is missing or read-only
        print(f"one process instead of {number}: no shared memory ({error})", file=sys.stderr)
        yield from map(work, waiting)
        return
    while waiting or suspects:
        alone = bool(suspects)
        most = 1 if alone else min(number, len(waiting))
        with Processes(most, start, arguments) as pool:
            try:
                pool.submit(os.getpid).result(START_S)
            except (BrokenProcessPool, TimeoutError):
                raise WorkersError(
                    "a worker ended before it was ready; is the machine out of memory? Try fewer --workers"
                ) from None
            try:
                for _, future in results(
                    pool, work, suspects if alone else waiting, partial(int, most), limit_s
                ):
                    yield future.result()
            except _LostError as lost:
                if alone:
                    yield from (failed(item, f"{lost} twice") for item in lost.items)
                else:
                    suspects.extend(lost.items)
