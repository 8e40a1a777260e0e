"""Flags of the phase tables, computed from the snapshot of a tick; the functions have no state.

``landing_flags`` decides on go-arounds: it sets DRIFTED (``Filter.drifts``) and SET_OFF in TOUCHDOWN.
"""

from __future__ import annotations

import math
from typing import cast

from flightstack.core.memory import Memory
from flightstack.core.mission.phases import C
from flightstack.core.numeric import hypot, rare
from flightstack.core.parameters.flight import Checks, FlightConfig
from flightstack.core.snapshot import Relative, Snapshot
from flightstack.core.strategies.strategy import Filter
from flightstack.core.target.track import TargetState
from flightstack.core.types import Charge, Landed, Mode, Operator, OwnState, Phase, Vec3, VehicleStatus

OVER_PAD_LEFT = 1.5  # ratio of the distance at which phase LAND ends to the pad's radius
TAKEOFF_DONE = 0.85  # fraction of the take-off height at which the take-off climb ends
LANDED_SETTLE_S = 2.2  # time at rest on the pad that ends the flight, s; the verdict requires 2 s
_SWINGING = (
    "oscillates over the pad: velocity loop slower than configured, run `identify`, or a robot that "
    "accelerates more than envelope.target_acceleration_max_m_s2"
)
_ASKED: dict[Operator, int] = {
    Operator.NONE: 0,
    Operator.ABORT: C.ABORT_ASKED,
    Operator.EMERGENCY_STOP: C.EMERGENCY,
    Operator.LAND: C.ABORT_ASKED | C.LAND_ASKED,
    Operator.TIME_OVER: C.ABORT_ASKED,
}
_NO_STATUS = VehicleStatus(-math.inf, False, Mode.UNKNOWN, Landed.UNKNOWN, False)
# maximum time in each phase, s, in the order of ``Phase``
PhaseTimes = tuple[float, float, float, float, float, float, float, float, float, float]


def phase_times_s(config: FlightConfig) -> PhaseTimes:
    """Return the maximum time allowed in each phase, s."""
    most_s = dict.fromkeys(Phase, math.inf)
    most_s |= {
        Phase.WAIT: config.checks.wait_time_max_s,
        Phase.TAKEOFF: config.takeoff.timeout_s,
        Phase.TOUCHDOWN: config.touchdown.timeout_s,
        Phase.HOLD: config.checks.hold_time_s,
        Phase.CLIMB: config.checks.climb_time_max_s,
        Phase.LEAVE: config.retreat.abort_time_max_s,
    }
    return cast(PhaseTimes, tuple(most_s.values()))


def start_point(config: FlightConfig, target: TargetState) -> Vec3 | None:
    """Return the point where the landing starts, ENU; None: the landing starts at the vehicle's position."""
    offset = config.takeoff.start_offset_m
    if offset is None:
        return None
    p = target.position_enu_m
    return (p[0] + offset[0], p[1] + offset[1], p[2] + offset[2])


class Situation:
    """Configuration, filter and state, from which flags and commands of the phases are computed."""

    config: FlightConfig
    strategy: Filter
    memory: Memory
    times_s: PhaseTimes

    def __init__(self, config: FlightConfig, strategy: Filter, memory: Memory) -> None:
        self.config, self.strategy, self.memory = config, strategy, memory
        self.times_s = phase_times_s(config)
        self.failure = ""  # text of the check that failed in this tick; compiled code has no such field

    @rare
    def fail(self, reason: str, details: str, first: float, second: float) -> bool:
        """Store the text of a failed check, and return True; ``details``: format string for the numbers."""
        self.failure = f"{reason}: {details.format(first, second)}"
        return True


def high_enough_m(s: Situation) -> float:
    """Return a height above every part of the target, including the climb margin, m."""
    base = s.memory.target_position_enu_m[2] if s.memory.target_position_enu_m else 0.0
    return base + s.config.barrier.peak_height_m + s.config.retreat.climb_margin_m


def climbed(s: Situation, own: OwnState) -> bool:
    """Whether the take-off climb is over: the vehicle is armed, and near the commanded height."""
    climbed_m = own.position_enu_m[2] - s.memory.ground_z_m
    return s.memory.was_armed and climbed_m > TAKEOFF_DONE * s.config.takeoff.height_m


