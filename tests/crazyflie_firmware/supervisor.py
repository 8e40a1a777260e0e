"""Model of the firmware's supervisor (supervisor.c, supervisor_state_machine.c of 2026.08), at 25 Hz."""

from enum import Enum, auto

PERIOD_S = 0.04
WARN_S, TIMEOUT_S = 0.5, 2.0  # set-point ages at which the vehicle levels out, and stops the motors, s
FLYING_S = 2.0  # idle time of the motors after which the vehicle does not count as flying, s
LANDED_S, PREFLIGHT_S = 3.0, 30.0


class State(Enum):
    """States of the supervisor, with the names of the firmware."""

    CHECKS_FAILED = auto()
    CHECKS_PASSED = auto()
    ARMING = auto()
    READY = auto()
    FLYING = auto()
    LANDED = auto()
    RESET = auto()
    LEVEL_OUT = auto()
    FREE_FALL = auto()
    LOCKED = auto()
    CRASHED = auto()


MAY_RUN = frozenset({State.READY, State.FLYING, State.LANDED, State.LEVEL_OUT})
ARMED = MAY_RUN | {State.ARMING}


class Supervisor:
    """State machine of arming, flying and locking.

    ``setpoints_rule``: a set-point from the radio has stopped the high-level commander (bit 10);
    ``deck_fault``: a deck fault, which ends a flight (bit 11).
    """

    def __init__(self, auto_arm: bool) -> None:
        self.auto_arm = auto_arm
        self.state = State.CHECKS_FAILED
        self.armed = self.crashed = False
        self.tumbled = self.emergency = self.deck_fault = self.setpoints_rule = False
        self.checks_pass = True
        self.history: list[tuple[float, State]] = []
        self._motors_s = -1e9
        self._since_s = 0.0

    @property
    def motors_may_run(self) -> bool:
        return self.state in MAY_RUN

    @property
    def info(self) -> int:
        bits = (
            self.state is State.CHECKS_PASSED, self.armed, self.auto_arm, self.motors_may_run,
            self.state in (State.FLYING, State.LEVEL_OUT), self.tumbled, self.state is State.LOCKED,
            self.crashed, False, True, self.setpoints_rule, self.deck_fault,
        )  # fmt: skip
        return sum(1 << i for i, bit in enumerate(bits) if bit)

    def request(self, arm: bool) -> bool:
        if arm == self.armed:
            return True
        if arm and self.state is not State.CHECKS_PASSED:
            return False
        self.armed = arm
        return True

    def recover(self) -> bool:
        """Recover from a crash; reject the request if the vehicle lies on its back."""
        self.crashed = self.crashed and self.tumbled
        return not self.crashed

    def step(self, now_s: float, setpoint_age_s: float, motors_run: bool) -> None:
        if motors_run:
            self._motors_s = now_s
        flying = now_s - self._motors_s < FLYING_S
        new = self._next(now_s, setpoint_age_s, flying)
        if new is not self.state:
            self.state, self._since_s = new, now_s
            self.history.append((now_s, new))
            self.crashed = self.crashed or new is State.CRASHED
            if new not in ARMED:
                self.armed = False
            if self.auto_arm and new is State.CHECKS_PASSED:
                self.armed = True

    def _next(self, now_s: float, age_s: float, flying: bool) -> State:
        s, old_s = State, now_s - self._since_s
        stop = (self.emergency, s.FREE_FALL)
        not_ready = (self.tumbled or not self.checks_pass, s.CHECKS_FAILED)
        rules = {
            s.CHECKS_FAILED: [stop, (not not_ready[0], s.CHECKS_PASSED)],
            s.CHECKS_PASSED: [stop, not_ready, (self.armed, s.ARMING)],
            s.ARMING: [stop, not_ready, (not self.armed, s.CHECKS_FAILED), (True, s.READY)],
            s.READY: [
                stop, not_ready, (not self.armed or old_s > PREFLIGHT_S, s.CHECKS_FAILED),
                (flying, s.FLYING),
            ],
            s.FLYING: [
                (age_s > TIMEOUT_S or self.emergency or self.deck_fault, s.FREE_FALL),
                (self.tumbled, s.CRASHED), (not self.armed, s.RESET), (age_s > WARN_S, s.LEVEL_OUT),
                (not flying, s.LANDED),
            ],
            s.LANDED: [(old_s > LANDED_S or not self.armed, s.RESET), (flying, s.FLYING)],
            s.LEVEL_OUT: [
                (age_s > TIMEOUT_S or self.tumbled or self.emergency, s.FREE_FALL),
                (age_s <= WARN_S, s.FLYING),
            ],
            s.FREE_FALL: [(True, s.LOCKED)],
            s.RESET: [(True, s.CHECKS_FAILED)],
            s.CRASHED: [(not self.crashed, s.CHECKS_FAILED)],
            s.LOCKED: [],
        }  # fmt: skip
        return next((to for condition, to in rules[self.state] if condition), self.state)
