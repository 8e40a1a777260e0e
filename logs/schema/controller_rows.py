"""Converts inputs and decisions of a tick, and the messages of a fleet, into rows of the log and back.

Live flight and replay use the same functions. Every input number is stored and restored bit by bit, so that a
replay makes the decisions of the flight.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from flightstack.core.types import (
    ZERO,
    Inputs,
    Intent,
    Landed,
    MemberStatus,
    Mode,
    Operator,
    OwnState,
    Power,
    TargetSample,
    VehicleStatus,
)
from logs.schema.rows import (
    ControllerInputRow,
    ControllerNeighboursRow,
    ControllerPowerRow,
    ControllerStepRow,
    MemberStatusRow,
)
from logs.schema.schemas import TARGET_SAMPLE, fields_of

_SAMPLE_FIELDS = tuple(field.name for field in fields_of(TARGET_SAMPLE))
_sample_values = attrgetter(*_SAMPLE_FIELDS)
# fields of a step that are attributes or properties of ``Outputs``; such a field needs only its .msg line
_OF_OUTPUTS = tuple(name for name in ControllerStepRow._fields if hasattr(Outputs, name))
_NO_STATUS = (False, 0, 0, False, 0.0)
_NO_POWER = (0.0, 0.0, 0.0, 0.0)
_NO_OWN = (0.0, 0.0, ZERO, ZERO, 0.0)


class TickInputs(NamedTuple):
    """Inputs of one tick, as ``Controller.step`` receives them."""

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
    """Return the row with the battery and motor values used in a tick, and the estimated thrust reserve."""
    told = (
        (power.arrival_s, power.voltage_v, power.throttle, power.cos_tilt) if power is not None else _NO_POWER
    )
    return ControllerPowerRow(tick.unix_ns, tick.number, power is not None, *told, reserve)


def unpack_power(data: bytes) -> Power | None:
    """Return battery and motor values in a CDR payload of ``power_row``; None: not received."""
    row = ControllerPowerRow.unpack(data)
    return Power(row.arrival_s, row.voltage_v, row.throttle, row.cos_tilt) if row.told else None


def step_row(tick: Tick, out: Outputs) -> ControllerStepRow:
    """Return the row with the decisions of a tick; missing values are NaN, since zero is a valid value."""
    own, target, barrier, seen = out.snapshot.inputs.own, out.snapshot.target, out.barrier, out.snapshot
    nan = math.nan
    none = (nan, nan, nan)
    return ControllerStepRow(
        stamp_ns=tick.unix_ns,
        tick=tick.number,
        filter_status=barrier.result.status if barrier is not None else 0,
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
        link_valid=seen.link_ok,
        wanted_enu_m_s=out.wanted if out.wanted is not None else none,
        command_yaw_rad=out.setpoint.yaw_rad if out.setpoint is not None else nan,
        **{name: getattr(out, name) for name in _OF_OUTPUTS},
    )


def pack_neighbours(tick: Tick, neighbours: Sequence[MemberStatus]) -> bytes:
    """Return the neighbours' status messages that a tick used, as CDR of ``ControllerNeighbours``."""
    return ControllerNeighboursRow(tick.unix_ns, tick.number, tuple(map(_values, neighbours))).pack()


def unpack_neighbours(data: bytes) -> tuple[MemberStatus, ...]:
    """Return the status messages in a CDR payload of :func:`pack_neighbours`."""
    return tuple([_neighbour(values) for values in ControllerNeighboursRow.unpack(data).neighbours])


def _values(status: MemberStatus) -> tuple[Any, ...]:
    pad, speed = status.pad_position_enu_m, status.pad_velocity_enu_m_s
    return (
        *status[: MemberStatus._fields.index("pad_position_enu_m")],
        pad is not None,
        pad if pad is not None else ZERO,
        speed is not None,
        speed if speed is not None else ZERO,
        bytes(status.yields_to),
    )


def _neighbour(values: tuple[Any, ...]) -> MemberStatus:
    *told, pad_known, pad, speed_known, speed, yields_to = values
    pads = (pad if pad_known else None, speed if speed_known else None)
    status = MemberStatus._make((*told, *pads, tuple(yields_to)))
    return status._replace(intent=Intent(status.intent))


class Echo(NamedTuple):
    """Bound on another member's clock offset; the fields are those of ``FleetEcho.msg``."""

    id: int
    process: int
    arrival_ns: int


def status_row(
    status: MemberStatus, epoch_ns: int, process: int, echoes: Sequence[Echo] = ()
) -> MemberStatusRow:
    """Return a vehicle's status for its neighbours; ``epoch_ns``: Unix time of stack time 0."""
    pad, claims = status.pad_position_enu_m, not math.isnan(status.claim_s)
    return MemberStatusRow(
        epoch_ns + round(status.stamp_s * 1e9),
        status.id,
        process,
        status.position_enu_m,
        status.velocity_enu_m_s,
        status.wanted_enu_m_s,
        status.position_sigma_m,
        status.intent,
        claims,
        epoch_ns + round(status.claim_s * 1e9) if claims else 0,
        pad is not None,
        pad if pad is not None else ZERO,
        status.pad_velocity_enu_m_s or ZERO,
        bytes(status.yields_to),
        tuple(echoes),
    )


def received_status(
    row: MemberStatusRow, stamp_s: float, arrival_s: float, claim_s: float, clock_bound_s: float
) -> MemberStatus:
    """Return a neighbour's status with times on the local stack clock; ``claim_s`` is NaN without a claim."""
    return MemberStatus(
        row.id,
        stamp_s,
        arrival_s,
        row.position_enu_m,
        row.velocity_enu_m_s,
        row.wanted_enu_m_s,
        row.position_sigma_m,
        clock_bound_s,
        Intent(row.intent),
        claim_s,
        row.pad_position_enu_m if row.pad_known else None,
        row.pad_velocity_enu_m_s if row.pad_known else None,
        tuple(row.yields_to),
    )