def flown_clear(s: Situation, own: OwnState) -> bool:
    """Whether an aborting vehicle can land clear of the target, or the time to fly clear is over."""
    target, clearance_m = s.memory.target_position_enu_m, s.config.checks.clearance_m
    if target is None:
        return False
    away_m = own.position_enu_m[0] - target[0], own.position_enu_m[1] - target[1]
    outside = math.hypot(*away_m) >= clearance_m
    if outside and _landing_distance_m(s, own, away_m) >= clearance_m:
        return True
    return own.arrival_s - s.memory.phase_since_s > s.config.retreat.clear_time_max_s


def _landing_distance_m(s: Situation, own: OwnState, away_m: tuple[float, float]) -> float:
    """Return the smallest horizontal distance from the target in a landing that starts now.

    The vehicle brakes with its velocity loop, then descends vertically; the target continues with its last
    known velocity.
    """
    config, memory = s.config, s.memory
    assert memory.target_velocity_enu_m_s is not None  # the velocity is known if the position is
    lag_s = config.velocity_loop.lag_xy_s
    (vx, vy, _), (tx, ty, _) = own.velocity_enu_m_s, memory.target_velocity_enu_m_s
    ground_z_m = memory.ground_z_m if memory.ground_z_m < math.inf else 0.0  # 0 after a start in the air
    sinks_s = max(0.0, own.position_enu_m[2] - ground_z_m) / config.retreat.landing_speed_m_s
    x, y = away_m[0] + vx * lag_s, away_m[1] + vy * lag_s
    closing_m2_s, speed2_m2_s2 = x * tx + y * ty, tx * tx + ty * ty
    if closing_m2_s <= 0.0:
        return math.hypot(x, y)
    passed = closing_m2_s < speed2_m2_s2 * sinks_s  # the target passes before the vehicle has landed
    nearest_s = closing_m2_s / speed2_m2_s2 if passed else sinks_s
    return math.hypot(x - tx * nearest_s, y - ty * nearest_s)


def condition_flags(s: Situation, snapshot: Snapshot, command_failed: bool, now_s: float) -> int:
    """Return the flags of this tick and change nothing; the timers of ``memory`` must be up to date."""
    config, memory, phase = s.config, s.memory, s.memory.phase
    inputs, own, permissions = snapshot.inputs, snapshot.inputs.own, snapshot.permissions
    status, good = inputs.status or _NO_STATUS, snapshot.good
    at = snapshot.relative if good else None
    external, standing = status.mode is Mode.EXTERNAL, status.landed is Landed.ON_GROUND
    fit, tired = snapshot.charge is Charge.FIT, snapshot.charge is Charge.TIRED
    blind = phase is Phase.TOUCHDOWN and now_s - memory.own_ok_s <= config.touchdown.blind_time_s
    recovered = now_s - memory.good_since_s >= config.checks.recovery_time_s
    ready = good and (status.ready_to_arm or status.armed) and fit and permissions.may_begin
    if phase is Phase.WAIT:
        recovered = recovered and _steady(config.checks, memory, snapshot, now_s)
        ready = ready and not target_below(config, snapshot)
    rested = phase is Phase.LANDED and now_s - memory.phase_since_s >= LANDED_SETTLE_S
    above_m = own.position_enu_m[2] if own is not None else -math.inf
    flags = (
        _ASKED[inputs.operator]
        | lasting_flags(s, status.armed, external, standing)
        | time_flags(s, now_s)
        | (C.NOT_FOLLOWING if not snapshot.follows else 0)
        | (C.OWN_LOST if not (snapshot.own_ok or blind) else 0)
        | (C.LINK_LOST if not snapshot.link_ok else 0)
        | (C.TARGET_LOST if not snapshot.target_ok else 0)
        | (C.COMMAND_FAILED if command_failed else 0)
        | (C.NO_RESULT if s.strategy.memory.refusal != "" else 0)
        | (C.RECOVERED if recovered else 0)
        | (C.READY if ready else 0)
        | (C.LANDING_TIME_OVER if permissions.waited and memory.started_s < math.inf else 0)
        | (C.HIGH_ENOUGH if phase is Phase.CLIMB and above_m >= high_enough_m(s) else 0)
        | (C.PAD_WANTED if rested and permissions.pad_wanted and good and fit else 0)
    )
    if (tired or permissions.cut_off) and _better_beside(s, at):
        flags |= (C.TIRED if tired else 0) | (C.CUT_OFF if permissions.cut_off else 0)
    if tired:
        flags &= ~C.RETRIES_LEFT
    if at is None:
        return flags
    if phase is Phase.TAKEOFF and memory.climbed and _at_start(config, at):
        flags |= C.AT_START
    return flags | landing_flags(s, at, now_s, permissions.may_land, permissions.may_touch)


