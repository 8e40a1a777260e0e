"""Flies the landings of a campaign in processes of this machine, or on the workers of a Dask cluster."""

from __future__ import annotations

import gc
import hashlib
import pickle
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from flightstack.common.pacing import quiet_garbage_collector
from flightstack.common.pool import in_processes, results
from flightstack.common.processes import LaunchError, may_fork
from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import pip_install
from flightstack.core.parameters.filters import failed_in, give
from sim.campaign.rows import Row, error_row, row_of
from sim.runners.landing import land, warm_up
from sim.scenarios.scenario import Scenario, from_text
from sim.vehicle.declared import outside

_ALONE = threading.Lock()  # serialises landings: threads of a cluster's worker would only wait for each other
_PACKAGES = ("flightstack", "bridge", "sim", "logs")
SLOWEST = 0.05  # lower limit of the ratio of simulated to wall time; a slower worker is ended


@lru_cache(maxsize=4)
def loaded(scenario_toml: str) -> Scenario:
    """Return the scenario in a text; compile all code that it needs."""
    scenario = from_text(scenario_toml)
    warm_up(scenario)
    return scenario


@lru_cache(maxsize=4)
def prepared(scenario_toml: str) -> Scenario:
    """Return the scenario in a text; compile its code and exclude present objects from garbage collection."""
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
    """Return the hash of the simulated code; rows of different code versions must not be mixed."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        folder = Path(str(files(package)))
        for source in sorted([*folder.rglob("*.py"), *folder.rglob("*.toml")]):
            digest.update(f"{package}/{source.relative_to(folder).as_posix()}\n".encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def fly_here(
    scenario_toml: str, seeds: Iterable[int], workers: int, duration_max_s: float, given: bytes = b""
) -> Iterator[Row]:
    """Yield the rows of these seeds as they arrive, in any order, from processes on this machine.

    ``scenario_toml``: the scenario as text; ``duration_max_s``: simulated time limit of a landing; ``given``:
    pickled class of a filter that is in no module, for processes that are not forked.
    Raises WorkersError: no worker process starts.
    """
    if may_fork():
        loaded(scenario_toml)
    yield from in_processes(
        partial(fly_seed, scenario_toml), seeds, workers, error_row,
        start=_prepare, arguments=(scenario_toml, given), limit_s=duration_max_s / SLOWEST,
    )  # fmt: skip


def _prepare(scenario_toml: str, given: bytes) -> None:
    if given:
        give(pickle.loads(given))
    prepared(scenario_toml)


CONNECT_S = 10.0  # time-out for the scheduler and the first worker, s of wall time
AHEAD = 4  # number of submitted seeds per thread of the cluster; further seeds wait in this process


class ClusterError(LaunchError):
    """The cluster cannot be used."""


def fly_on_cluster(address: str, scenario_toml: str, seeds: Iterable[int]) -> Iterator[Row]:
    """Yield the rows of these seeds as they arrive, in any order; few seeds are submitted at a time.

    Raises ClusterError: Dask is not installed, no scheduler answers, or a worker has another code version.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        raise ClusterError(
            f"--cluster needs Dask ({error.name} is missing): {pip_install('sim,cluster')}"
        ) from None
    try:
        client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"--cluster {address}: no scheduler answers there ({error}); start one with `dask scheduler`"
        ) from None
    with client:
        _check(client, address)

        def ahead() -> int:
            workers = client.scheduler_info()["workers"].values()
            return AHEAD * max(1, sum(int(worker["nthreads"]) for worker in workers))

        work = partial(fly_seed_as, code_fingerprint(), scenario_toml)
        for seed, future in results(client.get_executor(pure=False), work, deque(seeds), ahead):
            try:
                yield future.result()
            except Exception as died:  # workers died or have other code; other errors have become rows
                yield error_row(seed, f"{type(died).__name__}: {died}")


def _check(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError:
        raise ClusterError(
            f"--cluster {address}: the scheduler has no workers; start some with `dask worker {address}`"
        ) from None
    try:
        theirs = client.run(code_fingerprint)
    except Exception as error:  # every exception of a worker means a different code version
        raise ClusterError(
            f"--cluster {address}: a worker cannot fly ({error}); install the same version there"
        ) from error
    others = [worker for worker, code in theirs.items() if code != code_fingerprint()]
    if others:
        raise ClusterError(f"--cluster {address}: other code than here on {', '.join(others)}")
