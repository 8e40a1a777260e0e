"""What a step learns of the vehicle, in compiled code: own state and thrust reserve.

The functions are those of ``OwnEstimator`` and ``ReserveEstimate``, put together of the same functions of
numbers.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64
from flightstack.core.memory import AxisState
from flightstack.core.numeric import twin
from flightstack.core.target import own_estimator, reserve
from flightstack.core.target.own_estimator import GAP_MAX_S, KNOWN
from flightstack.core.target.reserve import AGE_MAX_S
from flightstack.core.types import Phase, Vec3
from sim.runners.stretch.records import MindRecord, RulesRecord
from sim.runners.stretch.tuples import five, keep, three

_TOUCHDOWN = Phase.TOUCHDOWN.value
_moved, _learned = twin(own_estimator.moved, jitted), twin(own_estimator.learned, jitted)
_raised, _to_be_told = twin(own_estimator.raised, jitted), twin(own_estimator.to_be_told, jitted)
_on_its_way, _ticks_of = twin(own_estimator.on_its_way, jitted), twin(own_estimator.ticks_of, jitted)
_estimated, _allowed = twin(reserve.estimated, jitted), twin(reserve.allowed, jitted)


@jitted
def _keep5(into: F64, v: AxisState) -> None:
    into[0], into[1], into[2], into[3], into[4] = v


@jitted
def _learn(p: RulesRecord, m: MindRecord, position: Vec3, velocity: Vec3, elapsed_s: float) -> None:
    """``OwnEstimator._learn``."""
    at, model, most_m_s = 3 * _on_its_way(p.own_ahead, -1), five(p.own_model), p.own_most_m_s
    gains, ticks = p.own_gains, _ticks_of(elapsed_s, p.period_s, p.own_gap_max)
    x, y, ux, uy = five(m.own_x), five(m.own_y), m.pending[at], m.pending[at + 1]
    both = (five(gains[:5]), five(gains[5:]))
    _keep5(m.own_x, _learned(x, ux, ticks, model, position[0], velocity[0], both, most_m_s))
    _keep5(m.own_y, _learned(y, uy, ticks, model, position[1], velocity[1], both, most_m_s))
    m.own_z_m, m.own_z_error_m_s = _raised(
        m.own_z_m, m.own_z_error_m_s, position[2], velocity[2], elapsed_s, p.own_rate_up_1_s, p.own_most_m_s
    )


@jitted
def _begin(m: MindRecord, position: Vec3, velocity: Vec3) -> None:
    """``OwnEstimator._begin``."""
    m.own_z_m, m.own_z_error_m_s = position[2], 0.0
    _keep5(m.own_x, (position[0], velocity[0], 0.0, 0.0, 0.0))
    _keep5(m.own_y, (position[1], velocity[1], 0.0, 0.0, 0.0))
    for k in range(KNOWN):
        keep(m.pending[3 * k :], (velocity[0], velocity[1], 0.0))


@jitted
def estimated(
    p: RulesRecord, m: MindRecord, position: Vec3, velocity: Vec3, source_s: float
) -> tuple[Vec3, Vec3]:
    """``OwnEstimator.step``: position and velocity of now."""
    last = 3 * (KNOWN - 1)
    for i in range(last):
        m.pending[i] = m.pending[i + 3]
    keep(m.pending[last:], three(m.told))
    elapsed_s = source_s - m.own_time_s
    if not 0.0 <= elapsed_s <= GAP_MAX_S:  # NaN before the first
        m.own_time_s = source_s
        _begin(m, position, velocity)
    elif elapsed_s > 0.0:
        m.own_time_s = source_s
        _learn(p, m, position, velocity, elapsed_s)
    x, y, model = five(m.own_x), five(m.own_y), five(p.own_model)
    for k in range(p.own_ahead):
        at = 3 * _on_its_way(p.own_ahead, k)
        x, y = _moved(x, m.pending[at], model), _moved(y, m.pending[at + 1], model)
    _keep5(m.own_x_now, x)
    _keep5(m.own_y_now, y)
    z_m_s = velocity[2] - m.own_z_error_m_s
    return (x[0], y[0], m.own_z_m + p.own_delay_s * z_m_s), (x[1], y[1], z_m_s)


@jitted
def observed(p: RulesRecord, m: MindRecord) -> None:
    """What ``RobustFilter.observe`` takes from it."""
    if not m.commanding:
        m.own_time_s = math.nan
    elif p.by_feedback:
        m.model[0], m.model[1] = m.own_x_now[1], m.own_y_now[1]
        m.model_2[0], m.model_2[1] = m.own_x_now[2], m.own_y_now[2]
        m.disturbance[0], m.disturbance[1] = m.own_x_now[4] / p.own_push_1_s, m.own_y_now[4] / p.own_push_1_s


@jitted
def to_be_told(p: RulesRecord, m: MindRecord, setpoint: Vec3) -> Vec3:
    """``OwnEstimator.told``."""
    told: Vec3 = _to_be_told(setpoint, (m.own_x_now[3], m.own_y_now[3], m.own_z_error_m_s), three(p.most))
    return told


@jitted
def weighs(p: RulesRecord, m: MindRecord, rises_m_s: float, now_s: float) -> bool:
    """``Controller._weigh``; False where the battery is not fit, or not known."""
    if not now_s - p.power_s <= AGE_MAX_S:
        return False
    flies = m.commanding and p.phase != _TOUCHDOWN
    effort = p.effort_flying if flies else p.effort_resting
    if math.isnan(effort):
        return False
    if not p.flies or math.isnan(m.effort):
        m.effort, m.rise_m_s = effort, rises_m_s
    share = p.reserve_share
    m.effort, m.rise_m_s, left = _estimated(
        m.effort, m.rise_m_s, effort, rises_m_s, share, share if flies else 1.0, p.reserve_lasting_m_s,
        p.reserve_sags, p.reserve_most,
    )  # fmt: skip
    if p.flies and not left >= p.reserve_least:
        return False
    x, y, z = _allowed(three(p.reserve_most_m_s2), left, p.thrust_share)
    t = p.period_s
    m.step[0], m.step[1], m.up_step_m_s, m.rises_m_s2 = x * t, y * t, z * t, z
    return True
