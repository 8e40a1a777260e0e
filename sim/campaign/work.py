"""The work of a campaign: one seed in, one row out; the same in a worker process and on a cluster."""

from __future__ import annotations

import gc
import hashlib
import threading
import tomllib
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from flightstack.common.pacing import quiet_garbage_collector
from flightstack.common.strict_toml import from_table
from sim.campaign.rows import Row, error_row, row_of
from sim.runners.landing import land
from sim.scenarios.scenario import Scenario
from sim.vehicle.vehicle import warm_up

_ALONE = threading.Lock()  # a cluster's worker may have threads; more than one would only wait for each other
_PACKAGES = ("flightstack", "bridge", "sim", "logs")


@lru_cache(maxsize=4)
def prepared(scenario_toml: str) -> Scenario:
    """Scenario from its text, with all code compiled; the collector then leaves alone what exists."""
    scenario = from_table(Scenario, tomllib.loads(scenario_toml))
    warm_up(scenario)
    quiet_garbage_collector()
    return scenario


def fly_seed(scenario_toml: str, seed: int) -> Row:
    """Fly one landing; an exception becomes a row, so that the other seeds are flown."""
    with _ALONE:
        scenario = prepared(scenario_toml)
        try:
            return row_of(land(scenario, seed))
        except Exception as error:
            return error_row(seed, f"{type(error).__name__}: {error}")
        finally:
            gc.collect()  # never within a landing


def fly_seed_as(code: str, scenario_toml: str, seed: int) -> Row:
    """Fly one landing on another machine; refuse if its code differs.

    Raises:
        RuntimeError: it is not.
    """
    here = code_fingerprint()
    if here != code:
        raise RuntimeError(f"other code on this worker: {here}, not {code}; install the same version")
    return fly_seed(scenario_toml, seed)


@lru_cache(maxsize=1)
def code_fingerprint() -> str:
    """Return the hash of the code that flies; rows of different versions must not be mixed."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        folder = Path(str(files(package)))
        for source in sorted([*folder.rglob("*.py"), *folder.rglob("*.toml")]):
            digest.update(f"{package}/{source.relative_to(folder).as_posix()}\n".encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]
