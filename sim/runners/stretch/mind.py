"""One step of the controller in compiled code, while it flies to the pad and onto it, or stands there.

It calls the functions of numbers that ``Controller.step`` calls, in the same order, for the phases APPROACH,
LAND, TOUCHDOWN and LANDED of the robust and of the paper's filter. Whatever does not happen in most ticks it
leaves to Python, and says so before anything has changed: a phase that ends, a sample or a command that is
refused, a bound that is near.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.program import HOPELESS, NONE, filtered
from flightstack.compiled.records import F64
from flightstack.core import sender_clock
from flightstack.core.mission import conditions
from flightstack.core.mission.conditions import OVER_PAD_LEFT
from flightstack.core.mission.machine import SLIDING_TIME_S
from flightstack.core.numeric import twin
from flightstack.core.safety import position_loop, robust_barrier
from flightstack.core.safety.barrier import barrier_h
from flightstack.core.safety.gate import BOX_TOLERANCE_M_S, SOLVER_TOLERANCE_M_S
from flightstack.core.target import plausibility, track
from flightstack.core.types import Phase, Vec3
from sim.runners.stretch import paper_mind as paper
from sim.runners.stretch import robust_mind as robust
from sim.runners.stretch import vehicle_mind as vehicle
from sim.runners.stretch.records import MindRecord, RulesRecord
from sim.runners.stretch.tuples import keep, length, three

STANDS, SENDS, PYTHON = 0, 1, 2  # no set-point goes out, one does, and this tick is Python's
_APPROACH, _LAND = int(Phase.APPROACH), int(Phase.LAND)
_TOUCHDOWN = int(Phase.TOUCHDOWN)


_limit, _slew = twin(position_loop.limit, jitted), twin(position_loop.slew, jitted)
_nominal = twin(position_loop.nominal_velocity, jitted)
_robust_h, _bound = twin(robust_barrier.robust_h, jitted), twin(robust_barrier.robust_bound, jitted)
_evaluated = twin(robust_barrier.robust_evaluated, jitted)
_barrier_h = twin(barrier_h, jitted)
_waits = twin(conditions.waits, jitted)
_learnt = twin(sender_clock.learnt, jitted)
_strayed2 = twin(track.strayed2_m2, jitted)
_drifted, _missed = twin(plausibility.drifted, jitted), twin(plausibility.missed, jitted)
_smoothed = twin(plausibility.smoothed, jitted)


@jitted
def _take_sample(p: RulesRecord, m: MindRecord, sample: F64, now_s: float) -> bool:
    """``TargetTrack.accept``, and what the filter makes of it; False where the sample is no ordinary one."""
    source_s, x, y, z = sample[0], sample[1], sample[2], sample[3]
    vx, vy, vz, yaw, rate = sample[4], sample[5], sample[6], sample[7], sample[8]
    if not math.isfinite(x + y + z + vx + vy + vz + yaw + source_s):
        return False
    step_s = source_s - m.sample_source_s
    p0, v0 = m.sample_position, m.sample_velocity
    if vx * vx + vy * vy + vz * vz > p.target_speed2_max or not step_s > 0.0:
        return False
    way_s, gap_s = now_s - source_s, now_s - m.sample_arrival_s
    if gap_s > p.target_age_max_s or way_s - m.offset_s > p.target_age_max_s:
        return False
    if way_s < m.floor_s - p.ahead_max_s:
        return False
    if p0[0] == x and p0[1] == y and p0[2] == z:
        return False
    strayed2 = _strayed2(three(p0), three(v0), (x, y, z), (vx, vy, vz), step_s)
    if not strayed2 <= p.target_jump2_max:
        return False
    if step_s <= p.target_age_max_s:
        d = _drifted(
            three(m.target_drift), three(p0), (x, y, z), three(v0), (vx, vy, vz), step_s,
            p.target_drift_memory_s,
        )  # fmt: skip
        smooth = _smoothed(three(m.target_drift_smooth), d, step_s)
        if not smooth[0] * smooth[0] + smooth[1] * smooth[1] + smooth[2] * smooth[2] < p.target_drift2_max_m2:
            return False
        keep(m.target_drift, d)
        keep(m.target_drift_smooth, smooth)
    m.sample_arrival_s, m.sample_source_s, m.sample_yaw, m.sample_rate = now_s, source_s, yaw, rate
    keep(p0, (x, y, z))
    keep(v0, (vx, vy, vz))
    m.offset_s, m.floor_s, m.held_s = _learnt(m.offset_s, m.floor_s, m.held_s, way_s, gap_s)
    m.accepted += 1
    if p.paper:
        return True
    return robust.take(p, m, source_s, (x, y, z), (vx, vy, vz), yaw)


@jitted
def _take_own(
    p: RulesRecord, m: MindRecord, position: Vec3, velocity: Vec3, source_s: float, now_s: float
) -> bool:
    """``Plausibility``; False where the state repeats or a bound is near."""
    p0, v0 = three(m.own_position), three(m.own_velocity)
    if p0[0] == position[0] and p0[1] == position[1] and p0[2] == position[2]:
        return False
    dt_s = now_s - m.own_arrival_s
    if not 0.0 < dt_s <= p.own_age_max_s:
        return False
    dx, dy, dz = _drifted(three(m.drift), p0, position, v0, velocity, dt_s, p.drift_memory_s)
    if not dx * dx + dy * dy + dz * dz < p.drift2_max_m2:
        return False
    keep(m.drift, (dx, dy, dz))
    keep(m.own_position, position)
    keep(m.own_velocity, velocity)
    m.own_arrival_s, m.own_source_s = now_s, source_s
    if not m.commanding:
        keep(m.missed, (0.0, 0.0, 0.0))
        return True
    x, y, z = _missed(three(m.missed), three(m.command), velocity, p.period_s, p.missed_kept)
    keep(m.missed, (x, y, z))
    return bool(x * x + y * y + z * z < p.missed2_max_m2)


@jitted
def _touches(
    p: RulesRecord,
    m: MindRecord,
    e: Vec3,
    d_m: float,
    slip: tuple[float, float],
    rises: float,
    pad_rises: float,
    now_s: float,
) -> bool:
    """``Mission._contact`` while there has been none; its timers go on."""
    on_pad, gap_m = d_m <= p.pad_radius_m + p.beyond_m, e[2] - p.feet_m
    if not p.paper and robust.is_stopped(pad_rises, m.command[2], rises, p.descent_m_s):
        m.stopped_since_s = min(m.stopped_since_s, now_s)
        held = now_s - m.stopped_since_s >= p.stopped_time_s
        if held and e[2] < p.stopped_below_m and on_pad:
            return True
    else:
        m.stopped_since_s = math.inf
    slides = p.sliding_gap_m > max(0.0, gap_m)
    if on_pad and slides and d_m + SLIDING_TIME_S * length(slip[0], slip[1]) > p.sliding_radius_m:
        return True
    if not (on_pad and gap_m < p.gap_m) or pad_rises - rises > p.sinks_m_s:
        m.contact_since_s = math.inf
        return False
    m.contact_since_s = min(m.contact_since_s, now_s)
    return bool(now_s - m.contact_since_s >= p.contact_time_s)


@jitted
def _waits_for_calm(p: RulesRecord, e: Vec3, target_m_s: Vec3, now_s: float) -> bool:
    """``waits_for_calm``."""
    waited_s = now_s - p.started_s
    return bool(_waits(waited_s, e[2], target_m_s, p.calm_wait_s, p.standing_m, p.calm_speed_m_s))


@jitted
def _leaves_phase(
    p: RulesRecord, m: MindRecord, e: Vec3, d_m: float, slip: tuple[float, float], sigma_m: float,
    rises: float, target_m_s: Vec3, now_s: float,
) -> bool:  # fmt: skip
    """Whether a rule of the phase may fire."""
    if p.phase == _APPROACH or p.phase == _LAND:
        if now_s - p.started_s > p.landing_time_max_s:
            return True
        radius_m = p.pad_radius_m * (OVER_PAD_LEFT if p.phase == _LAND else 1.0)
        over = bool(d_m <= radius_m and e[2] < p.low_m)
        if over != (p.phase == _LAND):
            return True
        if p.phase == _APPROACH:
            return False
        if d_m <= p.pad_radius_m + p.beyond_m and e[2] - p.feet_m < p.gap_m:  # it may stand there
            return True
        m.contact_since_s = math.inf
        waited_s = now_s - max(p.since_s, p.started_s + p.calm_wait_s)
        if not p.paper and waited_s > p.over_pad_time_max_s:
            return True
        touches = paper.may_touch(p, e, d_m) if p.paper else robust.may_touch(p, e, d_m, slip, sigma_m)
        return touches and not _waits_for_calm(p, e, target_m_s, now_s)
    if p.phase == _TOUCHDOWN:
        if now_s - p.since_s > p.touchdown_time_s:
            return True
        if _touches(p, m, e, d_m, slip, rises, target_m_s[2], now_s):
            return True
        if _barrier_h(p.alpha_1_m, p.beta_m, e) < p.h_left_m:
            return False
        if _waits_for_calm(p, e, target_m_s, now_s):
            return True
        if p.paper:
            return False
        return bool(robust.leaves_corridor(e, d_m, slip, p.corridor_m, p.drift_time_s))
    return bool(now_s - p.since_s >= p.settle_s)  # LANDED


@jitted
def _inside(p: RulesRecord, v: Vec3, altitude_m: float) -> bool:
    """``Gate._verdict`` but for the barrier."""
    if not math.isfinite(v[0] + v[1] + v[2] + p.yaw_rad + altitude_m):
        return False
    for i in range(3):
        if abs(v[i]) > p.most[i] + BOX_TOLERANCE_M_S:
            return False
    return bool(altitude_m <= p.altitude_max_m or v[2] <= 0.0)


@jitted
def _land(
    p: RulesRecord, m: MindRecord, e: Vec3, d_m: float, slip: tuple[float, float], sigma_m: float,
    sigma_z_m: float, base: Vec3, own_m_s: Vec3, target_m_s: Vec3, now_s: float,
) -> tuple[Vec3, bool]:  # fmt: skip
    """Filtered velocity on the way to the pad, and whether the gate's check of the barrier passes it."""
    if p.paper:
        nominal, margin_m = paper.approach(p, e, target_m_s), 0.0
    else:
        nominal = robust.approach(p, m, e, d_m, slip, target_m_s, p.phase == _LAND)
        margin_m = robust.margin_m(p, sigma_m, sigma_z_m)
    if _waits_for_calm(p, e, target_m_s, now_s):
        up_m_s = target_m_s[2] + p.calm_gain_1_s * (p.calm_height_m - e[2])
        nominal = (nominal[0], nominal[1], max(nominal[2], up_m_s))
    shape, fade_m = (p.alpha_1_m, p.beta_m, p.smoothing_m), p.margin_fade_m
    h_m, gradient, dh_dt = _evaluated(shape, margin_m, fade_m, e, target_m_s)
    (bx, by, bz), (sx, sy, sz), (mx, my, mz) = base, three(m.step), three(p.most)
    x, y, z = bx - sx, by - sy, bz - sz
    lx, ly, lz = x if x > -mx else -mx, y if y > -my else -my, z if z > -mz else -mz
    x, y, z = bx + sx, by + sy, bz + (sz if sz < m.up_step_m_s else m.up_step_m_s)
    upper = (x if x < mx else mx, y if y < my else my, z if z < mz else mz)
    if not p.paper:
        climb = robust.climb(p, m, h_m, gradient, bz, own_m_s, target_m_s)
        if climb > lz:
            lz = min(climb, upper[2])
    v, how, _, _ = filtered(p.program, p.rate_1_s, nominal, h_m, gradient, dh_dt, (lx, ly, lz), upper)
    if how == NONE:
        return v, False
    # Gate._keeps_promise
    t = p.period_s
    now_m = _robust_h(shape, margin_m, fade_m, e)
    vx, vy, vz = v[0] - target_m_s[0], v[1] - target_m_s[1], v[2] - target_m_s[2]
    then_m = _robust_h(shape, margin_m, fade_m, (e[0] + vx * t, e[1] + vy * t, e[2] + vz * t))
    if not math.isfinite(now_m + then_m):
        return v, False
    if how == HOPELESS:
        return v, True
    missing_m = now_m * (1.0 - p.rate_1_s * t) - then_m - SOLVER_TOLERANCE_M_S * t
    return v, missing_m <= 0.0 or missing_m <= _bound(shape, margin_m, fade_m, e, length(vx, vy) * t)


