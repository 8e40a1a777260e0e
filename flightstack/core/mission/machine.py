"""State machine of the mission: timers, condition flags, transitions, kind of abort, end of the flight.

A ``Transition`` is a change of phase. Only ``Mission`` writes the phase and its data, and counts the retries:
each change from ``RETRY_FROM`` to ``RETRY_TO`` is a go-around.
The rules are tables (``phases.py``); ``guidance.py`` computes the command of a phase.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flightstack.core.memory import AbortWay, Memory
from flightstack.core.mission.conditions import (
    LANDED_SETTLE_S,
    Situation,
    climbed,
    condition_flags,
    flown_clear,
    high_enough_m,
    landing_flags,
    lasting_flags,
    target_below,
    time_flags,
)
from flightstack.core.mission.phases import (
    ABORT_TABLE,
    ORDINARY,
    START_LATE,
    TABLE,
    TIME_OVER,
    C,
    Rule,
    first,
)
from flightstack.core.numeric import NotOrdinary, hypot
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.snapshot import Relative, Snapshot
from flightstack.core.strategies.strategy import Filter
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.reserve import ReserveEstimate
from flightstack.core.target.track import TargetTrack
from flightstack.core.types import Landed, Mode, Operator, Phase, VehicleStatus

_PHASES = "|".join(Phase.__members__)
_ABORT = re.compile(rf"(?: *[0-9.]+ s  )?(?:(?:{_PHASES}) -> )?ABORT: ")
STANDING_S = 4.0  # contact time allowed in LAND, s; most vehicles move to the centre (h >= 0) in 3 s
SLIDING_TIME_S = 0.15  # prediction time of a slide, s: contact is detected after 0.1 s, motors stop in 0.05 s
ABORT_SETTLE_S = 1.0  # minimum time in an abort, s, in which a heartbeat (1 Hz) can report the end
PLACE_RADIUS_M = 0.1  # maximum distance from the place beside the target at which the landing starts, m
PLACE_SPEED_M_S = 0.15  # maximum horizontal speed at which a landing beside the target starts, m/s
DRIFT_CAUSES = (
    "usual causes: a twist in header.frame_id instead of child_frame_id, a heading that is off by 180 "
    "degrees, swapped axes"
)
RETRY_FROM = frozenset({Phase.HOLD, Phase.CLIMB, Phase.TOUCHDOWN})
RETRY_TO = frozenset({Phase.APPROACH, Phase.TAKEOFF})
_NOT_FLYING = frozenset({Landed.ON_GROUND, Landed.UNKNOWN})


# flags that ``Mission.stay`` computes in an ordinary tick
COMPUTED = (
    C.TARGET_KNOWN | C.RETRIES_LEFT | C.CLEAR | C.ARMED | C.EXTERNAL | C.STANDING | C.WAS_ARMED
    | C.WAS_EXTERNAL | C.STARTED | C.LANDING_TIME_OVER | C.PHASE_TIME_OVER | C.ON_PAD | C.OVER_PAD | C.TOUCH
    | C.DRIFTED | C.CHECK_FAILED | C.SET_OFF
)  # fmt: skip
# flags that no ordinary tick has: ``Controller.land`` leaves such a tick to ``Controller.step``
EXCLUDED = (
    C.EMERGENCY | C.ABORT_ASKED | C.OWN_LOST | C.LINK_LOST | C.TARGET_LOST | C.COMMAND_FAILED
    | C.NOT_FOLLOWING | C.NO_RESULT | C.TIRED | C.CUT_OFF | C.PAD_WANTED
)  # fmt: skip


def masks(phases: Collection[Phase]) -> NDArray[np.int64]:
    """Return required and blocking flags of all rules, (phase, rule, 2); -1 is padding that never fires.

    Raises ValueError: a rule of ``phases`` uses a flag that an ordinary tick neither computes nor excludes;
    compiled code would miss this flag.
    """
    found = np.full((len(Phase), max(map(len, TABLE.values())), 2), -1, dtype=np.int64)
    for phase, rules in TABLE.items():
        for k, rule in enumerate(rules):
            found[phase, k] = rule.when, rule.unless
            if phase in phases and (missed := (rule.when | rule.unless) & ~(COMPUTED | EXCLUDED)):
                names = ", ".join(each.name for each in C if missed & each)
                raise ValueError(
                    f"{phase.name}, {rule.reason!r}: found {names}; add the flag to COMPUTED if Mission.stay "
                    "computes it, or to EXCLUDED if Controller.land leaves a tick with it to Controller.step"
                )
    return found


_MASKS = masks(ORDINARY)  # ``TABLE`` as an array, for compiled code


class Transition(NamedTuple):
    """Change of the phase, or of the kind of abort."""

    before: Phase  # phase before the transition
    after: Phase  # phase after the transition; equal to ``before`` if only the kind of abort changes
    reason: str  # text of the rule, with the measured values of its conditions
    way: AbortWay = AbortWay.NONE  # kind of abort; ``NONE`` for all other phases

    @property
    def text(self) -> str:
        """Text of the transition in the log."""
        change = self.before.name if self.after is self.before else f"{self.before.name} -> {self.after.name}"
        way = f" ({self.way.name.lower().replace('_', ' ')})" if self.way is not AbortWay.NONE else ""
        return f"{change}: {self.reason}{way}"

    def timed_text(self, now_s: float) -> str:
        """Return the text for the terminal, with the time on the stack's clock."""
        return f"{now_s:8.2f} s  {self.text}"


