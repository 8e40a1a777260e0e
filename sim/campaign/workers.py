"""Flies the landings of a campaign in processes of this machine."""

from __future__ import annotations

import gc
import hashlib
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path

from flightstack.common.pacing import quiet_garbage_collector
from flightstack.common.pool import in_processes
from flightstack.common.processes import may_fork
from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.filters import failed_in, give
from sim.campaign.rows import Row, error_row, row_of
from sim.runners.landing import land, warm_up
from sim.scenarios.scenario import Scenario, from_text
from sim.vehicle.declared import outside

_PACKAGES = ("flightstack", "bridge", "sim", "logs")
SLOWEST = 0.05  # smallest ratio of simulated to wall time; a slower worker is ended


@lru_cache(maxsize=4)
def loaded(scenario_toml: str) -> Scenario:
    """Return the scenario of a text, with all code compiled."""
    scenario = from_text(scenario_toml)
    warm_up(scenario)
    return scenario


def fly_seed(scenario_toml: str, seed: int) -> Row:
    """Fly one landing; an exception becomes a row, so that the other seeds are still flown."""
    scenario = loaded(scenario_toml)
    try:
        return replace(row_of(land(scenario, seed)), outside_envelope=outside(scenario.members))
    except ConfigError as error:
        return error_row(seed, str(error))
    except Exception as error:
        own = next(filter(None, (failed_in(each.onboard.filter, error) for each in scenario.members)), "")
        return error_row(seed, own or f"{type(error).__name__}: {error}")
    finally:
        gc.collect()  # collect between landings, never during a landing


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


def fly_here(
    scenario_toml: str, seeds: Iterable[int], workers: int, duration_max_s: float, given: bytes = b""
) -> Iterator[Row]:
    """Yield the rows of these seeds as they arrive, in any order, from processes on this machine.

    ``scenario_toml``: the scenario as text; ``duration_max_s``: longest landing, simulated time; ``given``:
    pickled class of a filter that is in no module, for processes that are not forked.
    Raises WorkersError: the processes end before they fly anything.
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
    loaded(scenario_toml)
    quiet_garbage_collector()
