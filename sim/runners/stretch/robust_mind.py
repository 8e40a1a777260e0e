"""What the robust filter adds to a step, in compiled code: its estimates, margin, rules and corrections.

The functions are those of ``RobustFilter``, put together of the same functions of numbers.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.core.numeric import twin
from flightstack.core.strategies import robust, velocity_tracking
from flightstack.core.target import estimator
from flightstack.core.target.estimator import RESTART_S
from flightstack.core.types import Vec3
from sim.runners.stretch.records import MindRecord, RulesRecord
from sim.runners.stretch.tuples import keep, length, nine, six, thirteen, three

_height_left, _least_climb = twin(robust.height_left, jitted), twin(robust.least_climb, jitted)
_approach, _ahead = twin(robust.approach, jitted), twin(robust.height_ahead, jitted)
_commits, _braked = twin(robust.commits, jitted), twin(robust.braked_m_s, jitted)
is_stopped, leaves_corridor = twin(robust.is_stopped, jitted), twin(robust.leaves_corridor, jitted)
_lead_observed = twin(velocity_tracking.lead_observed, jitted)
_lead_commanded = twin(velocity_tracking.lead_commanded, jitted)
_feedback_observed = twin(velocity_tracking.feedback_observed, jitted)
_feedback_commanded = twin(velocity_tracking.feedback_commanded, jitted)
_updated, _carried = twin(estimator.updated, jitted), twin(estimator.carried, jitted)
_turn, _turn_rate = twin(estimator.turn, jitted), twin(estimator.turn_rate, jitted)
_fading, _lasting = twin(estimator.fading, jitted), twin(estimator.lasting, jitted)
_jerk2 = twin(estimator.raised_jerk2, jitted)


@jitted
def take(p: RulesRecord, m: MindRecord, source_s: float, place: Vec3, moves: Vec3, yaw: float) -> bool:
    """``TargetEstimator.update``; False where it would begin anew."""
    dt_s = source_s - m.time_s
    if not 0.0 < dt_s <= RESTART_S:
        return False
    before_rad, m.yaw, m.time_s = m.yaw, yaw, source_s
    if p.turns:
        turned = 0.0 if math.isnan(before_rad) else _turn_rate(before_rad, yaw, dt_s)
        m.turn_rate += dt_s / (dt_s + estimator.TURN_TIME_S) * (turned - m.turn_rate)
    xy, zz = p.noise_xy, p.noise_z
    (at, speed, push), covariance_xy, covariance_z, innovation2 = _updated(
        (three(m.position), three(m.velocity), three(m.acceleration)),
        (six(m.covariance_xy), six(m.covariance_z)),
        _turn(m.turn_rate, dt_s), _fading(dt_s, p.fade_s), _lasting(dt_s),
        (xy[0], xy[1], _jerk2(xy[2], p.growth2_max, m.surprise)), (zz[0], zz[1], zz[2]),
        place, moves,
    )  # fmt: skip
    keep(m.position, at)
    keep(m.velocity, speed)
    keep(m.acceleration, push)
    for i in range(6):
        m.covariance_xy[i], m.covariance_z[i] = covariance_xy[i], covariance_z[i]
    m.surprise += dt_s / (dt_s + estimator.INNOVATION_TIME_S) * (innovation2 - m.surprise)
    return True


@jitted
def target(p: RulesRecord, m: MindRecord, now_s: float) -> tuple[Vec3, Vec3, float, float]:
    """``RobustFilter.target``: position, velocity, standard deviations of position on x and y, and on z."""
    latest_s = m.time_s + p.target_age_max_s
    dt_s = min(now_s - m.offset_s, latest_s) + p.target_delay_s - m.time_s
    m.target_age_s = max(0.0, now_s - m.sample_source_s - m.offset_s) + p.target_delay_s
    at, speed, _, sigma_m, sigma_z_m, _ = _carried(
        (three(m.position), three(m.velocity), three(m.acceleration)),
        (six(m.covariance_xy), six(m.covariance_z)),
        _turn(m.turn_rate, dt_s), _fading(dt_s, p.fade_s), _lasting(dt_s),
        _jerk2(p.noise_xy[2], p.growth2_max, m.surprise), p.noise_z[2],
    )  # fmt: skip
    return at, speed, sigma_m, sigma_z_m


@jitted
def observe(p: RulesRecord, m: MindRecord, velocity: Vec3) -> None:
    """``VelocityTracking.observe``."""
    model, model_2, disturbance = m.model, m.model_2, m.disturbance
    if not m.commanding:
        keep(model, velocity)
        keep(model_2, (0.0, 0.0, 0.0))
        keep(m.slope, (0.0, 0.0, 0.0))
        return
    for i in range(3):
        v, u, now, rise, d = velocity[i], m.setpoint[i], model[i], model_2[i], disturbance[i]
        if i == 2:
            model[i], model_2[i], disturbance[i] = _lead_observed(nine(p.lead_z), v, u, now, rise, d)
        elif p.by_feedback:
            model[i], model_2[i], disturbance[i] = _feedback_observed(
                thirteen(p.feedback), v, u, now, rise, d
            )
        else:
            model[i], model_2[i], disturbance[i] = _lead_observed(nine(p.lead_xy), v, u, now, rise, d)


@jitted
def margin_m(p: RulesRecord, sigma_m: float, sigma_z_m: float) -> float:
    """Of its barrier."""
    spread_m = length(p.slope_at_pad * length(sigma_m, p.own_noise_m), length(sigma_z_m, p.own_noise_m))
    margin_m: float = (p.margin_fixed_m + p.sigma_factor * spread_m) / p.margin_full
    return margin_m


@jitted
def _braked_m_s(p: RulesRecord, m: MindRecord, left_m: float) -> float:
    """``RobustFilter._braked_m_s``."""
    if not p.weighs:
        return math.inf
    most_m_s: float = _braked(left_m, m.rises_m_s2)
    return most_m_s


@jitted
def approach(
    p: RulesRecord, m: MindRecord, e: Vec3, d_m: float, slip: tuple[float, float], target_m_s: Vec3,
    over_pad: bool,
) -> Vec3:  # fmt: skip
    """To a place low above the pad."""
    above_m = e[2] - p.wait_height_m - _ahead(e, d_m, slip, p.brakes_m_s2, p.alpha_1_m, p.beta_m)
    over_1_s = p.gain_over_1_s if over_pad else p.gain_1_s
    most_m_s, least_m_s = min(p.descent_max_m_s, _braked_m_s(p, m, above_m)), p.descent_min_m_s
    wanted: Vec3 = _approach(e, above_m, over_1_s, p.gain_1_s, target_m_s, most_m_s, least_m_s)
    return wanted


@jitted
def climb(
    p: RulesRecord, m: MindRecord, h_m: float, gradient: Vec3, before_z_m_s: float, own_m_s: Vec3,
    target_m_s: Vec3,
) -> float:  # fmt: skip
    """Least vertical velocity."""
    left_m = _height_left(h_m, p.lag_z_s, own_m_s[2], before_z_m_s)
    sinks_m_s = min(p.rate_1_s * left_m, _braked_m_s(p, m, left_m))
    least_m_s: float = _least_climb(gradient, own_m_s, target_m_s, sinks_m_s)
    return least_m_s


@jitted
def may_touch(p: RulesRecord, e: Vec3, d_m: float, slip: tuple[float, float], sigma_m: float) -> bool:
    """Low, in the middle and moving with the target, or on the pad already."""
    if d_m <= p.pad_radius_m and e[2] < p.standing_m:
        return True
    uncertain_m = p.sigma_factor * sigma_m
    height_m, speed_m_s, radius_m = p.commit_height_m, p.commit_speed_m_s, p.commit_radius_m
    return bool(_commits(e[2], d_m, slip, uncertain_m, height_m, speed_m_s, radius_m, p.corridor_m))


@jitted
def setpoint(
    p: RulesRecord, m: MindRecord, before: Vec3, wanted: Vec3, velocity: Vec3, least_z: float, d_m: float
) -> Vec3:
    """``VelocityTracking.command``."""
    slope, sent = m.slope, m.setpoint
    feedback = p.far_feedback if d_m > p.far_m else p.feedback
    for i in range(3):
        b, r, v, s, d, most = before[i], wanted[i], velocity[i], slope[i], m.disturbance[i], p.most[i]
        if i == 2:
            slope[i], sent[i] = _lead_commanded(nine(p.lead_z), b, r, v, s, d, most)
        elif p.by_feedback:
            slope[i], sent[i] = _feedback_commanded(
                thirteen(feedback), b, r, s, m.model[i], m.model_2[i], d, most
            )
        else:
            slope[i], sent[i] = _lead_commanded(nine(p.lead_xy), b, r, v, s, d, most)
    sent[2] = min(max(sent[2], least_z - m.disturbance[2]), p.most[2])
    return three(sent)
