"""A campaign on a Dask cluster: the scheduler sends seeds to workers, and again if a worker dies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from flightstack.common.processes import LaunchError
from flightstack.common.text import pip_install
from sim.campaign.rows import Row, error_row
from sim.campaign.workers import code_fingerprint, fly_seed_as

CONNECT_S = 10.0  # time-out for the scheduler and the first worker, wall time
AHEAD = 4  # seeds submitted per thread of the cluster; further seeds wait in this process


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
        except Exception as error:  # any exception of a worker means that its code differs
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
        """Yield the rows of these seeds as they arrive, in any order; the number in flight is bounded."""
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