def time_flags(s: Situation, now_s: float) -> int:
    """Return the flags of expired time limits and of detected contact."""
    memory, phase, started = s.memory, s.memory.phase, s.memory.started_s < math.inf
    landing_time_max_s = s.config.checks.landing_time_max_s
    return (
        (C.STARTED if started else 0)
        | (C.LANDING_TIME_OVER if started and now_s - memory.started_s > landing_time_max_s else 0)
        | (C.PHASE_TIME_OVER if now_s - memory.phase_since_s > s.times_s[phase.value] else 0)
        | (C.ON_PAD if phase is Phase.TOUCHDOWN and memory.contact else 0)
        # contact alone counts in LAND: on the pad beside its centre h < 0, and touchdown rules need h >= 0
        | (C.TOUCH if phase is Phase.LAND and memory.contact else 0)
    )


def _steady(checks: Checks, memory: Memory, snapshot: Snapshot, now_s: float) -> bool:
    """Whether new messages of each kind have arrived since all inputs became good.

    States of vehicle and target must arrive ``recovery_time_s`` or more after this time, a heartbeat at any
    later time. An input that arrives rarely, or in bursts, counts as good until it is too old.
    """
    own, status, target = snapshot.inputs.own, snapshot.inputs.status, snapshot.target
    if own is None or status is None or target is None:
        return False
    came_s = min(own.arrival_s, now_s - target.age_s) - memory.good_since_s
    return came_s >= checks.recovery_time_s and status.arrival_s > memory.good_since_s


def target_below(config: FlightConfig, snapshot: Snapshot) -> str:
    """Return why the landing spot is implausible for a vehicle on the ground; empty if it is plausible.

    If the target's z axis points down, the landing spot is below the ground, and the vehicle would fly there.
    """
    status, e_m, most_m = snapshot.inputs.status, snapshot.e_m, config.checks.target_below_max_m
    if status is None or status.landed is not Landed.ON_GROUND or e_m is None:
        return ""
    below_m = e_m[2] - config.touchdown.feet_below_reference_m
    if below_m <= most_m:
        return ""
    return (
        f"the landing spot is {below_m:.2f} m below the ground on which the vehicle stands; "
        f"checks.target_below_max_m allows {most_m:g}; usual cause: a target whose z axis points down (NED "
        "or FRD instead of ENU), or another origin of its heights"
    )


def _better_beside(s: Situation, at: Relative | None) -> bool:
    """Whether a landing beside the target is better than one on the pad.

    Inside the peak ring of the boundary the pad is the shortest way down: to fly clear, the vehicle must
    climb over the ring.
    """
    return s.memory.phase is not Phase.APPROACH or at is None or at.d_m > s.config.barrier.peak_distance_m


def lasting_flags(s: Situation, armed: bool, external: bool, standing: bool) -> int:
    """Return the flags that only the heartbeat or the phase changes, if the landing loses no input.

    Compiled ticks compute only these flags, ``time_flags`` and ``landing_flags``: each flag that a rule of
    APPROACH, LAND, TOUCHDOWN or LANDED uses must be in one of these three groups.
    """
    memory = s.memory
    return (
        (C.TARGET_KNOWN if memory.target_position_enu_m is not None else 0)
        | (C.RETRIES_LEFT if memory.retries < s.config.checks.retries_max else 0)
        | (C.CLEAR if memory.clear else 0)
        | (C.ARMED if armed else 0)
        | (C.EXTERNAL if external else 0)
        | (C.STANDING if standing else 0)
        | (C.WAS_ARMED if memory.was_armed else 0)
        | (C.WAS_EXTERNAL if memory.was_external else 0)
    )


