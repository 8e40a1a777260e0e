"""Command of each phase: the vehicle's mode, and the velocity before safety filter and gate.

The functions are pure: they read the mission's memory and do not change it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from flightstack.core.memory import AbortWay
from flightstack.core.mission.conditions import Situation, high_enough_m, start_point, waits_for_calm
from flightstack.core.numeric import NotOrdinary
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.position_loop import limit, nominal_velocity
from flightstack.core.snapshot import Relative, Snapshot
from flightstack.core.types import ZERO, Landed, Operator, Phase, Request, Vec3

CLIMB_OVER = 0.5  # fraction of the climb margin that a climb adds to the required height
CLEAR_BELOW = 0.25  # fraction of the climb margin that a vehicle is allowed to lose while it flies clear


class NominalCommand(NamedTuple):
    """Request and nominal velocity of a phase in one tick, before filter and gate."""

    request: Request  # requested mode of the vehicle
    velocity: Vec3 | None = None  # nominal velocity, ENU, m/s; ``None``: no set-point
    filtered: bool = False  # whether the landing barrier applies; the target state must then be recent


def _wait(s: Situation, seen: Snapshot) -> NominalCommand:
    status = seen.inputs.status
    if status is not None and status.armed and status.landed is not Landed.ON_GROUND and seen.target_ok:
        # a vehicle that starts in the air hovers; the filter keeps the vehicle clear of an approaching pad
        return NominalCommand(Request.EXTERNAL, ZERO, filtered=s.strategy.waits_filtered)
    return NominalCommand(Request.NONE)


def _takeoff(s: Situation, seen: Snapshot) -> NominalCommand:
    own, target, memory = seen.inputs.own, seen.target, s.memory
    if own is None or target is None:
        return NominalCommand(Request.TAKEOFF)
    if not memory.climbed:  # this climb is only for autopilots that take off by set-points
        climbed_m = own.position_enu_m[2] - memory.ground_z_m
        up = (s.config.takeoff.height_m - climbed_m) * s.config.position_loop.gain_1_s[2]
        climb = limit((0.0, 0.0, max(0.0, up)), s.config.limits.velocity_max_m_s)
        return NominalCommand(Request.EXTERNAL if _follows_in_air(s, seen) else Request.TAKEOFF, climb)
    start = start_point(s.config, target)
    if start is None:
        return NominalCommand(Request.EXTERNAL, ZERO)
    p = own.position_enu_m
    e = (p[0] - start[0], p[1] - start[1], p[2] - start[2])
    if abs(e[2]) > s.config.takeoff.level_first_m:
        e = (0.0, 0.0, e[2])
    velocity = nominal_velocity(e, s.config.position_loop.gain_1_s, target.velocity_enu_m_s)
    return NominalCommand(Request.EXTERNAL, velocity)


def _follows_in_air(s: Situation, seen: Snapshot) -> bool:
    """Whether the vehicle has lifted off and follows set-points: the autopilot's take-off is over."""
    status = seen.inputs.status
    standing = status is None or status.landed is Landed.ON_GROUND
    return s.memory.was_external and not standing


def _land(s: Situation, seen: Snapshot) -> NominalCommand:
    at = seen.relative
    if at is None:
        return NominalCommand(Request.EXTERNAL)
    if not seen.permissions.may_land:
        return NominalCommand(Request.EXTERNAL, _outside(at, s.config), filtered=True)
    return NominalCommand(Request.EXTERNAL, towards_pad(s, at), filtered=True)


def towards_pad(s: Situation, at: Relative) -> Vec3:
    """Return the nominal velocity of APPROACH and LAND; the vehicle waits above a target that is too fast."""
    x, y, z = s.strategy.choose(at, s.strategy.approach_m_s(at, s.memory.phase is Phase.LAND))
    if waits_for_calm(s, at, at.own.arrival_s):
        below_m = s.config.touchdown.calm_height_m - at.e_m[2]
        z = max(z, at.target.velocity_enu_m_s[2] + s.config.position_loop.gain_1_s[2] * below_m)
    return (x, y, z)


def ordinary_velocity(s: Situation, at: Relative) -> Vec3:
    """Return the nominal velocity of APPROACH, LAND and TOUCHDOWN until the motors stop."""
    if s.memory.phase is not Phase.TOUCHDOWN:
        return towards_pad(s, at)
    if s.memory.contact or s.strategy.motors_off(at):
        raise NotOrdinary
    return s.strategy.descent_m_s(at)


def _outside(at: Relative, config: FlightConfig) -> Vec3:
    """Return the velocity to the waiting point outside the cone, on the vehicle's side of the pad."""
    (x, y, z), d, fleet = at.e_m, at.d_m, config.fleet
    side = (x / d, y / d) if d > 1e-6 else (1.0, 0.0)
    e = (x - side[0] * fleet.wait_distance_m, y - side[1] * fleet.wait_distance_m, z - fleet.wait_height_m)
    return nominal_velocity(e, config.position_loop.gain_1_s, at.target.velocity_enu_m_s)


