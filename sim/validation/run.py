"""Compares the simulator with each flight of a folder, in worker processes.

A flight that cannot be read or used is listed with its reasons and not compared.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path
from zlib import crc32

from flightstack.common.processes import LaunchError
from sim.flights.recording import COLUMNS, Group, RecordingError, read_columns
from sim.flights.screening import Reason, load
from sim.options import ValidateOptions
from sim.plant.params import Params
from sim.plant.params import load as load_vehicle
from sim.validation import closed_loop, open_loop, sensing
from sim.validation.closed_loop import ClosedLoop
from sim.validation.open_loop import OpenLoop
from sim.validation.sensing import Sensing

VEHICLE = "crazyflie21_room"  # vehicle of the recorded flights with which the project was compared


@dataclass(frozen=True)
class Compared:
    """Comparison of one flight with the simulator."""

    name: str  # name of the file without suffix
    used_s: float  # compared time; 0 if the flight is left out
    left_out: tuple[Reason, ...]  # unused parts, or the whole flight, with the reasons
    # Results; None: the flight is left out or lacks the required columns.
    open_loop: OpenLoop | None = None
    closed_loop: ClosedLoop | None = None
    sensing: Sensing | None = None
    shuffled: OpenLoop | None = None  # open loop with the motor commands in random order

    @property
    def used(self) -> bool:
        return self.used_s > 0.0


def compare(path: Path, columns: dict[str, Group], params: Params, options: ValidateOptions) -> Compared:
    """Compare one flight; the random numbers depend only on the flight's name and the seed."""
    try:
        flight = load(path, columns)
    except RecordingError as error:
        return Compared(path.stem, 0.0, (Reason(str(error), 0.0),))
    if not flight.usable:
        return Compared(path.stem, 0.0, flight.left_out)
    seed = options.seed + crc32(path.stem.encode())
    return Compared(
        path.stem,
        flight.seconds,
        flight.left_out,
        open_loop.compare(flight, params),
        closed_loop.fly(flight, params, seed),
        sensing.compare(flight, seed),
        open_loop.compare(flight, params, shuffle_seed=seed + 1),
    )


def run(
    options: ValidateOptions, paths: Sequence[Path], workers: int, on_flight: Callable[[Compared], None]
) -> list[Compared]:
    """Compare flights in ``workers`` processes; the result is sorted by name.

    ``on_flight``: called with each compared flight, in any order.
    Raises RecordingError: the table of columns is wrong; ConfigError: the vehicle's file is wrong;
    LaunchError: a process was killed.
    """
    columns, params = read_columns(options.columns or COLUMNS), load_vehicle(options.vehicle or VEHICLE)
    done: list[Compared] = []
    for one in _each(partial(compare, columns=columns, params=params, options=options), paths, workers):
        on_flight(one)
        done.append(one)
    return sorted(done, key=lambda one: one.name)


def _each(work: Callable[[Path], Compared], paths: Sequence[Path], workers: int) -> Iterator[Compared]:
    """Yield results as they arrive; Ctrl-C ends the processes immediately."""
    if workers == 1 or len(paths) <= 1:
        yield from map(work, paths)
        return
    try:
        pool = ProcessPoolExecutor(
            min(workers, len(paths)), get_context("spawn"), initializer=signal.signal,
            initargs=(signal.SIGINT, signal.SIG_IGN),
        )  # fmt: skip
    except (OSError, NotImplementedError) as error:  # no semaphores: /dev/shm is missing or read-only
        print(f"validate: one process instead of {workers}: no shared memory ({error})", file=sys.stderr)
        yield from map(work, paths)
        return
    try:
        for future in as_completed([pool.submit(work, path) for path in paths]):
            yield future.result()
    except BrokenProcessPool:
        raise LaunchError("a worker process was killed; is the machine out of memory?") from None
    except BaseException:
        for process in active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
