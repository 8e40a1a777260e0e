"""Worker processes of a campaign, and the function that flies one landing and returns its row.

On a Dask cluster the scheduler sends each seed to a worker, which runs ``fly_seed_as``.
On this machine, processes receive seeds and return rows.

Each worker has its own pipe, because a killed worker could leave a shared queue locked. Workers are forked
and use the modules and code that this process has loaded and compiled; if it has other threads, they are
spawned. A worker has one seed at a time, so the queue is bounded and the seed of a dead worker is known.
Another worker flies this seed again; if that one also dies, the seed's row has the outcome "error".
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import multiprocessing
import pickle
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.resources import files
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkContext, SpawnContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from flightstack.common.pacing import quiet_garbage_collector
from flightstack.common.processes import LaunchError, forget_handlers, may_fork
from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import pip_install
from flightstack.core.parameters.filters import failed_in, give
from sim.campaign.rows import Row, error_row, row_of
from sim.runners.landing import land, warm_up
from sim.scenarios.scenario import Scenario, from_text
from sim.vehicle.declared import outside

_ALONE = threading.Lock()  # serialises landings: threads of a cluster's worker would only wait for each other
_PACKAGES = ("flightstack", "bridge", "sim", "logs")
DEATHS_MAX = 2  # number of workers that may die with one seed before its row gets the outcome "error"
STARTS_MAX = 3  # maximum number of consecutive workers that end before they are ready
SLOWEST = 0.05  # smallest ratio of simulated to wall time; a slower worker is ended
START_S = 1800.0  # time-out of a worker's start, including compilation on a slow computer, s
_LOOK_S = 1.0  # wall time between two checks of the time-outs, s
_END_S = 5.0  # time-out of a worker's end, s of wall time


@lru_cache(maxsize=4)
def loaded(scenario_toml: str) -> Scenario:
    """Return the scenario of a text, with all code compiled."""
    scenario = from_text(scenario_toml)
    warm_up(scenario)
    return scenario


@lru_cache(maxsize=4)
def prepared(scenario_toml: str) -> Scenario:
    """Return the scenario of a text; compile all code and exclude present objects from garbage collection."""
    scenario = loaded(scenario_toml)
    quiet_garbage_collector()
    return scenario


def fly_seed(scenario_toml: str, seed: int) -> Row:
    """Fly one landing; an exception becomes a row, so that the other seeds are still flown."""
    with _ALONE:
        scenario = prepared(scenario_toml)
        try:
            return replace(row_of(land(scenario, seed)), outside_envelope=outside(scenario.members))
        except ConfigError as error:
            return error_row(seed, str(error))
        except Exception as error:
            own = next(filter(None, (failed_in(each.onboard.filter, error) for each in scenario.members)), "")
            return error_row(seed, own or f"{type(error).__name__}: {error}")
        finally:
            gc.collect()  # collect between landings, never during a landing


def fly_seed_as(code: str, scenario_toml: str, seed: int) -> Row:
    """Fly one landing on another machine. Raises RuntimeError: its code version differs."""
    here = code_fingerprint()
    if here != code:
        raise RuntimeError(f"other code on this worker: {here}, not {code}; install the same version")
    return fly_seed(scenario_toml, seed)


@lru_cache(maxsize=1)
def code_fingerprint() -> str:
    """Return the hash of the simulated code; rows of different versions must not be mixed."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        folder = Path(str(files(package)))
        for source in sorted([*folder.rglob("*.py"), *folder.rglob("*.toml")]):
            digest.update(f"{package}/{source.relative_to(folder).as_posix()}\n".encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


class WorkersError(LaunchError):
    """Workers end repeatedly before they fly a landing."""


class _Worker:
    """One worker process and its pipe; ``seed``: current seed, None before the worker is ready."""

    def __init__(self, scenario_toml: str, others: Sequence[Connection], given: bytes) -> None:
        forks = may_fork()
        context: ForkContext | SpawnContext = multiprocessing.get_context("spawn")
        if forks:
            loaded(scenario_toml)
            context = multiprocessing.get_context("fork")
        self.pipe, theirs = context.Pipe()
        not_its_own = (*others, self.pipe) if forks else ()
        self.process: BaseProcess = context.Process(
            target=_work, args=(theirs, scenario_toml, not_its_own, given), daemon=True
        )
        with contextlib.nullcontext() if forks else _without_main():
            self.process.start()
        theirs.close()
        self.ready = False
        self.seed: int | None = None
        self.since_s = time.monotonic()

    def give(self, seed: int) -> None:
        self.seed, self.since_s = seed, time.monotonic()
        with contextlib.suppress(OSError):  # the worker has just died; ``_heard`` detects this at its pipe
            self.pipe.send(seed)

    def end(self) -> None:
        self.pipe.close()
        self.process.terminate()
        self.process.join(_END_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join(_END_S)


@contextlib.contextmanager
def _without_main() -> Iterator[None]:
    """Start processes that do not run the main script again, so that the script needs no guard."""
    main = sys.modules["__main__"]
    file, main.__spec__, spec = vars(main).pop("__file__", None), None, main.__spec__
    try:
        yield
    finally:
        main.__spec__ = spec
        if file is not None:
            main.__file__ = file


def _work(
    pipe: Connection, scenario_toml: str, not_its_own: Sequence[Connection], given: bytes = b""
) -> None:
    """Fly seeds until the pipe is closed; Ctrl-C is handled by the parent.

    The worker receives seeds by ``pipe`` and sends rows. It closes ``not_its_own``, the parent's ends of
    pipes that a fork inherits, because a pipe closes only when no process holds its other end. ``given``:
    pickled class of a filter that is in no module.
    """
    if given:
        give(pickle.loads(given))
    for one in not_its_own:
        one.close()
    forget_handlers()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prepared(scenario_toml)
    try:
        pipe.send(None)
        while True:
            pipe.send(fly_seed(scenario_toml, pipe.recv()))
    except (EOFError, OSError):  # the parent has ended, or closed the pipe
        return


class Workers:
    """A fixed number of running workers; all end with the context.

    ``scenario_toml``: the scenario as text; ``number``: number of workers; ``duration_max_s``: longest
    landing, simulated time; ``given``: pickled class of a filter that is in no module, for workers that are
    not forked.
    """

    def __init__(self, scenario_toml: str, number: int, duration_max_s: float, *, given: bytes = b"") -> None:
        self._scenario_toml, self._number, self._given = scenario_toml, number, given
        self._limit_s = duration_max_s / SLOWEST
        self._workers: list[_Worker] = []
        self._deaths: Counter[int] = Counter()
        self._starts_failed = 0

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def fly(self, seeds: Iterable[int]) -> Iterator[Row]:
        """Yield the rows of these seeds as they arrive, in any order.

        Raises WorkersError: workers end before they fly anything.
        """
        waiting = deque(seeds)
        while waiting or self._busy():
            while len(self._workers) < min(self._number, self._busy() + len(waiting)):
                self._workers.append(
                    _Worker(self._scenario_toml, [worker.pipe for worker in self._workers], self._given)
                )
            pipes: dict[Any, _Worker] = {worker.pipe: worker for worker in self._workers}
            for pipe in wait(list(pipes), _LOOK_S):
                if (row := self._heard(pipes[pipe], waiting)) is not None:
                    yield row
            for worker in [each for each in self._workers if self._too_slow(each)]:
                if (row := self._bury(worker, waiting)) is not None:
                    yield row
            for worker in self._workers:
                if worker.ready and worker.seed is None and waiting:
                    worker.give(waiting.popleft())

    def _busy(self) -> int:
        return sum(worker.seed is not None for worker in self._workers)

    def _heard(self, worker: _Worker, waiting: deque[int]) -> Row | None:
        """Receive from a worker, or handle its death, which closes the pipe: only the worker has that end."""
        try:
            row: Row | None = worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join(_END_S)
            return self._bury(worker, waiting)
        worker.ready, worker.seed, self._starts_failed = True, None, 0
        return row

    def _too_slow(self, worker: _Worker) -> bool:
        limit_s = self._limit_s if worker.ready else START_S
        idle = worker.ready and worker.seed is None
        return not idle and time.monotonic() - worker.since_s > limit_s

    def _bury(self, worker: _Worker, waiting: deque[int]) -> Row | None:
        """Remove a dead or hung worker; another worker flies its seed, up to ``DEATHS_MAX`` times."""
        hung, seed = worker.process.is_alive(), worker.seed
        worker.end()
        self._workers.remove(worker)
        code = worker.process.exitcode
        if seed is None:
            self._starts_failed += not worker.ready
            if self._starts_failed >= STARTS_MAX:
                raise WorkersError(
                    f"{STARTS_MAX} workers in a row ended before they were ready (exit status {code}); "
                    "is the machine out of memory? Try fewer --workers"
                )
            return None
        self._deaths[seed] += 1
        if self._deaths[seed] < DEATHS_MAX:
            waiting.appendleft(seed)
            return None
        what = "did not end" if hung else f"ended its worker (exit status {code})"
        return error_row(seed, f"{what} {DEATHS_MAX} times")


CONNECT_S = 10.0  # time-out for the scheduler and the first worker, s of wall time
AHEAD = 4  # number of submitted seeds per thread of the cluster; further seeds wait in this process


class ClusterError(LaunchError):
    """The cluster cannot be used."""


class Cluster:
    """Connection to a Dask scheduler.

    Raises ClusterError: Dask is not installed, no scheduler answers, or a worker has another code version.
    """

    def __init__(self, address: str, scenario_toml: str) -> None:
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            raise ClusterError(
                f"--cluster needs Dask ({error.name} is missing): {pip_install('sim,cluster')}"
            ) from None
        self._scenario_toml, self._code = scenario_toml, code_fingerprint()
        try:
            self._client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"--cluster {address}: no scheduler answers there ({error}); start one with `dask scheduler`"
            ) from None
        try:
            self._check(address)
        except BaseException:
            self._client.close()
            raise

    def _check(self, address: str) -> None:
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise ClusterError(
                f"--cluster {address}: the scheduler has no workers; start some with `dask worker {address}`"
            ) from None
        ours = self._code
        try:
            theirs = self._client.run(code_fingerprint)
        except Exception as error:  # every exception of a worker means a different code version
            raise ClusterError(
                f"--cluster {address}: a worker cannot fly ({error}); install the same version there"
            ) from error
        others = [worker for worker, code in theirs.items() if code != ours]
        if others:
            raise ClusterError(f"--cluster {address}: other code than here on {', '.join(others)}")

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def fly(self, seeds: Iterable[int]) -> Iterator[Row]:
        """Yield the rows of these seeds as they arrive, in any order; few seeds are submitted at a time."""
        from distributed import as_completed

        waiting = iter(seeds)
        running: dict[Any, int] = {}
        done = as_completed(loop=self._client.loop)

        def give_out() -> None:
            threads = sum(w["nthreads"] for w in self._client.scheduler_info()["workers"].values())
            while len(running) < AHEAD * max(1, threads):
                seed = next(waiting, None)
                if seed is None:
                    return
                future = self._client.submit(fly_seed_as, self._code, self._scenario_toml, seed, pure=False)
                running[future] = seed
                done.add(future)

        give_out()
        while running:
            future = next(done)
            seed = running.pop(future)
            yield self._row(future, seed)
            future.release()
            give_out()

    @staticmethod
    def _row(future: Any, seed: int) -> Row:
        try:
            row: Row = future.result()
        except Exception as error:  # the workers died; fly_seed_as turns every other error into a row
            return error_row(seed, f"{type(error).__name__}: {error}")
        return row
