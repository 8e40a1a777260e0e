"""Inputs and decisions of a tick as rows of the log; live flight and replay both fill them here.

Every number of the inputs goes in and comes out bit by bit, so that a replay decides what the flight decided.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from operator import attrgetter
from typing import Any, NamedTuple

from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from flightstack.core.types import (
    ZERO,
    Inputs,
    Landed,
    Mode,
    Operator,
    OwnState,
    Power,
    TargetSample,
    VehicleStatus,
)
from logs.schema.rows import ControllerInputRow, ControllerPowerRow, ControllerStepRow
from logs.schema.schemas import TARGET_SAMPLE, fields_of

_SAMPLE_FIELDS = tuple(field.name for field in fields_of(TARGET_SAMPLE))
_sample_values = attrgetter(*_SAMPLE_FIELDS)
_NO_STATUS = (False, 0, 0, False, 0.0)
_NO_POWER = (0.0, 0.0, 0.0, 0.0)
_NO_OWN = (0.0, 0.0, ZERO, ZERO, 0.0)


class TickInputs(NamedTuple):
    """One tick's inputs as ``Controller.step`` takes them."""

    stamp_ns: int
    tick: int
    now_s: float
    inputs: Inputs
    command_failed: bool


def pack_controller_input(given: TickInputs) -> bytes:
    """Return the inputs of a tick as CDR of ``ControllerInput``."""
    stamp_ns, tick, now_s, inputs, command_failed = given
    own, status = inputs.own, inputs.status
    return ControllerInputRow(
        stamp_ns, tick, now_s, inputs.operator, command_failed, own is not None, status is not None,
        *((status.armed, status.mode, status.landed, status.ready_to_arm, status.arrival_s)
          if status is not None else _NO_STATUS),
        *((own.arrival_s, own.source_time_s, own.position_enu_m, own.velocity_enu_m_s, own.yaw_rad)
          if own is not None else _NO_OWN),
        tuple([_sample_values(sample) for sample in inputs.target_samples]),
    ).pack()  # fmt: skip


def unpack_controller_input(data: bytes) -> TickInputs:
    """Return the inputs in a CDR payload of :func:`pack_controller_input`."""
    row = ControllerInputRow.unpack(data)
    own = status = None
    if row.own_present:
        own = OwnState(
            row.own_arrival_s, row.own_source_time_s, row.own_position_enu_m, row.own_velocity_enu_m_s,
            row.own_yaw_rad,
        )  # fmt: skip
    if row.status_present:
        status = VehicleStatus(
            row.status_arrival_s, row.armed, Mode(row.mode), Landed(row.landed), row.ready_to_arm
        )
    samples = tuple([_sample(values) for values in row.target_samples])
    inputs = Inputs(own, status, samples, Operator(row.operator))
    return TickInputs(row.stamp_ns, row.tick, row.now_s, inputs, row.command_failed)


def _sample(values: Iterable[Any]) -> TargetSample:
    return TargetSample(**dict(zip(_SAMPLE_FIELDS, values, strict=True)))


def power_row(tick: Tick, power: Power | None, reserve: float) -> ControllerPowerRow:
    """Return battery and motors as a tick received them, and its estimate of the thrust reserve."""
    told = (
        (power.arrival_s, power.voltage_v, power.throttle, power.cos_tilt) if power is not None else _NO_POWER
    )
    return ControllerPowerRow(tick.unix_ns, tick.number, power is not None, *told, reserve)


def unpack_power(data: bytes) -> Power | None:
    """Return battery and motors in a CDR payload of ``power_row``; None: not received."""
    row = ControllerPowerRow.unpack(data)
    return Power(row.arrival_s, row.voltage_v, row.throttle, row.cos_tilt) if row.told else None


def step_row(tick: Tick, out: Outputs) -> ControllerStepRow:
    """Values that are not there are NaN; zero would be a claim."""
    own, target, barrier, seen = out.snapshot.inputs.own, out.snapshot.target, out.barrier, out.snapshot
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
