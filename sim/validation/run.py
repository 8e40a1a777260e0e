"""Compares the simulator with each flight of a folder, in worker processes.

A flight that cannot be read or used is listed with its reasons and not compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from zlib import crc32

from flightstack.common.pool import in_processes
from sim.flights.recording import RecordingError
from sim.flights.screening import Reason, load
from sim.options import ValidateOptions
from sim.plant.params import Params
from sim.plant.params import load as load_vehicle
from sim.validation import closed_loop, open_loop, sensing
from sim.validation.closed_loop import ClosedLoop
from sim.validation.open_loop import OpenLoop
from sim.validation.sensing import Sensing


@dataclass(frozen=True)
class Compared:
    """Comparison of one flight with the simulator."""

    name: str  # name of the file without suffix
    used_s: float  # duration of the compared parts, s; 0 if the flight is left out
    left_out: tuple[Reason, ...]  # unused parts, or the whole flight, with the reasons
    # Results; None: the flight is left out or lacks the required columns.
    open_loop: OpenLoop | None = None
    closed_loop: ClosedLoop | None = None
    sensing: Sensing | None = None

    @property
    def used(self) -> bool:
        return self.used_s > 0.0


def compare(path: Path, params: Params, seed: int) -> Compared:
    """Compare one flight; the random numbers depend only on the flight's name and the seed."""
    try:
        flight = load(path)
    except RecordingError as error:
        return Compared(path.stem, 0.0, (Reason(str(error), 0.0),))
    if not flight.usable:
        return Compared(path.stem, 0.0, flight.left_out)
    seed += crc32(path.stem.encode())
    return Compared(
        path.stem,
        flight.seconds,
        flight.left_out,
        open_loop.compare(flight, params),
        closed_loop.fly(flight, params, seed),
        sensing.compare(flight, seed),
    )


def run(
    options: ValidateOptions, paths: Sequence[Path], workers: int, on_flight: Callable[[Compared], None]
) -> list[Compared]:
    """Compare flights in ``workers`` processes; the result is sorted by name.

    ``on_flight``: called with each compared flight, in any order.
    Raises ConfigError: the vehicle's file is wrong; WorkersError: no process starts.
    """
    work = partial(compare, params=load_vehicle(options.vehicle), seed=options.seed)
    alone = workers == 1 or len(paths) <= 1
    done: list[Compared] = []
    for one in map(work, paths) if alone else in_processes(work, paths, workers, _failed):
        on_flight(one)
        done.append(one)
    return sorted(done, key=lambda one: one.name)


def _failed(path: Path, why: str) -> Compared:
    return Compared(path.stem, 0.0, (Reason(why, 0.0),))