def aborts(text: str) -> bool:
    """Whether a text of ``Transition.text`` or ``Transition.timed_text`` reports an abort or its kind."""
    return _ABORT.match(text) is not None


class Mission(Situation):
    """State machine of the phases of a flight; ``memory`` is its complete state."""

    def __init__(
        self, config: FlightConfig, strategy: Filter, track: TargetTrack, plausibility: Plausibility,
        reserve: ReserveEstimate,
    ) -> None:  # fmt: skip
        super().__init__(config, strategy, Memory())
        self._track, self._plausibility, self._reserve = track, plausibility, reserve

    def step(self, snapshot: Snapshot, *, command_failed: bool, now_s: float) -> Transition | None:
        """Advance by one tick; return the phase transition, or None."""
        memory, flags = self.memory, self.flags(snapshot, command_failed=command_failed, now_s=now_s)
        transition = (
            self._abort(flags) if memory.phase is Phase.ABORT else self._change(snapshot, flags, now_s)
        )
        self.progress(snapshot)
        return transition

    def flags(self, snapshot: Snapshot, *, command_failed: bool, now_s: float) -> int:
        """Run the timers, then return the condition flags of this tick; arguments as in ``step``."""
        self._remember(snapshot, now_s)
        memory, status, at = self.memory, snapshot.inputs.status, snapshot.relative
        standing = status is not None and status.landed is Landed.ON_GROUND
        if snapshot.good and at is not None:
            self.watch_contact(at, standing, now_s)
        elif memory.phase is Phase.TOUCHDOWN and not memory.contact:
            own_ok, target_ok = snapshot.own_ok, snapshot.target_ok
            # a lost target is assumed to remain at its last height
            stopped = own_ok and not target_ok and at is not None and self._stopped(at, now_s)
            memory.contact = stopped or (standing and not (own_ok and target_ok))
        return condition_flags(self, snapshot, command_failed, now_s)

    def watch_contact(self, at: Relative, standing: bool, now_s: float) -> None:
        """Detect whether the vehicle stands on the pad or, in TOUCHDOWN, has stood on it; inputs are good."""
        memory = self.memory
        if memory.phase is Phase.LAND:
            self._stands(at, standing, now_s)
            memory.contact = now_s - memory.contact_since_s >= STANDING_S
        elif memory.phase is Phase.TOUCHDOWN and not memory.contact:
            on_pad = self._above(at)
            memory.contact = (
                (self._stopped(at, now_s) and on_pad)
                or (on_pad and self._slides(at))
                or self._stands(at, standing, now_s)
            )

    def stay(self, at: Relative, now_s: float) -> None:
        """Run an ordinary tick: all inputs are good. Raise NotOrdinary if a rule of the phase fires."""
        memory, flies = self.memory, self.memory.phase is not Phase.LANDED
        memory.target_position_enu_m = at.target.position_enu_m
        memory.target_velocity_enu_m_s = at.target.velocity_enu_m_s
        memory.own_ok_s = now_s
        self.watch_contact(at, False, now_s)
        flags = lasting_flags(self, flies, flies, False) | time_flags(self, now_s)
        flags |= landing_flags(self, at, now_s, True, True)
        for rule in _MASKS[memory.phase.value]:
            if flags & rule[0] == rule[0] and not flags & rule[1]:
                raise NotOrdinary
        if not flies and now_s - memory.phase_since_s >= LANDED_SETTLE_S:
            raise NotOrdinary

    def finished(self, status: VehicleStatus | None, now_s: float) -> bool:
        """Whether the flight is over: the motors have been off for some time, or an abort lasts too long."""
        memory = self.memory
        in_phase_s = now_s - memory.phase_since_s
        if memory.phase is Phase.LANDED:
            return in_phase_s >= LANDED_SETTLE_S
        if memory.phase is not Phase.ABORT:
            return False
        over = status is None or self._down(status, now_s)
        return (over and in_phase_s >= ABORT_SETTLE_S) or in_phase_s > self.config.retreat.abort_time_max_s

    def _down(self, status: VehicleStatus, now_s: float) -> bool:
        """Whether the status does not report a flight and, if the heartbeat is recent, the motors are off."""
        fresh = now_s - status.arrival_s <= self.config.checks.status_age_max_s
        return status.landed in _NOT_FLYING and not (status.armed and fresh)

    def _remember(self, snapshot: Snapshot, now_s: float) -> None:
        """Store target state, first heading, whether the vehicle was armed or EXTERNAL, and input times."""
        memory, target, own, status = (
            self.memory,
            snapshot.target,
            snapshot.inputs.own,
            snapshot.inputs.status,
        )
        if target is not None and (snapshot.target_ok or snapshot.target_placed):
            memory.target_position_enu_m = target.position_enu_m
            memory.target_velocity_enu_m_s = target.velocity_enu_m_s
        if memory.yaw_rad is None and own is not None:
            memory.yaw_rad = own.yaw_rad
        if snapshot.own_ok:
            memory.own_ok_s = now_s
        if not snapshot.good:
            memory.good_since_s = math.inf
        elif memory.good_since_s == math.inf:
            memory.good_since_s = now_s
        if status is not None and status.armed:
            memory.was_armed = True
            if status.mode is Mode.EXTERNAL:  # only if armed, because PX4 keeps this mode after a landing
                memory.was_external = True

    def _stopped(self, at: Relative, now_s: float) -> bool:
        """Whether the vehicle has stopped low over the pad for ``stopped_time_s``, judged by its velocity."""
        memory = self.memory
        if not self.strategy.stopped(at, memory.command):
            memory.stopped_since_s = math.inf
            return False
        memory.stopped_since_s = min(memory.stopped_since_s, now_s)
        held = now_s - memory.stopped_since_s >= self.config.contact.stopped_time_s
        return held and at.e_m[2] < self.strategy.stopped_below_m

    def _above(self, at: Relative) -> bool:
        """Whether the vehicle is over the pad, with a tolerance for the errors of both positions."""
        return at.d_m <= self.config.touchdown.pad_radius_m + self.config.contact.beyond_m

    def _stands(self, at: Relative, standing: bool, now_s: float) -> bool:
        """Whether the vehicle reports ground contact, or is on the pad and does not sink any more."""
        memory, config = self.memory, self.config
        near = self._above(at) and at.e_m[2] - config.touchdown.feet_below_reference_m < config.contact.gap_m
        sinking_m_s = at.target.velocity_enu_m_s[2] - at.own.velocity_enu_m_s[2]
        if not near or sinking_m_s > config.contact.speed_m_s:
            memory.contact_since_s = math.inf
            return False
        memory.contact_since_s = min(memory.contact_since_s, now_s)
        return standing or now_s - memory.contact_since_s >= config.contact.time_s

    def _slides(self, at: Relative) -> bool:
        """Whether the vehicle is low over the pad and will leave it by sliding before the motors stop."""
        contact, gap_m = self.config.contact, at.e_m[2] - self.config.touchdown.feet_below_reference_m
        if contact.sliding_gap_m <= max(0.0, gap_m):  # 0 disables this check, even for feet below the pad
            return False
        vx, vy = at.slip_m_s
        return at.d_m + SLIDING_TIME_S * hypot(vx, vy) > contact.sliding_radius_m

    def _change(self, snapshot: Snapshot, flags: int, now_s: float) -> Transition | None:
        """Apply the first matching rule of the phase's table."""
        memory = self.memory
        rule = first(TABLE[memory.phase], flags)
        if rule is None:
            return None
        before, after = memory.phase, rule.to
        why = self.reason(rule, flags, snapshot, now_s)
        if before in RETRY_FROM and after in RETRY_TO:
            memory.retries += 1
        if before is Phase.LAND and after is Phase.APPROACH:
            memory.swings += snapshot.permissions.may_land
        if after is Phase.APPROACH and memory.started_s == math.inf:
            memory.started_s = now_s
        if after is Phase.TOUCHDOWN:  # the contact timers can have values of an earlier descent
            memory.contact_since_s = memory.stopped_since_s = math.inf
            memory.swings = 0
        if after is Phase.LEAVE:  # a new take-off follows
            memory.was_armed = memory.was_external = memory.climbed = False
        memory.phase, memory.phase_since_s, memory.reason = after, now_s, why
        if after is Phase.ABORT:
            self._abort(flags)
        return Transition(before, after, why, memory.abort_way)

    def _abort(self, flags: int) -> Transition | None:
        """Choose how the abort ends the flight; a stronger command of the operator replaces the choice."""
        memory = self.memory
        rule = first(ABORT_TABLE[memory.abort_way], flags)
        if rule is None:
            return None
        memory.abort_way = rule.to
        return Transition(Phase.ABORT, Phase.ABORT, rule.reason, rule.to)

    def reason(self, rule: Rule[Phase], flags: int, seen: Snapshot, now_s: float) -> str:
        """Return the reason text of a rule that fires, with the measured values of its true conditions."""
        if rule.when & C.ABORT_ASKED and seen.inputs.operator is Operator.TIME_OVER:
            return TIME_OVER
        if rule.when & C.CHECK_FAILED:
            return self.failure
        checks, target, battery = self.config.checks, seen.target, self._reserve.text
        raised = (rule.when | rule.about) & flags
        numbers: tuple[tuple[int, Callable[[], str]], ...] = (
            (C.OWN_LOST, lambda: self._own_lost(seen, now_s)),
            (C.LINK_LOST, lambda: self._link_lost(seen, now_s)),
            (C.TARGET_LOST, lambda: self._target_lost(seen)),
            (C.NOT_FOLLOWING, self._not_following),
            (C.TIRED, lambda: battery),
            (C.NO_RESULT, lambda: self.strategy.memory.refusal),
        )
        details = [say() for condition, say in numbers if raised & condition]
        if not details and rule.about & ~flags & C.READY:
            others = "" if seen.permissions.may_begin else seen.permissions.text
            below = target_below(self.config, seen)
            details = [battery or others or below or "the vehicle does not report that it is ready to arm"]
        if not details and rule.about & ~flags & C.RECOVERED:
            least_s = checks.recovery_time_s
            details = [f"not all of them were good for {least_s:g} s without a gap (checks.recovery_time_s)"]
        if rule is START_LATE and target is not None:
            speed_m_s = math.hypot(*target.velocity_enu_m_s[:2])
            most_m_s = min(self.config.limits.velocity_max_m_s[:2])
            details = [f"the target drives at {speed_m_s:.2f} m/s; limits.velocity_max_m_s is {most_m_s:g}"]
        if rule.when & C.LANDING_TIME_OVER and seen.permissions.waited:
            details = [seen.permissions.text]
        return f"{rule.reason}: {', '.join(details)}" if details else rule.reason

    def _own_lost(self, seen: Snapshot, now_s: float) -> str:
        checks, watched, own = self.config.checks, self._plausibility, seen.inputs.own
        if own is None:
            return "no state of the vehicle has arrived"
        if watched.memory.distrusted:
            return (
                f"drift, the position moved {watched.drift_m:.2f} m away from where its velocity leads; "
                f"checks.own_drift_max_m is {checks.own_drift_max_m:g}"
            )
        last, limit = watched.memory.last, f"checks.own_age_max_s is {checks.own_age_max_s:g}"
        if last is not None and last.arrival_s < own.arrival_s:
            return f"its numbers have not changed for {now_s - last.arrival_s:.2f} s; {limit}"
        return f"the vehicle's newest state is {now_s - own.arrival_s:.2f} s old; {limit}"

    def _link_lost(self, seen: Snapshot, now_s: float) -> str:
        status = seen.inputs.status
        if status is None:
            return "no heartbeat has arrived"
        limit = f"checks.status_age_max_s is {self.config.checks.status_age_max_s:g}"
        return f"the newest heartbeat is {now_s - status.arrival_s:.1f} s old; {limit}"

    def _target_lost(self, seen: Snapshot) -> str:
        checks, target, track = self.config.checks, seen.target, self._track.memory
        if track.distrusted:
            return (
                f"the target's positions moved {track.parted_m:.2f} m away from where its velocity "
                f"leads; checks.target_drift_max_m is {checks.target_drift_max_m:g}; {DRIFT_CAUSES}"
            )
        refused = f", the newest was refused: {track.refusal}" if track.refusal else ""
        if target is None:
            return f"no sample of the target has been accepted{refused}"
        limit = f"checks.target_age_max_s is {checks.target_age_max_s:g}"
        return f"the target's newest sample is {target.age_s:.2f} s old; {limit}{refused}"

    def _not_following(self) -> str:
        watched = self._plausibility
        return (
            f"it lags {watched.tracking_lag_m:.2f} m behind its set-points; "
            f"{watched.tracking_lag_max_m:.2f} m are allowed "
            f"by checks.follow_lag_max_s, {self.config.checks.follow_lag_max_s:g}"
        )

    def progress(self, snapshot: Snapshot) -> None:
        """Record the end of a climb from ground or pad, and whether the vehicle has flown clear."""
        memory, own = self.memory, snapshot.inputs.own
        if own is None:
            return
        if memory.phase is Phase.TAKEOFF and snapshot.target is not None:
            memory.ground_z_m = min(memory.ground_z_m, own.position_enu_m[2])
            memory.climbed = memory.climbed or climbed(self, own)
        elif memory.phase is Phase.ABORT and memory.abort_way is AbortWay.FLY_CLEAR and snapshot.own_ok:
            memory.clear = memory.clear or flown_clear(self, own)
        elif memory.phase is Phase.LEAVE and memory.was_external and snapshot.own_ok:
            x, y, z = own.position_enu_m
            memory.climbed = memory.climbed or z >= high_enough_m(self)
            px, py, _ = snapshot.permissions.place_enu_m or own.position_enu_m
            rests = math.hypot(*own.velocity_enu_m_s[:2]) <= PLACE_SPEED_M_S
            there = memory.climbed and rests and math.hypot(px - x, py - y) <= PLACE_RADIUS_M
            memory.clear = memory.clear or (there and flown_clear(self, own))