@jitted
def think(
    p: RulesRecord, m: MindRecord, position: Vec3, velocity: Vec3, source_s: float, samples: F64, first: int,
    last: int, now_s: float,
) -> int:  # fmt: skip
    """``Controller.step``.

    Args:
        p: as it is.
        m: changed in place, also where the result is ``PYTHON``: then it is of no use any more.
        position: own, as the vehicle told it, ENU, m.
        velocity: likewise, m/s.
        source_s: boot clock of the vehicle.
        samples: of the target, one a row.
        first: of those that have come.
        last: end of those.
        now_s: stack clock.

    Returns:
        ``STANDS``, ``SENDS`` (the set-point is in ``m``) or ``PYTHON``.
    """
    for i in range(first, last):
        if not _take_sample(p, m, samples[i], now_s):
            return PYTHON
    seen = paper.target(p, m, now_s) if p.paper else robust.target(p, m, now_s)
    target, target_m_s, sigma_m, sigma_z_m = seen
    if not _take_own(p, m, position, velocity, source_s, now_s):
        return PYTHON
    if p.learns:
        (x, y, z), velocity = vehicle.estimated(p, m, position, velocity, source_s)
    else:
        t = p.own_delay_s
        x, y, z = position[0] + t * velocity[0], position[1] + t * velocity[1], position[2] + t * velocity[2]
    if not p.paper:
        robust.observe(p, m, velocity)
    if p.learns:
        vehicle.observed(p, m)
    if p.weighs and not vehicle.weighs(p, m, velocity[2], now_s):
        return PYTHON
    if m.target_age_s > p.target_age_max_s or now_s - p.status_s > p.status_age_max_s or now_s >= p.ends_s:
        return PYTHON
    e = (x - target[0], y - target[1], z - target[2])
    d_m, slip = length(e[0], e[1]), (velocity[0] - target_m_s[0], velocity[1] - target_m_s[1])
    keep(m.target_position, target)
    keep(m.target_velocity, target_m_s)
    if _leaves_phase(p, m, e, d_m, slip, sigma_m, velocity[2], target_m_s, now_s):
        return PYTHON
    if not p.flies:
        m.commanding = False
        return STANDS
    most = three(p.most)
    base = three(m.command) if m.commanding else _limit(velocity, most)
    least_z = -math.inf
    if p.phase == _TOUCHDOWN:
        ax, ay, _ = _nominal(e, three(p.gain_contact_1_s), target_m_s)
        asked = _limit((ax, ay, target_m_s[2] - p.descent_m_s), most)
        wanted, kept = _slew(base, asked, three(m.step), m.up_step_m_s), True
        least_z = target_m_s[2] - p.contact_speed_m_s
    else:
        wanted, kept = _land(p, m, e, d_m, slip, sigma_m, sigma_z_m, base, velocity, target_m_s, now_s)
    if not kept:
        return PYTHON
    if p.paper:
        setpoint = paper.setpoint(m, wanted)
    else:
        setpoint = robust.setpoint(p, m, base, wanted, velocity, least_z, d_m)
        if p.learns:
            setpoint = vehicle.to_be_told(p, m, setpoint)
    if not (_inside(p, wanted, z) and _inside(p, setpoint, z)):
        return PYTHON
    keep(m.command, wanted)
    keep(m.told, setpoint)
    m.commanding = True
    return SENDS