def _touchdown(s: Situation, seen: Snapshot) -> NominalCommand:
    """Descend vertically over the pad's centre until the filter's rule stops the motors.

    Within the pad's radius the cone is narrower than the pad and no longer protects the landing.
    """
    if s.memory.contact:
        return NominalCommand(Request.MOTORS_OFF)
    at = seen.relative
    if at is None:
        return NominalCommand(Request.EXTERNAL)
    if s.strategy.motors_off(at):
        return NominalCommand(Request.MOTORS_OFF)
    return NominalCommand(Request.EXTERNAL, s.strategy.descent_m_s(at))


def _landed(_: Situation, seen: Snapshot) -> NominalCommand:
    """Request nothing; at an emergency stop request motors off, because the heartbeat can be wrong."""
    emergency = seen.inputs.operator is Operator.EMERGENCY_STOP
    return NominalCommand(Request.MOTORS_OFF if emergency else Request.NONE)


def _leave(s: Situation, seen: Snapshot) -> NominalCommand:
    """Climb above the pad to a height above every part of the target, then fly to the landing place."""
    memory, at, status = s.memory, seen.relative, seen.inputs.status
    if memory.clear:
        return NominalCommand(Request.LAND)
    flies = status is not None and status.armed and status.landed is not Landed.ON_GROUND
    # the autopilot's own take-off does not follow the pad
    request = Request.EXTERNAL if flies else Request.TAKEOFF
    if at is None:
        return NominalCommand(request)
    gain, (x, y, z) = s.config.position_loop.gain_1_s, at.own.position_enu_m
    above_m = high_enough_m(s) + CLIMB_OVER * s.config.retreat.climb_margin_m
    up_m = z - above_m
    if not memory.climbed:
        vx, vy, _ = s.strategy.approach_m_s(at, True)
        vz = at.target.velocity_enu_m_s[2] - gain[2] * up_m
        return NominalCommand(request, (vx, vy, vz), filtered=True)
    px, py, _ = seen.permissions.place_enu_m or at.own.position_enu_m
    return NominalCommand(request, nominal_velocity((x - px, y - py, up_m), gain, ZERO), filtered=True)


def _hold(s: Situation, seen: Snapshot) -> NominalCommand:
    """Return the filter's hold velocity; zero before the landing or without a target."""
    target = seen.target
    if target is None or s.memory.started_s == math.inf:
        return NominalCommand(Request.EXTERNAL, ZERO)
    return NominalCommand(Request.EXTERNAL, s.strategy.hold_m_s(target))


def _climb(s: Situation, seen: Snapshot) -> NominalCommand:
    own = seen.inputs.own
    if own is None:
        return NominalCommand(Request.EXTERNAL)
    # at this height the vehicle waits for the target until the time of the phase is over
    aim_m = high_enough_m(s) + CLIMB_OVER * s.config.retreat.climb_margin_m
    missing_m = aim_m - own.position_enu_m[2]
    up = max(0.0, min(s.config.limits.velocity_max_m_s[2], missing_m * s.config.position_loop.gain_1_s[2]))
    return NominalCommand(Request.EXTERNAL, (0.0, 0.0, up))


def _fly_clear(s: Situation, seen: Snapshot) -> NominalCommand:
    own, memory = seen.inputs.own, s.memory
    target = memory.target_position_enu_m
    if own is None or not seen.own_ok or target is None or memory.clear:
        return NominalCommand(Request.LAND)
    dx, dy = own.position_enu_m[0] - target[0], own.position_enu_m[1] - target[1]
    d = math.hypot(dx, dy)
    lacking_m = CLEAR_BELOW * s.config.retreat.climb_margin_m
    high = own.position_enu_m[2] >= high_enough_m(s) - lacking_m
    vx, vy, vz = s.config.limits.velocity_max_m_s
    up = 0.0 if high else vz
    if not (high or d >= s.config.checks.clearance_m):
        return NominalCommand(Request.EXTERNAL, (0.0, 0.0, up))
    away = (dx / d, dy / d) if d > 1e-6 else (1.0, 0.0)
    return NominalCommand(Request.EXTERNAL, limit((away[0] * vx, away[1] * vy, up), (vx, vy, vz)))


_ABORT: dict[AbortWay, Callable[[Situation, Snapshot], NominalCommand]] = {
    AbortWay.NONE: lambda *_: NominalCommand(Request.NONE),
    AbortWay.MOTORS_OFF: lambda *_: NominalCommand(Request.MOTORS_OFF),
    AbortWay.HANDS_OFF: lambda *_: NominalCommand(Request.NONE),
    AbortWay.LAND_HERE: lambda *_: NominalCommand(Request.LAND),
    AbortWay.FLY_CLEAR: _fly_clear,
}

_PHASES: dict[Phase, Callable[[Situation, Snapshot], NominalCommand]] = {
    Phase.WAIT: _wait,
    Phase.TAKEOFF: _takeoff,
    Phase.APPROACH: _land,
    Phase.LAND: _land,
    Phase.TOUCHDOWN: _touchdown,
    Phase.LANDED: _landed,
    Phase.HOLD: _hold,
    Phase.CLIMB: _climb,
    Phase.ABORT: lambda s, seen: _ABORT[s.memory.abort_way](s, seen),
    Phase.LEAVE: _leave,
}


def nominal_command(situation: Situation, seen: Snapshot) -> NominalCommand:
    """Return the command of the current phase."""
    return _PHASES[situation.memory.phase](situation, seen)
