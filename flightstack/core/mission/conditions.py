"""Fills the phase machine's word of conditions from what is known in this tick."""

from __future__ import annotations

import math
from collections.abc import Callable

from flightstack.core.memory import Memory
from flightstack.core.mission.phases import C
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.snapshot import Relative, Snapshot
from flightstack.core.strategies.strategy import Strategy
from flightstack.core.target.track import TargetState
from flightstack.core.types import Landed, Mode, Operator, Phase, Vec3

OVER_PAD_LEFT = 1.5  # times the radius at which the cone over the pad is entered


def start_point(config: FlightConfig, target: TargetState) -> Vec3 | None:
    """Where the landing begins, ENU; ``None``: wherever the vehicle is."""
    offset = config.takeoff.start_offset_m
    if offset is None:
        return None
    p = target.position_enu_m
    return (p[0] + offset[0], p[1] + offset[1], p[2] + offset[2])


def high_enough_m(config: FlightConfig, barrier: Barrier, memory: Memory) -> float:
    """Height above which nothing of the target reaches."""
    base = memory.target_position_enu_m[2] if memory.target_position_enu_m else 0.0
    return base + barrier.peak_height_m + config.retreat.climb_margin_m


_PHASE_TIME_S: dict[Phase, Callable[[FlightConfig], float]] = {
    Phase.WAIT: lambda c: c.checks.wait_time_max_s,
    Phase.TAKEOFF: lambda c: c.takeoff.timeout_s,
    Phase.TOUCHDOWN: lambda c: c.touchdown.timeout_s,
    Phase.HOLD: lambda c: c.checks.hold_time_s,
    Phase.CLIMB: lambda c: c.checks.climb_time_max_s,
}


def gather(
    config: FlightConfig,
    strategy: Strategy,
    barrier: Barrier,
    memory: Memory,
    seen: Snapshot,
    command_failed: bool,
    now_s: float,
) -> int:
    """Build the word. Also keeps the timers in ``memory`` that conditions are made of."""
    inputs, status, own = seen.inputs, seen.inputs.status, seen.inputs.own
    word = 0
    if inputs.operator is Operator.EMERGENCY_STOP:
        word |= C.EMERGENCY
    if inputs.operator in (Operator.ABORT, Operator.LAND):
        word |= C.ABORT_ASKED
    if not seen.follows:
        word |= C.NOT_FOLLOWING
    if seen.own_ok:
        memory.own_ok_s = now_s
    elif memory.phase is not Phase.TOUCHDOWN or now_s - memory.own_ok_s > config.touchdown.blind_time_s:
        word |= C.OWN_LOST
    if not seen.link_ok:
        word |= C.LINK_LOST
    if not seen.target_ok:
        word |= C.TARGET_LOST
    if command_failed:
        word |= C.COMMAND_FAILED
    good = seen.own_ok and seen.link_ok and seen.target_ok
    if not good:
        memory.good_since_s = math.inf
    elif memory.good_since_s == math.inf:
        memory.good_since_s = now_s
    if now_s - memory.good_since_s >= config.checks.recovery_time_s:
        word |= C.RECOVERED
    if memory.retries < config.checks.retries_max:
        word |= C.RETRIES_LEFT
    if status is not None:
        word |= _status_conditions(memory, seen, good)
    if memory.started_s < math.inf:
        word |= C.STARTED
        if now_s - memory.started_s > config.checks.landing_time_max_s:
            word |= C.LANDING_TIME_OVER
    limit = _PHASE_TIME_S.get(memory.phase)
    if limit is not None and now_s - memory.phase_since_s > limit(config):
        word |= C.PHASE_TIME_OVER
    if memory.phase is Phase.CLIMB and own is not None:
        word |= C.HIGH_ENOUGH if own.position_enu_m[2] >= high_enough_m(config, barrier, memory) else 0
    if good:
        word |= _place_conditions(config, strategy, barrier, memory, seen, now_s)
    elif memory.phase is Phase.TOUCHDOWN and not seen.own_ok:
        memory.contact = memory.contact or bool(word & C.STANDING)
    elif memory.phase is Phase.TOUCHDOWN and not seen.target_ok:
        # the target went out of sight in the last centimetres
        # its height is moved on from its last samples: it does not change in that time
        at = seen.relative
        stopped = at is not None and _stopped(config, strategy, memory, at, now_s)
        memory.contact = memory.contact or stopped or bool(word & C.STANDING)
    return word