def _at_start(config: FlightConfig, at: Relative) -> bool:
    """Whether the vehicle is at the start point of the landing and moves with the target."""
    takeoff, start = config.takeoff, start_point(config, at.target)
    return start is None or (
        math.dist(at.own.position_enu_m, start) < takeoff.arrival_radius_m
        and math.dist(at.own.velocity_enu_m_s, at.target.velocity_enu_m_s) < takeoff.arrival_speed_m_s
    )


def landing_flags(s: Situation, at: Relative, now_s: float, may_land: bool, may_touch: bool) -> int:
    """Return the flags that depend on the vehicle's position over the pad; all inputs must be good."""
    memory, strategy, touchdown = s.memory, s.strategy, s.config.touchdown
    # the radius for leaving the cone is wider than that for entering, so that noise does not toggle the phase
    radius = touchdown.pad_radius_m * (OVER_PAD_LEFT if memory.phase is Phase.LAND else 1.0)
    low = at.e_m[2] < max(s.config.barrier.peak_height_m, touchdown.height_m)
    over_pad = at.d_m <= radius and low and may_land
    touches = may_touch and strategy.may_touch(at) and not waits_for_calm(s, at, now_s)
    descends = memory.phase is Phase.TOUCHDOWN and not memory.contact
    return (
        (C.OVER_PAD if over_pad else 0)
        | (C.TOUCH if touches else 0)
        | (C.DRIFTED if descends and strategy.drifts(at) else 0)
        | (C.SET_OFF if descends and _sets_off(s, at, now_s) else 0)
        | (C.CHECK_FAILED if check_fails(s, at, now_s, over_pad, may_land and may_touch) else 0)
    )


def check_fails(s: Situation, at: Relative, now_s: float, over_pad: bool, permitted: bool) -> bool:  # noqa: ARG001
    """Whether a check aborts the flight in TAKEOFF, APPROACH, LAND or TOUCHDOWN; all inputs are good.

    To add a check, write one more ``if`` with its phases, its test, and its text with two numbers.
    ``permitted``: whether the fleet permits the landing and the touchdown.
    """
    memory, checks = s.memory, s.config.checks
    if memory.phase is Phase.LAND and permitted and s.strategy.watches_swinging:
        # the vehicle oscillates: it leaves the cone over the pad too often, or is over the pad for too long
        most_s, leaves = checks.over_pad_time_max_s, memory.swings >= checks.swings_max
        waited_s = now_s - max(memory.phase_since_s, memory.started_s + s.config.touchdown.calm_wait_s)
        if waited_s > most_s if over_pad else leaves:
            if leaves:
                counts = "left the cone over it {:g} times; checks.swings_max is {:g}"
                return s.fail(_SWINGING, counts, memory.swings + 1.0, checks.swings_max)
            return s.fail(_SWINGING, "no touchdown in checks.over_pad_time_max_s, {:g} s", most_s, waited_s)
    return False


def _sets_off(s: Situation, at: Relative, now_s: float) -> bool:
    """Whether a slow target has become fast, a retry is left, and h is large enough for a climb.

    Without a retry the vehicle continues its descent, because a go-around would be an abort.
    """
    if (
        s.memory.retries >= s.config.checks.retries_max
        or s.config.barrier.h(at.e_m) < s.config.retreat.h_left_m
    ):
        return False
    return waits_for_calm(s, at, now_s)


def waits_for_calm(s: Situation, at: Relative, now_s: float) -> bool:
    """Whether the vehicle waits for a slower target, because time is left; never on the pad."""
    touchdown, wait_s = s.config.touchdown, s.config.touchdown.calm_wait_s
    if wait_s == 0.0 or now_s - s.memory.started_s >= wait_s:
        return False
    if at.e_m[2] <= touchdown.feet_below_reference_m + s.config.contact.gap_m:
        return False
    velocity_m_s = at.target.velocity_enu_m_s
    return hypot(velocity_m_s[0], velocity_m_s[1]) >= touchdown.calm_speed_m_s
