"""Supervisor: arming, set-point watchdog, tumble detection; transitions as data.

After firmware supervisor.c and supervisor_state_machine.c (2026.08), evaluated at 25 Hz, of a build that
requires arming. Left out: the checks before arming and the spin-up (they count as DISARMED), emergency stop
and deck faults; what the firmware passes through on its way to DISARMED or LOCKED takes no time here. A
disarm takes effect at once and also ends CRASHED, for which the firmware has a request of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntFlag, auto

PERIOD_MS = 40  # SUPERVISOR 25 Hz
WARNING_MS = 500  # supervisor.c: COMMANDER_WDT_TIMEOUT_STABILIZE
TIMEOUT_MS = 2000  # supervisor.c: COMMANDER_WDT_TIMEOUT_SHUTDOWN
FLYING_HYSTERESIS_MS = 2000  # supervisor.c: IS_FLYING_HYSTERESIS_THRESHOLD
READY_TIMEOUT_MS = 30_000  # platform_defaults.h: preflight timeout
LANDED_TIMEOUT_MS = 3000  # platform_defaults.h: landing timeout
TUMBLE_TILTED_G, TUMBLE_TILTED_MS = 0.5, 1000  # platform_defaults.h
TUMBLE_UPSIDE_DOWN_G, TUMBLE_UPSIDE_DOWN_MS = -0.2, 100
FREE_FALL_G = 0.1  # supervisor.c: the clock starts anew while nothing is felt at all


class State(Enum):
    """States; the value is what the log says."""

    DISARMED = "disarmed"
    READY = "armed, ready to fly"
    FLYING = "flying"
    LEVEL_OUT = "set-points too old: levelling out"
    LANDED = "landed, motors off"
    LOCKED = "locked: set-points stopped in flight; reboot required"
    CRASHED = "crashed: tumbled; disarm first"


class Condition(IntFlag):
    """What the transitions look at."""

    TIMEOUT = auto()
    WARNING = auto()
    FRESH = auto()
    TUMBLED = auto()
    FLYING = auto()
    NOT_FLYING = auto()
    STAYED_READY = auto()
    STAYED_LANDED = auto()


# the first condition that holds decides
TRANSITIONS: dict[State, tuple[tuple[Condition, State], ...]] = {
    State.DISARMED: (),
    State.READY: (
        (Condition.TUMBLED, State.DISARMED),
        (Condition.FLYING, State.FLYING),
        (Condition.STAYED_READY, State.DISARMED),
    ),
    State.FLYING: (
        (Condition.TIMEOUT, State.LOCKED),
        (Condition.TUMBLED, State.CRASHED),
        (Condition.WARNING, State.LEVEL_OUT),
        (Condition.NOT_FLYING, State.LANDED),
    ),
    State.LEVEL_OUT: (
        (Condition.TIMEOUT, State.LOCKED),
        (Condition.TUMBLED, State.LOCKED),
        (Condition.FRESH, State.FLYING),
    ),
    State.LANDED: ((Condition.STAYED_LANDED, State.DISARMED), (Condition.FLYING, State.FLYING)),
    State.LOCKED: (),
    State.CRASHED: (),
}
MOTORS_ALLOWED = frozenset({State.READY, State.FLYING, State.LEVEL_OUT, State.LANDED})


@dataclass(slots=True)
class Supervisor:
    """State machine; times in milliseconds of simulated time."""

    state: State = State.DISARMED
    since_ms: int = 0
    motors_last_ms: int = -FLYING_HYSTERESIS_MS - 1
    tilted_since_ms: int | None = None
    history: list[tuple[int, State]] = field(default_factory=list)

    @property
    def motors_allowed(self) -> bool:
        """Whether the motors may turn."""
        return self.state in MOTORS_ALLOWED

    @property
    def level(self) -> bool:
        """Whether roll and pitch are held at zero; the vertical set-point stays (supervisor.c)."""
        return self.state is State.LEVEL_OUT

    def enter(self, state: State, now_ms: int) -> None:
        """Go to a state."""
        self.state, self.since_ms = state, now_ms
        self.history.append((now_ms, state))

    def arm(self, now_ms: int) -> str | None:
        """Arm; None if armed (already), else why not."""
        if self.motors_allowed:
            return None
        if self.state is not State.DISARMED:
            return str(self.state.value)
        self.motors_last_ms = now_ms - FLYING_HYSTERESIS_MS - 1
        self.tilted_since_ms = None
        self.enter(State.READY, now_ms)
        return None

    def disarm(self, now_ms: int) -> None:
        """Disarm at once. A locked vehicle stays locked."""
        if self.state is not State.DISARMED and self.state is not State.LOCKED:
            self.enter(State.DISARMED, now_ms)

    def update(
        self, now_ms: int, setpoint_age_ms: int, motors_running: bool, accel_g: tuple[float, ...]
    ) -> None:
        """Evaluate the transitions; call every ``PERIOD_MS`` with the accelerometer's reading in g."""
        if motors_running:
            self.motors_last_ms = now_ms
        flying = now_ms - self.motors_last_ms < FLYING_HYSTERESIS_MS
        holds = Condition.FLYING if flying else Condition.NOT_FLYING
        holds |= Condition.WARNING if setpoint_age_ms > WARNING_MS else Condition.FRESH
        if setpoint_age_ms > TIMEOUT_MS:
            holds |= Condition.TIMEOUT
        if self._tumbled(now_ms, accel_g):
            holds |= Condition.TUMBLED
        stayed = now_ms - self.since_ms
        if stayed > READY_TIMEOUT_MS:
            holds |= Condition.STAYED_READY
        if stayed > LANDED_TIMEOUT_MS:
            holds |= Condition.STAYED_LANDED
        for condition, state in TRANSITIONS[self.state]:
            if condition & holds:
                self.enter(state, now_ms)
                return

    def _tumbled(self, now_ms: int, accel_g: tuple[float, ...]) -> bool:
        """Upside down counts from when it was tilted first (supervisor.c: isTumbledCheck)."""
        ax, ay, az = accel_g
        if abs(ax) < FREE_FALL_G and abs(ay) < FREE_FALL_G and abs(az) < FREE_FALL_G:
            self.tilted_since_ms = None
        if az >= TUMBLE_TILTED_G:
            self.tilted_since_ms = None
            return False
        if self.tilted_since_ms is None:
            self.tilted_since_ms = now_ms
        lasts_ms = now_ms - self.tilted_since_ms
        upside_down = az < TUMBLE_UPSIDE_DOWN_G and lasts_ms > TUMBLE_UPSIDE_DOWN_MS
        return upside_down or lasts_ms > TUMBLE_TILTED_MS
