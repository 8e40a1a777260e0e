"""Error tapes: errors of the on-board estimate in recorded flights, sample by sample.

The estimate follows the true path with a varying delay. Each error is therefore split into this delay and a
remainder, and both can be replayed on any path.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from sim.flights.recording import Floats, Recording, RecordingError, find_recordings, read_columns
from sim.flights.screening import Screened, load

FLIGHTS = "FLIGHTSTACK_FLIGHTS"  # environment variable with the folder of recorded flights
DELAY_S = (-0.1, 0.2)  # range of an estimate's delay; outside it the clocks differ
SPEED_MIN_M_S = 0.3  # rms speed below which a delay has no visible effect
SLOW_M_S = 0.1  # speed below which the flight's mean delay is used, and the remaining error is an offset
STILL_M_S = (0.16, 0.54)  # speeds s in: error along / across the velocity = fraction * (speed + s); fitted
CUT_S = 0.3  # time cut from both ends of a segment, s: there the delayed truth is outside the segment


@dataclass(frozen=True, slots=True)
class Piece:
    """Errors of n successive samples; on the recorded path they reproduce the recorded estimate."""

    delay_s: Floats  # (n,) delay of the position behind the truth
    velocity_delay_s: Floats  # (n,) delay of the velocity behind the truth
    position_m: Floats  # (n, 3) remaining position error, world axes
    along: Floats  # (n,) error along the horizontal velocity, divided by (speed + ``STILL_M_S[0]``)
    across: Floats  # (n,) error to the left of it, divided by (speed + ``STILL_M_S[1]``)
    velocity_m_s: Floats  # (n, 3) remaining velocity error, world axes
    # (n, 3) rotation vector from true to estimated attitude, body FLU: mean of the flight. The measured
    # variation is larger than a gyro's, so it comes from motion capture and log.
    turn_rad: Floats
    speed_m_s: Floats  # (n,) recorded horizontal speed


@dataclass(frozen=True, slots=True)
class Tape:
    """Errors of one flight, in segments without a gap."""

    name: str
    step_s: float  # time between samples, s
    pieces: tuple[Piece, ...]  # errors in spans without a gap, one or more


def tape_of(flight: Screened) -> Tape | None:
    """Return the error tape of a flight; None if it has no estimate, is too slow or too short."""
    r = flight.recording
    if r.estimate_position_m is None or r.estimate_velocity_m_s is None:
        return None
    cut = round(CUT_S / r.step_s)
    inner = [slice(p.start + cut, p.stop - cut) for p in flight.pieces if p.stop - p.start > 4 * cut]
    inner = [p for p in inner if np.all(np.isfinite(r.estimate_velocity_m_s[p]))]
    if not inner:
        return None
    speed_m_s = np.linalg.norm(np.concatenate([r.velocity_m_s[p] for p in inner]), axis=1)
    if np.sqrt(np.mean(speed_m_s**2)) < SPEED_MIN_M_S:
        return None
    turn = _turn_rad(r, inner)
    mean_s = _delay_s(r.position_m, r.estimate_position_m, inner, r.step_s)
    velocity_mean_s = _delay_s(r.velocity_m_s, r.estimate_velocity_m_s, inner, r.step_s)
    return Tape(r.name, r.step_s, tuple(_split(r, p, mean_s, velocity_mean_s, turn) for p in inner))


def _split(r: Recording, piece: slice, mean_s: float, velocity_mean_s: float, turn: Floats) -> Piece:
    assert r.estimate_position_m is not None
    assert r.estimate_velocity_m_s is not None
    velocity = r.velocity_m_s[piece]
    other = r.estimate_position_m[piece] - r.position_m[piece] + mean_s * velocity
    delay = mean_s - (other * velocity).sum(axis=1) / ((velocity**2).sum(axis=1) + SLOW_M_S**2)
    delay = np.clip(delay, *DELAY_S)
    position = r.estimate_position_m[piece] - _earlier(r.position_m, piece, delay / r.step_s)
    velocity_delay = np.full_like(delay, velocity_mean_s)
    velocity = _earlier(r.velocity_m_s, piece, velocity_delay / r.step_s)
    error = r.estimate_velocity_m_s[piece] - velocity
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    x, y = np.where(speed > 0.0, velocity[:, :2].T / np.maximum(speed, 1e-12), [[1.0], [0.0]])
    along = (error[:, 0] * x + error[:, 1] * y) / (speed + STILL_M_S[0])
    across = (error[:, 1] * x - error[:, 0] * y) / (speed + STILL_M_S[1])
    error[:, :2] = 0.0
    return Piece(
        delay,
        velocity_delay,
        position,
        along,
        across,
        error,
        np.tile(turn, (len(delay), 1)),
        _speed(r, piece),
    )


def _delay_s(truth: Floats, estimate: Floats, pieces: list[slice], step_s: float) -> float:
    """Return the constant delay of an estimate that fits best, s."""

    def misfit(delay_s: float) -> float:
        left = [estimate[p] - _earlier(truth, p, np.asarray(delay_s / step_s)) for p in pieces]
        centred = np.concatenate(left)
        return float(np.sum((centred - centred.mean(axis=0)) ** 2))

    return float(minimize_scalar(misfit, bounds=DELAY_S, method="bounded", options={"xatol": 5e-4}).x)


def _earlier(values: Floats, piece: slice, samples: Floats) -> Floats:
    """Return the values that are ``samples`` earlier than each sample of a segment, interpolated linearly."""
    at = np.arange(piece.start, piece.stop) - samples
    return np.stack([np.interp(at, np.arange(len(values)), column) for column in values.T], axis=1)


def _speed(r: Recording, piece: slice) -> Floats:
    speed: Floats = np.linalg.norm(r.velocity_m_s[piece, :2], axis=1)
    return speed


def _turn_rad(r: Recording, pieces: list[slice]) -> Floats:
    """Return the mean rotation from true to estimated attitude, (3,)."""
    if r.estimate_attitude_rad is None:
        return np.zeros(3)
    angles = np.concatenate([r.estimate_attitude_rad[p] for p in pieces])
    true = Rotation.from_quat(np.concatenate([r.attitude[p] for p in pieces]), scalar_first=True)
    turn: Floats = (true.inv() * Rotation.from_euler("ZYX", angles[:, ::-1])).as_rotvec().mean(axis=0)
    return turn


@cache
def read_tape(path: Path) -> Tape | None:
    """Return the error tape of a recorded flight, cached in the process; None: see ``tape_of``.

    Raises RecordingError: the file cannot be read, or has other columns or units.
    """
    return tape_of(load(path, read_columns()))


def draw_tape(folder: Path, rng: np.random.Generator) -> Tape:
    """Draw flights until a flight gives a tape; do not read the remaining flights.

    Raises RecordingError: the folder does not exist, or no flight in it gives a tape.
    """
    paths = find_recordings(folder)
    why = "none has an estimate and moves"
    for number in rng.permutation(len(paths)).tolist():
        try:
            tape = read_tape(paths[number])
        except RecordingError as error:
            why = f"{paths[number].name}: {error}"
            continue
        if tape is not None:
            return tape
    raise RecordingError(f"{folder}: found no flight for a tape among {len(paths)} files: {why}")


def tape_folder(name: str) -> Path:
    """Return the folder of a tape: ``name`` if it is a folder, else the folder in ``FLIGHTSTACK_FLIGHTS``.

    Raises RecordingError: neither is a folder.
    """
    folder, other = Path(name), os.environ.get(FLIGHTS, "")
    if folder.is_dir():
        return folder.resolve()
    if other and not folder.is_absolute() and Path(other).is_dir():
        return Path(other).resolve()
    raise RecordingError(
        f"tape: found no folder {name!r} with recorded flights beside the scenario or here, and "
        f"{FLIGHTS} is {'not set' if not other else repr(other)}; set it to the folder of the flights"
    )
