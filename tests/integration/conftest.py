"""Provides lockstep flights that several tests read; the first worker that needs a flight flies it."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

from tests.integration.runs import Result, fly


@dataclass
class Flown(Result):
    """A finished run and its folder, which tests share: read only."""

    folder: Path

    @property
    def log(self) -> Path:
        return self.folder / "flight.mcap"


Flights = Callable[..., Flown]


@pytest.fixture(scope="session")
def flown(tmp_path_factory) -> Flights:
    """Return a function ``flown(scenario, seed, *options)``, which reuses the flights of all workers."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # folder that is common to all workers of this session
    base = base / "flown"
    base.mkdir(exist_ok=True)

    def get(scenario: str, seed: int = 0, *options: str) -> Flown:
        name = "_".join([scenario, str(seed), *options]).replace("/", "_")
        folder, told = base / name, base / f"{name}.json"
        with (base / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # runs have time-outs, so this wait is bounded
            if not told.exists():
                told.write_text(json.dumps(asdict(fly(folder, scenario, seed, *options))))
        return Flown(**json.loads(told.read_text()), folder=folder)

    return get
