"""What each phase wants: the vehicle's mode, and the velocity before safety filter and gate."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from flightstack.core.memory import AbortWay, Memory
from flightstack.core.mission.conditions import high_enough_m, start_point
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.safety.position_loop import limit, nominal_velocity
from flightstack.core.snapshot import Snapshot
from flightstack.core.strategies.strategy import Strategy
from flightstack.core.types import ZERO, Landed, Operator, OwnState, Phase, Request, Vec3

CLIMB_OVER = 0.5  # share of the climb margin by which the climb aims beyond what is high enough, to get there
CLEAR_BELOW = 0.25  # share of it that a vehicle flying clear may lack of that height
TAKEOFF_DONE = 0.85  # share of the take-off height at which we take over


class Wish(NamedTuple):
    """What a phase asks for. ``filtered``: the landing barrier applies and the target must be fresh."""

    request: Request
    velocity: Vec3 | None = None
    filtered: bool = False


class Situation(NamedTuple):
    """Everything a phase may look at."""

    config: FlightConfig
    barrier: Barrier
    memory: Memory
    seen: Snapshot
    strategy: Strategy


def _wait(s: Situation) -> Wish:
    status = s.seen.inputs.status
    if status is not None and status.armed and status.landed is not Landed.ON_GROUND and s.seen.target_ok:
        # found in the air: take over, standing still, and never below the barrier of a pad that comes nearer
        return Wish(Request.EXTERNAL, ZERO, filtered=s.strategy.waits_filtered)
    return Wish(Request.NONE)


def _takeoff(s: Situation) -> Wish:
    own, target, memory = s.seen.inputs.own, s.seen.target, s.memory
    if own is None or target is None:
        return Wish(Request.TAKEOFF)
    z, height_m = own.position_enu_m[2], s.config.takeoff.height_m
    memory.ground_z_m = min(memory.ground_z_m, z)
    climbed_m = z - memory.ground_z_m
    if memory.was_armed and climbed_m > TAKEOFF_DONE * height_m:
        memory.climbed = True
    if not memory.climbed:  # an autopilot that takes off by set-points flies this one, others by themselves
        up = (height_m - climbed_m) * s.config.position_loop.gain_1_s[2]
        climb = limit((0.0, 0.0, max(0.0, up)), s.config.limits.velocity_max_m_s)
        return Wish(Request.EXTERNAL if _flies_by_us(s) else Request.TAKEOFF, climb)
    start = start_point(s.config, target)
    if start is None:
        return Wish(Request.EXTERNAL, ZERO)
    p = own.position_enu_m
    e = (p[0] - start[0], p[1] - start[1], p[2] - start[2])
    if abs(e[2]) > s.config.takeoff.level_first_m:
        e = (0.0, 0.0, e[2])
    return Wish(Request.EXTERNAL, nominal_velocity(e, s.config.position_loop.gain_1_s, ZERO))


def _flies_by_us(s: Situation) -> bool:
    """Whether it has lifted off and follows set-points: nothing is left to ask of its own take-off."""
    status = s.seen.inputs.status
    standing = status is None or status.landed is Landed.ON_GROUND
    return s.memory.was_external and not standing


def _land(s: Situation) -> Wish:
    at = s.seen.relative
    if at is None:
        return Wish(Request.EXTERNAL)
    velocity = s.strategy.approach_m_s(at, over_pad=s.memory.phase is Phase.LAND)
    return Wish(Request.EXTERNAL, velocity, filtered=True)


def _touchdown(s: Situation) -> Wish:
    """Motors off by the rule; until then straight down, above the pad's middle.

    Within the pad's radius the cone is narrower than the pad and no longer what guards the landing.
    """
    if s.memory.contact:
        return Wish(Request.MOTORS_OFF)
    at = s.seen.relative
    if at is None:
        return Wish(Request.EXTERNAL)
    velocity = s.strategy.descent_m_s(at)
    return Wish(Request.MOTORS_OFF) if velocity is None else Wish(Request.EXTERNAL, velocity)


def _landed(s: Situation) -> Wish:
    """Nothing; but an emergency stop is obeyed, in case the heartbeat did not tell the truth."""
    emergency = s.seen.inputs.operator is Operator.EMERGENCY_STOP
    return Wish(Request.MOTORS_OFF if emergency else Request.NONE)


def _hold(s: Situation) -> Wish:
    """As the filter holds; before the landing, or without a target, stand still."""
    target = s.seen.target
    if target is None or s.memory.started_s == math.inf:
        return Wish(Request.EXTERNAL, ZERO)
    return Wish(Request.EXTERNAL, s.strategy.hold_m_s(target))


def _climb(s: Situation) -> Wish:
    own = s.seen.inputs.own
    if own is None:
        return Wish(Request.EXTERNAL)
    # beyond the height it holds there until the target is back or the time is over
    aim_m = high_enough_m(s.config, s.barrier, s.memory) + CLIMB_OVER * s.config.retreat.climb_margin_m
    missing_m = aim_m - own.position_enu_m[2]
    up = max(0.0, min(s.config.limits.velocity_max_m_s[2], missing_m * s.config.position_loop.gain_1_s[2]))
    return Wish(Request.EXTERNAL, (0.0, 0.0, up))


def _fly_clear(s: Situation) -> Wish:
    own, memory = s.seen.inputs.own, s.memory
    target = memory.target_position_enu_m
    if own is None or not s.seen.own_ok or target is None or memory.clear:
        return Wish(Request.LAND)
    dx, dy = own.position_enu_m[0] - target[0], own.position_enu_m[1] - target[1]
    d = math.hypot(dx, dy)
    retreat = s.config.retreat
    lacking_m = CLEAR_BELOW * retreat.climb_margin_m
    high = own.position_enu_m[2] >= high_enough_m(s.config, s.barrier, memory) - lacking_m
    outside = d >= s.config.checks.clearance_m
    stays_out = outside and _landing_distance_m(s, own, (dx, dy)) >= s.config.checks.clearance_m
    if stays_out or own.arrival_s - memory.phase_since_s > retreat.clear_time_max_s:
        memory.clear = True
        return Wish(Request.LAND)
    vx, vy, vz = s.config.limits.velocity_max_m_s
    up = 0.0 if high else vz
    if not (high or outside):
        return Wish(Request.EXTERNAL, (0.0, 0.0, up))
    away = (dx / d, dy / d) if d > 1e-6 else (1.0, 0.0)
    return Wish(Request.EXTERNAL, limit((away[0] * vx, away[1] * vy, up), (vx, vy, vz)))


def _landing_distance_m(s: Situation, own: OwnState, away_m: tuple[float, float]) -> float:
    """Least horizontal distance from the target in a landing that begins now.

    The vehicle comes to rest by its velocity loop, then sinks straight down; the target drives on as it did
    when it was seen last.
    """
    memory = s.memory
    assert memory.target_velocity_enu_m_s is not None  # known since its position is
    lag_s = s.config.velocity_loop.lag_xy_s
    (vx, vy, _), (tx, ty, _) = own.velocity_enu_m_s, memory.target_velocity_enu_m_s
    ground_z_m = memory.ground_z_m if memory.ground_z_m < math.inf else 0.0  # found in the air: the origin's
    sinks_s = max(0.0, own.position_enu_m[2] - ground_z_m) / s.config.retreat.landing_speed_m_s
    x, y = away_m[0] + vx * lag_s, away_m[1] + vy * lag_s
    closing_m2_s, speed2_m2_s2 = x * tx + y * ty, tx * tx + ty * ty
    if closing_m2_s <= 0.0:
        return math.hypot(x, y)
    passed = closing_m2_s < speed2_m2_s2 * sinks_s  # it comes by before the vehicle is down
    nearest_s = closing_m2_s / speed2_m2_s2 if passed else sinks_s
    return math.hypot(x - tx * nearest_s, y - ty * nearest_s)


_ABORT: dict[AbortWay, Callable[[Situation], Wish]] = {
    AbortWay.NONE: lambda _: Wish(Request.NONE),
    AbortWay.MOTORS_OFF: lambda _: Wish(Request.MOTORS_OFF),
    AbortWay.HANDS_OFF: lambda _: Wish(Request.NONE),
    AbortWay.LAND_HERE: lambda _: Wish(Request.LAND),
    AbortWay.FLY_CLEAR: _fly_clear,
}

_PHASES: dict[Phase, Callable[[Situation], Wish]] = {
    Phase.WAIT: _wait,
    Phase.TAKEOFF: _takeoff,
    Phase.APPROACH: _land,
    Phase.LAND: _land,
    Phase.TOUCHDOWN: _touchdown,
    Phase.LANDED: _landed,
    Phase.HOLD: _hold,
    Phase.CLIMB: _climb,
    Phase.ABORT: lambda s: _ABORT[s.memory.abort_way](s),
}


def wish(situation: Situation) -> Wish:
    """Ask the present phase what it wants."""
    return _PHASES[situation.memory.phase](situation)
