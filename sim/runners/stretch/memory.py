"""Controller and record: what the one remembers is written into the other, and back."""

from __future__ import annotations

import math
from itertools import chain
from typing import Any

from flightstack.compiled.records import reader, writer
from flightstack.core.controller import Controller
from flightstack.core.memory import ReserveMemory
from flightstack.core.mission.conditions import LANDED_SETTLE_S
from flightstack.core.parameters.ends import TouchdownRule
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.robust import RobustFilter
from flightstack.core.strategies.velocity_tracking import FeedbackAxis
from flightstack.core.target.own_estimator import OwnEstimator
from flightstack.core.types import OwnState, TargetSample
from sim.runners.stretch.records import MindRecord, RulesRecord

_NEAR = 0.99 * 0.99  # share of a bound, squared, from which on Python decides
SPEED_MAX_M_S = 2.5  # on each axis; with more the autopilot's own bound of set-points may count


def suits(config: FlightConfig) -> bool:
    """Whether ``think`` knows everything that this configuration asks for."""
    return (
        config.filter in ("robust", "paper")
        and config.fleet is None
        and config.velocity_loop.dead_time_s == 0.0  # set-points under way have no place in the record
        and config.touchdown.rule is TouchdownRule.CONTACT
        and max(config.limits.velocity_max_m_s) <= SPEED_MAX_M_S
        and (config.checks.target_frame, config.checks.target_child_frame) == ("map", "target")
    )


def set_up_rules(r: RulesRecord, controller: Controller) -> None:
    """Fill in what does not change in a flight."""
    config, strategy = controller.config, controller.strategy
    checks, touchdown, contact = config.checks, config.touchdown, config.contact
    retreat, barrier, watched = config.retreat, controller.barrier, controller.plausibility
    r.period_s, r.own_age_max_s = watched.period_s, checks.own_age_max_s
    r.drift_memory_s, r.missed_kept = checks.own_drift_memory_s, watched.kept
    r.drift2_max_m2 = _NEAR * checks.own_drift_max_m**2
    r.missed2_max_m2 = _NEAR * watched.tracking_lag_max_m**2
    r.target_age_max_s, r.ahead_max_s = checks.target_age_max_s, controller.track.ahead_max_s
    r.target_speed2_max, r.target_jump2_max = checks.target_speed_max_m_s**2, checks.target_jump_max_m**2
    r.target_drift_memory_s = checks.target_drift_memory_s
    r.target_drift2_max_m2 = _NEAR * checks.target_drift_max_m**2
    r.status_age_max_s, r.landing_time_max_s = checks.status_age_max_s, checks.landing_time_max_s
    r.settle_s, r.over_pad_time_max_s = LANDED_SETTLE_S, checks.over_pad_time_max_s
    r.alpha_1_m, r.beta_m, r.smoothing_m = barrier.alpha_1_m, barrier.beta_m, barrier.smoothing_m
    r.pad_radius_m, r.low_m = touchdown.pad_radius_m, max(barrier.peak_height_m, touchdown.height_m)
    r.rate_1_s, r.lag_z_s = strategy.rate_1_s, config.velocity_loop.lag_z_s
    r.standing_m = touchdown.feet_below_reference_m + contact.gap_m
    r.drift_time_s, r.h_left_m = retreat.drift_time_s, retreat.h_left_m
    r.touchdown_time_s, r.contact_speed_m_s = touchdown.timeout_s, strategy.contact_speed_max_m_s
    r.beyond_m, r.feet_m, r.gap_m = contact.beyond_m, touchdown.feet_below_reference_m, contact.gap_m
    r.sinks_m_s, r.contact_time_s, r.stopped_time_s = (
        contact.speed_m_s, contact.time_s, contact.stopped_time_s,
    )  # fmt: skip
    r.stopped_below_m = strategy.stopped_below_m
    r.sliding_gap_m, r.sliding_radius_m = contact.sliding_gap_m, contact.sliding_radius_m
    r.most[:], r.altitude_max_m = config.limits.velocity_max_m_s, config.limits.altitude_max_m
    r.calm_wait_s, r.calm_speed_m_s = touchdown.calm_wait_s, touchdown.calm_speed_m_s
    r.calm_height_m, r.calm_gain_1_s = touchdown.calm_height_m, config.position_loop.gain_1_s[2]
    table, estimate = config.reserve, controller.reserve_estimate
    if table is not None and estimate is not None:
        r.weighs, r.reserve_share, r.reserve_lasting_m_s = True, estimate.share, estimate.lasting_m_s
        r.reserve_least, r.thrust_share = estimate.least, table.share
        r.reserve_most_m_s2[:] = estimate.most_m_s2
    if isinstance(strategy, RobustFilter):
        _set_up_robust(r, config, strategy)
    else:
        _set_up_paper(r, config)


