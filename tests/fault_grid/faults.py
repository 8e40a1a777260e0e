"""How each part is made to fail in each way."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from sim.scenarios.fault_spec import Fault
from sim.scenarios.fault_table import Kind, What
from tests.fault_grid.flight import Flight, Mangle
from tests.fault_grid.words import Part, Way

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
# where the defaults of the simulator's table are not the point
_VALUES: Mapping[tuple[Part, Way], Mapping[str, Any]] = MappingProxyType(
    {
        (Part.OWN_STATE, Way.WRONG): {"offset_m": _OFFSET_M},
        (Part.TARGET_STATE, Way.WRONG): {"offset_m": _OFFSET_M},
        (Part.HEARTBEAT, Way.DELAYED): {"value": 2.0},
        (Part.HEARTBEAT, Way.INTERMITTENT): {"value": 2.5, "period_s": 4.0},
    }
)


def fault(part: Part, way: Way) -> Fault:
    """Fault of the simulator."""
    return Fault(_WHAT[part], Kind(way.value), **_VALUES.get((part, way), {}))


def disturb(part: Part, way: Way, seed: int) -> Callable[[Flight], None]:
    """What begins the fault in a flight."""
    if part is Part.ZENOH:
        return lambda flight: setattr(flight, "mangle", _MANGLES[way](np.random.default_rng(seed)))
    if part is Part.TARGET_STATE:
        return lambda flight: flight.target.fail(fault(part, way), flight.now_ns)
    return lambda flight: flight.vehicle.faults.fail([fault(part, way)], flight.now_ns)


def _off(rng: np.random.Generator) -> Mangle:
    del rng
    return lambda payloads, now_s: []


def _stuck(rng: np.random.Generator) -> Mangle:
    """The first payload again whenever one should come."""
    del rng
    first: list[bytes] = []

    def mangle(payloads: list[bytes], now_s: float) -> list[bytes]:
        first.extend(payloads[: 1 - len(first)])
        return first * len(payloads)

    return mangle


def _garbage(rng: np.random.Generator) -> Mangle:
    """One byte of each payload is another."""

    def mangle(payloads: list[bytes], now_s: float) -> list[bytes]:
        out = []
        for payload in payloads:
            at, other = int(rng.integers(len(payload))), int(rng.integers(1, 256))
            out.append(payload[:at] + bytes((payload[at] ^ other,)) + payload[at + 1 :])
        return out

    return mangle


def _wrong(rng: np.random.Generator) -> Mangle:
    """Another robot speaks under the key."""
    del rng
    return lambda payloads, now_s: [payload.replace(b"target\0", b"nearby\0") for payload in payloads]


def _slow(rng: np.random.Generator) -> Mangle:
    del rng
    count = [0]

    def mangle(payloads: list[bytes], now_s: float) -> list[bytes]:
        out = []
        for payload in payloads:
            count[0] += 1
            if count[0] % 10 == 0:
                out.append(payload)
        return out

    return mangle


def _delayed(rng: np.random.Generator) -> Mangle:
    """0.2 s late, and each tenth 30 ms later still, so that others pass it."""
    held: deque[tuple[float, bytes]] = deque()

    def mangle(payloads: list[bytes], now_s: float) -> list[bytes]:
        for payload in payloads:
            held.append((now_s + 0.2 + (0.03 if rng.random() < 0.1 else 0.0), payload))
        due = [payload for at_s, payload in held if at_s <= now_s]
        rest = [one for one in held if one[0] > now_s]
        held.clear()
        held.extend(rest)
        return due

    return mangle


def _intermittent(rng: np.random.Generator) -> Mangle:
    """Lost in bursts of 0.3 s in the mean, every 1.3 s in the mean."""
    state = {"lost": False, "until_s": 0.0}

    def mangle(payloads: list[bytes], now_s: float) -> list[bytes]:
        while now_s >= state["until_s"]:
            state["lost"] = not state["lost"]
            state["until_s"] = max(state["until_s"], now_s) + rng.exponential(0.3 if state["lost"] else 1.0)
        return [] if state["lost"] else payloads

    return mangle


_MANGLES: Mapping[Way, Callable[[np.random.Generator], Mangle]] = MappingProxyType(
    {
        Way.OFF: _off,
        Way.STUCK: _stuck,
        Way.GARBAGE: _garbage,
        Way.WRONG: _wrong,
        Way.SLOW: _slow,
        Way.DELAYED: _delayed,
        Way.INTERMITTENT: _intermittent,
    }
)
