"""What a tick decided, as the row that goes into the log; live flight and replay both make it here."""

from __future__ import annotations

import math

from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from flightstack.core.types import ZERO
from logs.schema.codec import ControllerStepRow


def step_row(tick: Tick, out: Outputs) -> ControllerStepRow:
    """Values that are not there are NaN; zero would be a claim."""
    own, target, barrier, seen = out.seen.inputs.own, out.seen.target, out.barrier, out.seen
    nan = math.nan
    none = (nan, nan, nan)
    return ControllerStepRow(
        stamp_ns=tick.unix_ns,
        tick=tick.number,
        phase=out.phase,
        request=out.request,
        filter_status=barrier.result.status if barrier is not None else 0,
        gate=out.gate,
        setpoint_sent=out.setpoint is not None,
        barrier_active=barrier.result.active if barrier is not None else False,
        own_valid=seen.own_ok,
        target_valid=seen.target_ok,
        own_age_s=tick.now_s - own.arrival_s if own is not None else nan,
        target_age_s=target.age_s if target is not None else nan,
        own_position_enu_m=own.position_enu_m if own is not None else none,
        own_velocity_enu_m_s=own.velocity_enu_m_s if own is not None else none,
        own_yaw_rad=own.yaw_rad if own is not None else nan,
        target_position_enu_m=target.position_enu_m if target is not None else none,
        target_velocity_enu_m_s=target.velocity_enu_m_s if target is not None else none,
        target_yaw_rad=target.yaw_rad if target is not None else nan,
        h_m=barrier.h_m if barrier is not None else nan,
        gradient=barrier.gradient if barrier is not None else none,
        dh_dt_m_s=barrier.dh_dt_m_s if barrier is not None else nan,
        nominal_enu_m_s=barrier.nominal if barrier is not None else none,
        filtered_enu_m_s=barrier.result.velocity_enu_m_s if barrier is not None else none,
        command_enu_m_s=out.setpoint.velocity_enu_m_s if out.setpoint is not None else ZERO,
        slack_m_s=barrier.result.slack_m_s if barrier is not None else nan,
        residual=barrier.result.residual_m_s if barrier is not None else nan,
        iterations=barrier.result.iterations if barrier is not None else 0,
        target_accepted=out.target_accepted,
        target_rejected=out.target_rejected,
        link_valid=seen.link_ok,
        finished=out.finished,
        wanted_enu_m_s=out.wanted if out.wanted is not None else none,
        command_yaw_rad=out.setpoint.yaw_rad if out.setpoint is not None else nan,
    )
