"""Supervisor: arming, set-point watchdog, tumble detection; a table holds the transitions.

The table follows firmware supervisor.c and supervisor_state_machine.c (2026.08) of a build that requires
arming; it is evaluated at 25 Hz. Omitted are the checks before arming, the spin-up (here part of DISARMED),
the emergency stop, deck faults, and the intermediate states before DISARMED and LOCKED. A disarm command
acts immediately and also ends CRASHED; the firmware has a separate request to end CRASHED.

In flight, compiled code evaluates the table in numeric form, where a state is its index in ``STATES``.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Record

PERIOD_MS = 40  # period of the supervisor, 25 Hz
WARNING_MS = 500  # set-point age that starts levelling, ms; supervisor.c: COMMANDER_WDT_TIMEOUT_STABILIZE
TIMEOUT_MS = 2000  # set-point age that causes LOCKED, ms; supervisor.c: COMMANDER_WDT_TIMEOUT_SHUTDOWN
FLYING_HYSTERESIS_MS = 2000  # idle time that ends a flight, ms; IS_FLYING_HYSTERESIS_THRESHOLD
READY_TIMEOUT_MS = 30_000  # preflight time-out of platform_defaults.h, ms
LANDED_TIMEOUT_MS = 3000  # landing time-out of platform_defaults.h, ms
TUMBLE_TILTED_G, TUMBLE_TILTED_MS = 0.5, 1000  # tilted: body z reads less than this, g; allowed time, ms
TUMBLE_UPSIDE_DOWN_G, TUMBLE_UPSIDE_DOWN_MS = -0.2, 100
FREE_FALL_G = 0.1  # limit of the readings in free fall, g; free fall resets the tumble timer (supervisor.c)


class State(Enum):
    """States of the supervisor; the value is the text in the log."""

    DISARMED = "disarmed"
    READY = "armed, ready to fly"
    FLYING = "flying"
    LEVEL_OUT = "set-points too old: levelling out"
    LANDED = "landed, motors off"
    LOCKED = "locked: set-points stopped in flight; reboot required"
    CRASHED = "crashed: tumbled; disarm first"


# conditions of transitions, one bit each
TIMEOUT, WARNING, FRESH, TUMBLED, FLYING, NOT_FLYING, STAYED_READY, STAYED_LANDED = (1 << n for n in range(8))

# transitions of each state; the first true condition applies
TRANSITIONS: dict[State, tuple[tuple[int, State], ...]] = {
    State.DISARMED: (),
    State.READY: ((TUMBLED, State.DISARMED), (FLYING, State.FLYING), (STAYED_READY, State.DISARMED)),
    State.FLYING: (
        (TIMEOUT, State.LOCKED),
        (TUMBLED, State.CRASHED),
        (WARNING, State.LEVEL_OUT),
        (NOT_FLYING, State.LANDED),
    ),
    State.LEVEL_OUT: ((TIMEOUT, State.LOCKED), (TUMBLED, State.LOCKED), (FRESH, State.FLYING)),
    State.LANDED: ((STAYED_LANDED, State.DISARMED), (FLYING, State.FLYING)),
    State.LOCKED: (),
    State.CRASHED: (),
}
MOTORS_ALLOWED = frozenset({State.READY, State.FLYING, State.LEVEL_OUT, State.LANDED})

STATES = tuple(State)
_WIDEST = max(map(len, TRANSITIONS.values()))
_TABLE = np.zeros((len(STATES), _WIDEST, 2), dtype=np.int64)  # condition (0: never) and next state
for _state, _row in TRANSITIONS.items():
    for _n, (_condition, _to) in enumerate(_row):
        _TABLE[STATES.index(_state), _n] = _condition, STATES.index(_to)
_ALLOWED = np.array([state in MOTORS_ALLOWED for state in STATES])
_LEVEL_OUT, _IN_FLIGHT = STATES.index(State.LEVEL_OUT), STATES.index(State.FLYING)
# value of ``tilted_since_ms`` without a tilt
_UPRIGHT = -1 << 62


class SupervisorRecord(Record):
    """State and times, in milliseconds of simulated time."""

    state: int
    since_ms: int
    motors_last_ms: int
    tilted_since_ms: int
    motors_allowed: bool
    level: bool  # whether zero roll and pitch are commanded; the vertical set-point remains (supervisor.c)


@jitted
def enter(s: SupervisorRecord, state: int, now_ms: int) -> None:
    s.state, s.since_ms = state, now_ms
    s.motors_allowed, s.level = _ALLOWED[state], state == _LEVEL_OUT


@jitted
def flies(s: SupervisorRecord) -> bool:
    """Whether the supervisor considers the vehicle flying (supervisor.c: isFlying)."""
    return s.state == _IN_FLIGHT or s.state == _LEVEL_OUT


@jitted
def tumbled(s: SupervisorRecord, now_ms: int, ax: float, ay: float, az: float) -> bool:
    """Whether the vehicle is inverted or tilted for too long (supervisor.c: isTumbledCheck)."""
    if abs(ax) < FREE_FALL_G and abs(ay) < FREE_FALL_G and abs(az) < FREE_FALL_G:
        s.tilted_since_ms = _UPRIGHT
    if az >= TUMBLE_TILTED_G:
        s.tilted_since_ms = _UPRIGHT
        return False
    if s.tilted_since_ms == _UPRIGHT:
        s.tilted_since_ms = now_ms
    lasts_ms = now_ms - s.tilted_since_ms
    upside_down = az < TUMBLE_UPSIDE_DOWN_G and lasts_ms > TUMBLE_UPSIDE_DOWN_MS
    return upside_down or lasts_ms > TUMBLE_TILTED_MS


@jitted
def supervise(
    s: SupervisorRecord, now_ms: int, setpoint_age_ms: int, motors_running: bool, ax: float, ay: float,
    az: float,
) -> None:  # fmt: skip
    """Evaluate the transitions; call it every ``PERIOD_MS`` with the accelerometer's reading in g."""
    if motors_running:
        s.motors_last_ms = now_ms
    flying = now_ms - s.motors_last_ms < FLYING_HYSTERESIS_MS
    holds = FLYING if flying else NOT_FLYING
    holds |= WARNING if setpoint_age_ms > WARNING_MS else FRESH
    if setpoint_age_ms > TIMEOUT_MS:
        holds |= TIMEOUT
    if tumbled(s, now_ms, ax, ay, az):
        holds |= TUMBLED
    stayed_ms = now_ms - s.since_ms
    if stayed_ms > READY_TIMEOUT_MS:
        holds |= STAYED_READY
    if stayed_ms > LANDED_TIMEOUT_MS:
        holds |= STAYED_LANDED
    for i in range(_WIDEST):
        if _TABLE[s.state, i, 0] & holds:
            enter(s, _TABLE[s.state, i, 1], now_ms)
            return


def restart(s: SupervisorRecord) -> None:
    """Set the state that follows power-on."""
    enter(s, STATES.index(State.DISARMED), 0)
    s.motors_last_ms, s.tilted_since_ms = -FLYING_HYSTERESIS_MS - 1, _UPRIGHT


def start_flying(s: SupervisorRecord) -> None:
    """Start with an armed vehicle in the air at time zero."""
    s.motors_last_ms = 0
    enter(s, STATES.index(State.FLYING), 0)


def arm(s: SupervisorRecord, now_ms: int) -> str | None:
    """Arm the vehicle; return None, or the reason of the rejection."""
    if s.motors_allowed:
        return None
    state = STATES[s.state]
    if state is not State.DISARMED:
        return str(state.value)
    s.motors_last_ms, s.tilted_since_ms = now_ms - FLYING_HYSTERESIS_MS - 1, _UPRIGHT
    enter(s, STATES.index(State.READY), now_ms)
    return None


def disarm(s: SupervisorRecord, now_ms: int) -> None:
    """Disarm immediately; a locked vehicle remains locked."""
    if STATES[s.state] not in (State.DISARMED, State.LOCKED):
        enter(s, STATES.index(State.DISARMED), now_ms)
