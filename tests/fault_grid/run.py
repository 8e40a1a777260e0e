"""Flies a cell of the fault grid, a landing with one fault, and returns its result."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from flightstack.core.mission.machine import aborts
from flightstack.core.types import Phase
from logs.reader.flight_data import Truth
from logs.schema.events import ContactBit
from logs.verdict.truth import LAND_AWAY_SPEED_MAX_M_S
from sim.scenarios.fault_spec import Fault, Kind, What
from sim.scenarios.scenario import Scenario, load
from tests.fault_grid.flight import Flight, Flown, Mangle
from tests.fault_grid.table import End, Moment, Part, Way

_OFFSET_M = (0.3, 0.0, 0.0)
_WHAT: Mapping[Part, What] = MappingProxyType(
    {
        Part.OWN_STATE: What.OWN_STATE,
        Part.TARGET_STATE: What.TARGET_ODOMETRY,
        Part.HEARTBEAT: What.HEARTBEAT,
        Part.SETPOINTS: What.SETPOINTS,
        Part.CLOCK: What.CLOCK,
    }
)
# fault values that differ from the defaults of the simulator's fault table
_VALUES: Mapping[tuple[Part, Way], Mapping[str, Any]] = MappingProxyType(
    {
        (Part.OWN_STATE, Way.WRONG): {"offset_m": _OFFSET_M},
        (Part.TARGET_STATE, Way.WRONG): {"offset_m": _OFFSET_M},
        (Part.HEARTBEAT, Way.DELAYED): {"value": 2.0},
        (Part.HEARTBEAT, Way.INTERMITTENT): {"value": 2.5, "period_s": 4.0},
    }
)


def fault(part: Part, way: Way) -> Fault:
    return Fault(_WHAT[part], Kind(way.value), **_VALUES.get((part, way), {}))


def disturb(part: Part, way: Way, seed: int) -> Callable[[Flight], None]:
    """Return a function that starts the fault of a cell in a flight."""
    if part is Part.ZENOH:
        return lambda flight: setattr(flight.target, "mangle", _mangle(way, np.random.default_rng(seed)))
    if part is Part.TARGET_STATE:
        return lambda flight: flight.target.fail(fault(part, way), flight.now_ns)
    return lambda flight: flight.vehicle.faults.fail([fault(part, way)], flight.now_ns)


def _mangle(way: Way, rng: np.random.Generator) -> Mangle:
    """Return the function that changes payloads sent over Zenoh as this kind of failure does."""
    first: list[bytes] = []
    held: list[tuple[float, bytes]] = []
    number = itertools.count(1)
    lost, until_s = False, 0.0

    def damaged(payload: bytes) -> bytes:
        at, other = int(rng.integers(len(payload))), int(rng.integers(1, 256))
        return payload[:at] + bytes((payload[at] ^ other,)) + payload[at + 1 :]

    def mangle(payloads: list[bytes], now_s: float) -> list[bytes]:
        nonlocal held, lost, until_s
        match way:
            case Way.STUCK:  # repeat the first payload instead of each later payload
                first.extend(payloads[: 1 - len(first)])
                return first * len(payloads)
            case Way.GARBAGE:  # change one byte of each payload
                return [damaged(payload) for payload in payloads]
            case Way.WRONG:  # change the target's frame name to that of another robot, under the same key
                return [payload.replace(b"target\0", b"nearby\0") for payload in payloads]
            case Way.SLOW:
                return [payload for payload in payloads if next(number) % 10 == 0]
            case Way.DELAYED:  # delay all by 0.2 s; a delay of 0.23 s for a random tenth changes the order
                held += [(now_s + 0.2 + (0.03 if rng.random() < 0.1 else 0.0), each) for each in payloads]
                due = [payload for at_s, payload in held if at_s <= now_s]
                held = [one for one in held if one[0] > now_s]
                return due
            case Way.INTERMITTENT:  # lose payloads for 0.3 s, pass them on for 1 s (means of random times)
                while now_s >= until_s:
                    lost = not lost
                    until_s = max(until_s, now_s) + rng.exponential(0.3 if lost else 1.0)
                return [] if lost else payloads
        return []  # Way.OFF: all payloads are lost

    return mangle


SCENARIO = "grid"
SEED = 1
UPRIGHT = 0.9  # lower limit of the tilt's cosine for an upright vehicle


@dataclass(frozen=True)
class Result:
    """Result of a cell; times in s since the fault, NaN for events that did not occur."""

    end: End
    noticed_s: float  # time until the first of: phase HOLD, CLIMB or ABORT; fail-safe of the autopilot
    down_s: float  # time until the motors were finally off
    h_min_m: float  # lowest true h outside the pad while the companion flew; NaN: no landing started
    flown: Flown


def scenario() -> Scenario:
    return load(SCENARIO)


def fly(part: Part, way: Way, moment: Moment, seed: int = SEED) -> Result:
    flown = Flight(scenario(), seed, AT[moment], disturb(part, way, seed)).fly()
    return Result(end_of(flown), flown.noticed_s, flown.down_s, h_min(flown), flown)


@lru_cache(maxsize=4)
def undisturbed(moment: Moment, seed: int) -> Flown:
    """Return the flight for ``moment`` and ``seed`` without a fault."""
    return Flight(scenario(), seed, AT[moment], lambda _: None).fly()


def equal(a: Truth, b: Truth) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True)
        for name in ("t_s", "position_enu_m", "velocity_enu_m_s", "orientation", "motors_running", "contacts")
    )


AT = {
    Moment.TAKEOFF: lambda flight: flight.climbing,
    **{m: (lambda flight, m=m: flight.phase is m.value) for m in Moment if m is not Moment.TAKEOFF},
}


def end_of(flown: Flown) -> End:
    """Return how a flight ended, from its true states."""
    truth = flown.truth
    if truth.motors_running[-1]:
        return End.FLYING
    x, y, _, _ = truth.orientation[-1]
    upright = 1.0 - 2.0 * (x * x + y * y) > UPRIGHT
    tumbled = bool(np.any(truth.contacts & ContactBit.TUMBLED))
    if tumbled or not upright or impact(truth) > LAND_AWAY_SPEED_MAX_M_S:
        return End.CRASHED
    last = int(truth.contacts[-1])
    if last & ContactBit.PAD and truth.d_m[-1] <= flown.seen.pad_radius_m:
        return End.LANDED
    if not last & ContactBit.GROUND or np.any(truth.contacts & (ContactBit.ROBOT | ContactBit.PAD_EDGE)):
        return End.CRASHED
    if flown.failsafe:
        return End.VEHICLE_LANDS
    return End.ABORTED if Phase.ABORT in flown.phases else End.MISSED


def impact(truth: Truth) -> float:
    """Return the highest sink rate just before any contact, m/s."""
    touching = truth.contacts != 0
    began = np.flatnonzero(touching[1:] & ~touching[:-1])
    return float(max(0.0, *-truth.velocity_enu_m_s[began, 2])) if len(began) else 0.0


def h_min(flown: Flown) -> float:
    """Return the lowest true h outside the pad until a fail-safe of the autopilot, until an abort that lands
    at once, or until the vehicle has flown clear after another abort; NaN: no landing started."""
    truth, start_s = flown.truth, flown.seen.landing_start_s
    if start_s is None:
        return math.nan
    until_s = flown.disturbed_at_s + flown.failsafe_s if flown.failsafe else math.inf
    abort = next((event for event in flown.seen.events if aborts(event.text)), None)
    if abort is not None and abort.text.endswith("(fly clear)"):
        clear_m = flown.seen.config.checks.clearance_m
        away = truth.t_s[(truth.t_s > abort.t_s) & (truth.d_m > clear_m)]
        until_s = min(until_s, *away[:1])
    elif abort is not None:
        until_s = min(until_s, abort.t_s)
    h = truth.h_min_outside_pad_m[(truth.t_s > start_s) & (truth.t_s <= until_s)]
    h = h[np.isfinite(h)]
    return float(h.min()) if len(h) else math.nan
