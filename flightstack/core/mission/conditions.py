"""Fills the phase machine's word of conditions from what is known in this tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from flightstack.core.memory import Memory
from flightstack.core.mission.phases import C
from flightstack.core.parameters.flight import FilterKind, FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.target.track import TargetState
from flightstack.core.types import Inputs, Landed, Mode, Operator, Phase, Vec3

TOLD_SHARE, STOPPED_SHARE = 0.6, 0.4  # of the descent: told to sink so fast, sinking slower than that
DRIFT_SHARE = 0.6  # of the corridor's radius; nearer to the middle nothing is lost yet
OVER_PAD_LEFT = 1.5  # times the radius at which the cone over the pad is entered


class View(NamedTuple):
    """One tick's inputs, judged by age."""

    inputs: Inputs
    target: TargetState | None
    own_ok: bool
    target_ok: bool
    link_ok: bool
    e_m: Vec3 | None  # vehicle minus landing spot, if both are known
    follows: bool = True  # the vehicle flies what it is told


def view(
    config: FlightConfig,
    inputs: Inputs,
    target: TargetState | None,
    now_s: float,
    *,
    believed: bool = True,
    follows: bool = True,
) -> View:
    """Judge ages; a state from the future by more than one sample is as wrong as an old one.

    Args:
        config: of the flight.
        inputs: of this tick.
        target: where it is.
        now_s: stack clock.
        believed: the own state is plausible.
        follows: the vehicle flies what it is told.
    """
    checks, own, status = config.checks, inputs.own, inputs.status
    own_ok = believed and own is not None and -0.05 <= now_s - own.arrival_s <= checks.own_age_max_s
    target_ok = target is not None and target.age_s <= checks.target_age_max_s
    link_ok = status is not None and now_s - status.arrival_s <= checks.status_age_max_s
    e_m = None
    if own is not None and target is not None:
        p, q = own.position_enu_m, target.position_enu_m
        e_m = (p[0] - q[0], p[1] - q[1], p[2] - q[2])
    return View(inputs, target, own_ok, target_ok, link_ok, e_m, follows)


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
    config: FlightConfig, barrier: Barrier, memory: Memory, seen: View, command_failed: bool, now_s: float
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
        word |= _place_conditions(config, barrier, memory, seen, now_s)
    elif memory.phase is Phase.TOUCHDOWN and not seen.own_ok:
        memory.contact = memory.contact or bool(word & C.STANDING)
    elif memory.phase is Phase.TOUCHDOWN and not seen.target_ok:
        # the target went out of sight in the last centimetres
        blind = _CONTACT_BLIND[config.filter](config, memory, seen, now_s)
        memory.contact = memory.contact or blind or bool(word & C.STANDING)
    return word


def _status_conditions(memory: Memory, seen: View, good: bool) -> int:
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
    config: FlightConfig, barrier: Barrier, memory: Memory, seen: View, now_s: float
) -> int:
    own, target, e = seen.inputs.own, seen.target, seen.e_m
    assert own is not None
    assert target is not None
    assert e is not None
    word = 0
    takeoff, touchdown = config.takeoff, config.touchdown
    if memory.phase is Phase.TAKEOFF and memory.climbed:
        start = start_point(config, target)
        if start is None or (
            math.dist(own.position_enu_m, start) < takeoff.arrival_radius_m
            and math.hypot(*own.velocity_enu_m_s) < takeoff.arrival_speed_m_s
        ):
            word |= C.AT_START
    d = math.hypot(e[0], e[1])
    # the cone is left at a wider radius than it is entered, so that noise does not make the phases chatter
    radius = touchdown.pad_radius_m * (OVER_PAD_LEFT if memory.phase is Phase.LAND else 1.0)
    if d <= radius and e[2] < max(barrier.peak_height_m, touchdown.height_m):
        word |= C.OVER_PAD
    if _MAY_TOUCH[config.filter](config, barrier, seen, e, d):
        word |= C.TOUCH
    if memory.phase is Phase.TOUCHDOWN:
        memory.contact = memory.contact or _CONTACT[config.filter](config, memory, seen, d, now_s)
        if not memory.contact and _DRIFTED[config.filter](config, barrier, seen, e, d):
            word |= C.DRIFTED
    return word


def _may_touch_paper(config: FlightConfig, barrier: Barrier, seen: View, e: Vec3, d_m: float) -> bool:
    del seen
    touchdown = config.touchdown
    return e[2] < touchdown.height_m and d_m <= touchdown.pad_radius_m and barrier.h(e) >= 0.0


def _may_touch_robust(config: FlightConfig, barrier: Barrier, seen: View, e: Vec3, d_m: float) -> bool:
    """Low, in the middle and moving with the target; or on the pad already, pressed down by a gust."""
    del barrier
    robust, touchdown = config.robust, config.touchdown
    if d_m <= touchdown.pad_radius_m and e[2] < touchdown.feet_below_reference_m + config.contact.gap_m:
        return True
    if not (e[2] < robust.commit_height_m and _slip(seen) < robust.commit_speed_m_s):
        return False
    sigma_m = seen.target.position_sigma_m if seen.target is not None else math.inf
    return d_m < robust.commit_radius_m and d_m + robust.sigma_factor * sigma_m < robust.corridor_m