def _status_conditions(memory: Memory, seen: Snapshot, good: bool) -> int:
    status = seen.inputs.status
    assert status is not None
    word = 0
    if status.armed:
        word |= C.ARMED
        memory.was_armed = True
    if status.mode is Mode.EXTERNAL:
        word |= C.EXTERNAL
        memory.was_external = memory.was_external or status.armed  # PX4 stays in it after a landing
    if memory.was_armed:
        word |= C.WAS_ARMED
    if memory.was_external:
        word |= C.WAS_EXTERNAL
    if status.landed is Landed.ON_GROUND:
        word |= C.STANDING
    if good and (status.ready_to_arm or status.armed):
        word |= C.READY
    return word


def _place_conditions(
    config: FlightConfig, strategy: Strategy, barrier: Barrier, memory: Memory, seen: Snapshot, now_s: float
) -> int:
    at = seen.relative
    assert at is not None  # all inputs are good
    own, e = at.own, at.e_m
    word = 0
    takeoff, touchdown = config.takeoff, config.touchdown
    if memory.phase is Phase.TAKEOFF and memory.climbed:
        start = start_point(config, at.target)
        if start is None or (
            math.dist(own.position_enu_m, start) < takeoff.arrival_radius_m
            and math.hypot(*own.velocity_enu_m_s) < takeoff.arrival_speed_m_s
        ):
            word |= C.AT_START
    # the cone is left at a wider radius than it is entered, so that noise does not make the phases chatter
    radius = touchdown.pad_radius_m * (OVER_PAD_LEFT if memory.phase is Phase.LAND else 1.0)
    if at.d_m <= radius and e[2] < max(barrier.peak_height_m, touchdown.height_m):
        word |= C.OVER_PAD
    if strategy.may_touch(at):
        word |= C.TOUCH
    if memory.phase is Phase.TOUCHDOWN:
        memory.contact = (
            memory.contact
            or (_stopped(config, strategy, memory, at, now_s) and at.d_m <= touchdown.pad_radius_m)
            or _stands(config, memory, seen, at, now_s)
        )
        if not memory.contact and strategy.drifts(at):
            word |= C.DRIFTED
    return word


def _stands(config: FlightConfig, memory: Memory, seen: Snapshot, at: Relative, now_s: float) -> bool:
    """The vehicle stands on the pad: it says so, or it is there and no longer sinks though it should."""
    status = seen.inputs.status
    near = at.d_m <= config.touchdown.pad_radius_m
    near = near and at.e_m[2] - config.touchdown.feet_below_reference_m < config.contact.gap_m
    sinking = at.target.velocity_enu_m_s[2] - at.own.velocity_enu_m_s[2]
    if not near or sinking > config.contact.speed_m_s:
        memory.contact_since_s = math.inf
        return False
    memory.contact_since_s = min(memory.contact_since_s, now_s)
    standing = status is not None and status.landed is Landed.ON_GROUND
    return standing or now_s - memory.contact_since_s >= config.contact.time_s


def _stopped(config: FlightConfig, strategy: Strategy, memory: Memory, at: Relative, now_s: float) -> bool:
    """Stopped low over the pad for some samples: two noisy heights do not tell so soon."""
    if not strategy.stopped(at, memory.command):
        memory.stopped_since_s = math.inf
        return False
    memory.stopped_since_s = min(memory.stopped_since_s, now_s)
    held = now_s - memory.stopped_since_s >= config.contact.stopped_time_s
    return held and at.e_m[2] < strategy.stopped_below_m