def _set_up_paper(r: RulesRecord, config: FlightConfig) -> None:
    """Without estimates; and without a margin of the barrier, which may then fade within any radius."""
    r.paper, r.margin_fade_m = True, 1.0
    r.gain_contact_1_s[:] = config.position_loop.gain_1_s
    r.descent_m_s, r.touch_height_m = config.touchdown.descent_m_s, config.touchdown.height_m


def _set_up_robust(r: RulesRecord, config: FlightConfig, strategy: RobustFilter) -> None:
    robust, target, estimator = config.robust, config.target, strategy.estimator
    r.own_delay_s, r.own_noise_m = config.own.delay_s, config.own.position_noise_m
    r.target_delay_s, r.fade_s, r.turns = target.delay_s, target.acceleration_time_s, target.turns_with_yaw
    r.growth2_max, r.noise_xy[:], r.noise_z[:] = (
        estimator.growth2_max,
        estimator.noise_xy,
        estimator.noise_z,
    )
    r.slope_at_pad, r.sigma_factor = strategy.slope, robust.sigma_factor
    r.margin_fixed_m = robust.tracking_error_m_s / robust.rate_1_s
    r.margin_full, r.margin_fade_m = strategy.full, robust.fade_radius_m
    r.gain_1_s, r.gain_over_1_s, r.gain_contact_1_s[:] = (
        robust.gain_1_s, robust.gain_over_pad_1_s, robust.to_contact_1_s,
    )  # fmt: skip
    r.wait_height_m, r.descent_m_s = robust.wait_height_m, robust.descent_m_s
    r.descent_max_m_s, r.descent_min_m_s = robust.descent_max_m_s, robust.descent_min_m_s
    r.brakes_m_s2 = strategy.brakes_m_s2
    r.commit_height_m, r.commit_speed_m_s = robust.commit_height_m, robust.commit_speed_m_s
    r.commit_radius_m, r.corridor_m = robust.commit_radius_m, robust.corridor_m
    if strategy.own_estimator is not None:
        _set_up_own(r, strategy.own_estimator)
    level, _, up = strategy.axes
    r.by_feedback = isinstance(level, FeedbackAxis)
    if isinstance(level, FeedbackAxis):
        r.feedback[:], r.far_feedback[:] = level.numbers, strategy.far_axes[0].numbers
        r.far_m = config.velocity_feedback.far_m
    else:
        r.lead_xy[:] = level.numbers
    r.lead_z[:] = up.numbers


def _set_up_own(r: RulesRecord, own: OwnEstimator) -> None:
    r.learns, r.own_model[:], r.own_gains[:] = True, own.model, (*own.gains.position, *own.gains.velocity)
    r.own_ahead, r.own_gap_max = own.ahead, own.gap_max
    r.own_push_1_s, r.own_rate_up_1_s, r.own_most_m_s = own.push_1_s, own.rate_up_1_s, own.most_m_s