def _slip(seen: View) -> float:
    """Horizontal speed against the target."""
    own, target = seen.inputs.own, seen.target
    assert own is not None
    assert target is not None
    v, t = own.velocity_enu_m_s, target.velocity_enu_m_s
    return math.hypot(v[0] - t[0], v[1] - t[1])


def _drifted_robust(config: FlightConfig, barrier: Barrier, seen: View, e: Vec3, d_m: float) -> bool:
    """Going to leave the corridor above the pad, while still high enough above the cone to climb away."""
    own, target, corridor_m = seen.inputs.own, seen.target, config.robust.corridor_m
    assert own is not None
    assert target is not None
    if d_m < DRIFT_SHARE * corridor_m or barrier.h(e) < config.retreat.h_left_m:
        return False
    v, t = own.velocity_enu_m_s, target.velocity_enu_m_s
    outward = (e[0] * (v[0] - t[0]) + e[1] * (v[1] - t[1])) / d_m
    return d_m + outward * config.retreat.drift_time_s > corridor_m


_MAY_TOUCH: dict[FilterKind, Callable[[FlightConfig, Barrier, View, Vec3, float], bool]] = {
    FilterKind.PAPER: _may_touch_paper,
    FilterKind.ROBUST: _may_touch_robust,
}
_DRIFTED: dict[FilterKind, Callable[[FlightConfig, Barrier, View, Vec3, float], bool]] = {
    FilterKind.PAPER: lambda *_: False,
    FilterKind.ROBUST: _drifted_robust,
}


def _contact(config: FlightConfig, memory: Memory, seen: View, d_m: float, now_s: float) -> bool:
    """The vehicle stands on the pad: it says so, or it is there and no longer sinks though it should."""
    own, target, status, e = seen.inputs.own, seen.target, seen.inputs.status, seen.e_m
    assert own is not None
    assert target is not None
    assert e is not None
    near = d_m <= config.touchdown.pad_radius_m
    near = near and e[2] - config.touchdown.feet_below_reference_m < config.contact.gap_m
    sinking = target.velocity_enu_m_s[2] - own.velocity_enu_m_s[2]
    if not near or sinking > config.contact.speed_m_s:
        memory.contact_since_s = math.inf
        return False
    memory.contact_since_s = min(memory.contact_since_s, now_s)
    standing = status is not None and status.landed is Landed.ON_GROUND
    return standing or now_s - memory.contact_since_s >= config.contact.time_s


def _stopped(config: FlightConfig, memory: Memory, seen: View, now_s: float) -> bool:
    """Told to sink, and not sinking, for some samples: the velocity estimate tells that soonest."""
    own, target, robust = seen.inputs.own, seen.target, config.robust
    if own is None or target is None or not seen.own_ok:
        return False
    told_m_s = target.velocity_enu_m_s[2] - memory.command[2]
    sinking_m_s = target.velocity_enu_m_s[2] - own.velocity_enu_m_s[2]
    if not (told_m_s > TOLD_SHARE * robust.descent_m_s and sinking_m_s < STOPPED_SHARE * robust.descent_m_s):
        memory.stopped_since_s = math.inf
        return False
    memory.stopped_since_s = min(memory.stopped_since_s, now_s)
    return now_s - memory.stopped_since_s >= config.contact.stopped_time_s


def _contact_robust(config: FlightConfig, memory: Memory, seen: View, d_m: float, now_s: float) -> bool:
    """As the paper filter's, or: low over the pad and stopped; two noisy heights do not tell so soon."""
    e = seen.e_m
    assert e is not None
    low = e[2] < config.robust.touch_height_m and d_m <= config.touchdown.pad_radius_m
    stopped = _stopped(config, memory, seen, now_s)
    return (low and stopped) or _contact(config, memory, seen, d_m, now_s)


def _contact_blind(config: FlightConfig, memory: Memory, seen: View, now_s: float) -> bool:
    """The same with a target carried on from its last samples: its height does not change in that time."""
    low = seen.e_m is not None and seen.e_m[2] < config.robust.touch_height_m
    return _stopped(config, memory, seen, now_s) and low


_CONTACT: dict[FilterKind, Callable[[FlightConfig, Memory, View, float, float], bool]] = {
    FilterKind.PAPER: _contact,
    FilterKind.ROBUST: _contact_robust,
}
_CONTACT_BLIND: dict[FilterKind, Callable[[FlightConfig, Memory, View, float], bool]] = {
    FilterKind.PAPER: lambda *_: False,
    FilterKind.ROBUST: _contact_blind,
}
