"""Chooses message rates for which a serial line is fast enough; no I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import MESSAGES

_BITS_PER_BYTE = 10  # bits per byte on a serial line, 8N1
_USABLE = 0.9  # fraction of the line for planned messages; replies, texts and others use the remainder
_FRAME = 12  # length of a MAVLink 2 header and checksum, bytes
_SIGNATURE = 13  # length of a signature, bytes
_IN_A_ROW = 3  # minimum number of message periods in the state's maximum age; two messages may be lost
_BAUDS = (9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600, 1_500_000, 3_000_000)
# rates requested in addition to position and attitude, Hz; then rates that are sent without a request, Hz
_ASKED_HZ = {dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0, dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0}
_UNASKED_HZ = {dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0, dialect.MAVLINK_MSG_ID_TIMESYNC: 10.0}  # PX4 v1.16
_OUT_HZ = {dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0, dialect.MAVLINK_MSG_ID_TIMESYNC: 10.0}
_STATE = (dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE)
_SETPOINT: int = dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


class LineTooSlowError(ValueError):
    """The line is too slow for the flight; the text contains the rates."""


@dataclass(frozen=True, slots=True)
class LinePlan:
    state_hz: float  # rate of the position messages, and of the attitude messages, Hz
    setpoint_every: int  # ticks between two set-points
    setpoint_hz: float  # rate of set-points, Hz
    in_bytes_s: float  # data rate of telemetry from the vehicle to the companion
    out_bytes_s: float  # data rate of set-points, heartbeats and replies from the companion
    capacity_bytes_s: float | None  # capacity of the line in each direction; None: no limit

    @property
    def text(self) -> str:
        carries = "no limit known"
        if self.capacity_bytes_s is not None:
            carries = f"the line carries {self.capacity_bytes_s:.0f} B/s each way"
        return (
            f"position and attitude at {self.state_hz:.3g} Hz need {self.in_bytes_s:.0f} B/s in, set-points "
            f"at {self.setpoint_hz:.3g} Hz {self.out_bytes_s:.0f} B/s out; {carries}"
        )


def bytes_per_s(rates_hz: Mapping[int, float], *, signed: bool = False) -> float:
    """Return the bytes per second of framed messages; ``rates_hz`` has message ids as keys."""
    around = _FRAME + (_SIGNATURE if signed else 0)
    return sum(rate_hz * float(MESSAGES[id_].unpacker.size + around) for id_, rate_hz in rates_hz.items())


def plan(baud: int | None, rate_hz: float, own_age_max_s: float, *, signed: bool = False) -> LinePlan:
    """Choose the highest rates that fit; they are integer fractions of the loop rate.

    ``baud``: speed of the serial line, bit/s, None: no limit; ``rate_hz``: loop rate; ``own_age_max_s``:
    maximum age of the vehicle state. Lowest rate of states and set-points: 3 / ``own_age_max_s``.
    Raises LineTooSlowError: even the lowest rates do not fit.
    """
    capacity = None if baud is None else baud / _BITS_PER_BYTE
    usable = math.inf if capacity is None else capacity * _USABLE
    lowest_hz = min(rate_hz, _IN_A_ROW / own_age_max_s)

    def needs_in(hz: float) -> float:
        return bytes_per_s({**_ASKED_HZ, **_UNASKED_HZ, **dict.fromkeys(_STATE, hz)}, signed=signed)

    def needs_out(hz: float) -> float:
        return bytes_per_s({**_OUT_HZ, _SETPOINT: hz}, signed=signed)

    every_max = max(1, int(rate_hz / lowest_hz + 1e-9))
    rates = [(every, rate_hz / every) for every in range(1, every_max + 1)]
    state = next((hz for _, hz in rates if needs_in(hz) <= usable), None)
    setpoint = next(((every, hz) for every, hz in rates if needs_out(hz) <= usable), None)
    if state is None or setpoint is None:
        slowest_hz = rates[-1][1]
        need = max(needs_in(slowest_hz), needs_out(slowest_hz))
        enough = next((b for b in _BAUDS if b / _BITS_PER_BYTE * _USABLE >= need), None)
        use = f"set the line to {enough} baud or more" if enough else "use another link"
        raise LineTooSlowError(
            f"the serial line of {baud} baud is too slow: at {slowest_hz:.3g} Hz, the lowest rate that keeps "
            f"the vehicle state younger than checks.own_age_max_s = {own_age_max_s:g} s, the flight needs "
            f"{needs_in(slowest_hz):.0f} B/s in and {needs_out(slowest_hz):.0f} B/s out, and the line "
            f"carries {capacity:.0f} B/s each way, of which {_USABLE:.0%} may be used; {use}"
        )
    return LinePlan(state, *setpoint, needs_in(state), needs_out(setpoint[1]), capacity)