class Notebook:
    """Writes a controller's memory into a record, and back."""

    def __init__(self, record: MindRecord, controller: Controller) -> None:
        self._controller = controller
        self._read, self._write = reader(record), writer(record)

    def write(self) -> None:
        """Controller to record."""
        c = self._controller
        memory, track, strategy = c.memory, c.track.memory, c.strategy
        motion, tracking, watched = strategy.motion, strategy.tracking, c.plausibility.memory
        sample, own, learned = track.last, watched.last, strategy.own
        assert sample is not None
        assert own is not None
        estimate = c.reserve_estimate
        reserve = ReserveMemory() if estimate is None else estimate.memory
        self._write(
            memory.contact_since_s, memory.stopped_since_s, memory.commanding, *memory.command,
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            sample.arrival_s, sample.source_time_s, *sample.position_enu_m, *sample.velocity_enu_m_s,
            sample.yaw_rad, sample.yaw_rate_rad_s, track.offset_s, 0,
            motion.time_s, *motion.position_enu_m, *motion.velocity_enu_m_s, *motion.acceleration_enu_m_s2,
            math.nan if motion.yaw_rad is None else motion.yaw_rad, motion.turn_rate_rad_s, motion.surprise,
            *motion.covariance_xy, *motion.covariance_z,
            *tracking.slope_m_s2, *tracking.setpoint_m_s, *tracking.model_m_s, *tracking.model_m_s2,
            *tracking.disturbance_m_s,
            own.arrival_s, own.source_time_s, *own.position_enu_m, *own.velocity_enu_m_s, own.yaw_rad,
            *watched.drift_m, *watched.missed_m,
            learned.time_s, *learned.x, *learned.y, learned.z_m, learned.z_error_m_s, *learned.x_now,
            *learned.y_now, *learned.sent_m_s, *chain.from_iterable(learned.pending),
            reserve.effort, reserve.rise_m_s, *track.drift_m, *track.drift_smooth_m, *c.slew_step,
            c.up_step_m_s, 0.0, 0.0, track.floor_s, track.held_s,
        )  # fmt: skip

    def read(self, now_s: float, own_yaw_rad: float) -> None:
        """Record to controller; ``now_s`` is the time of the last tick."""
        v: Any = self._read()
        c = self._controller
        memory, track, strategy = c.memory, c.track.memory, c.strategy
        motion, tracking, watched = strategy.motion, strategy.tracking, c.plausibility.memory
        memory.contact_since_s, memory.stopped_since_s, memory.commanding = v[0], v[1], bool(v[2])
        memory.command, memory.own_ok_s = v[3:6], now_s
        memory.target_position_enu_m, memory.target_velocity_enu_m_s = v[6:9], v[9:12]
        if v[23]:  # samples accepted
            track.last = TargetSample(v[12], v[13], "map", "target", v[14:17], v[17:20], v[20], v[21])
            track.offset_s, track.floor_s, track.held_s = v[22], v[-2], v[-1]
            track.taken_s, track.stamp_s, track.refusal = v[12], v[13], ""
            track.accepted += v[23]
            track.drift_m, track.drift_smooth_m = v[119:122], v[122:125]
        watched.last = OwnState(v[64], v[65], v[66:69], v[69:72], own_yaw_rad)
        watched.moved_s, watched.drift_m, watched.missed_m = v[64], v[73:76], v[76:79]
        if c.reserve_estimate is not None:
            c.reserve_estimate.memory.effort, c.reserve_estimate.memory.rise_m_s = v[117:119]
        if not isinstance(strategy, RobustFilter):
            return  # it remembers nothing of the rest
        motion.time_s, motion.position_enu_m, motion.velocity_enu_m_s = v[24], v[25:28], v[28:31]
        motion.acceleration_enu_m_s2 = v[31:34]
        motion.yaw_rad = None if math.isnan(v[34]) else v[34]
        motion.turn_rate_rad_s, motion.surprise = v[35], v[36]
        motion.covariance_xy, motion.covariance_z = v[37:43], v[43:49]
        tracking.slope_m_s2, tracking.setpoint_m_s, tracking.model_m_s = v[49:52], v[52:55], v[55:58]
        tracking.model_m_s2, tracking.disturbance_m_s = v[58:61], v[61:64]
        if strategy.own_estimator is not None:
            own_memory = strategy.own_estimator.memory
            own_memory.time_s, own_memory.x, own_memory.y = v[79], v[80:85], v[85:90]
            own_memory.z_m, own_memory.z_error_m_s = v[90:92]
            own_memory.x_now, own_memory.y_now, own_memory.sent_m_s = v[92:97], v[97:102], v[102:105]
            own_memory.pending = (v[105:108], v[108:111], v[111:114], v[114:117])
