"""Chooses message rates for which a serial line is fast enough; no I/O."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import MESSAGES

_BITS_PER_BYTE = 10  # bits per byte on a serial line, 8N1
_USABLE = 0.9  # fraction of the line for planned messages; the rest is for replies, texts and other messages
_FRAME = 12  # length of a MAVLink 2 header and checksum, bytes
_SIGNATURE = 13  # length of a signature, bytes
_IN_A_ROW = 3  # minimum number of message periods in the state's maximum age; two messages may be lost
_BAUDS = (9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600, 1_500_000, 3_000_000)
# rates of the messages other than state and set-points, Hz, as in PX4 v1.16
_OUT_HZ = {dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0, dialect.MAVLINK_MSG_ID_TIMESYNC: 10.0}
_IN_HZ = {
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0, dialect.MAVLINK_MSG_ID_SYS_STATUS: 2.0, **_OUT_HZ,
}  # fmt: skip
_STATE = (dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE)
_SETPOINT: int = dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


class LineTooSlowError(ValueError):
    """The line is too slow for the flight; the text contains the rates."""


class LinePlan(NamedTuple):
    every: int  # ticks between two set-points, and between two position and attitude messages
    hz: float  # rate of these messages, Hz
    in_bytes_s: float  # data rate of telemetry from the vehicle to the companion, bytes/s
    out_bytes_s: float  # data rate of set-points, heartbeats and replies from the companion, bytes/s

    @property
    def text(self) -> str:
        return (
            f"position and attitude at {self.hz:.3g} Hz need {self.in_bytes_s:.0f} B/s in, set-points "
            f"{self.out_bytes_s:.0f} B/s out"
        )


def plan(baud: int | None, rate_hz: float, own_age_max_s: float, *, signed: bool = False) -> LinePlan:
    """Choose the highest message rate that fits the line: the loop rate divided by an integer.

    ``baud``: speed of the serial line, bit/s, None: no limit; ``rate_hz``: loop rate; ``own_age_max_s``:
    maximum age of the vehicle state, s. The lowest allowed rate is 3 / ``own_age_max_s``.
    Raises LineTooSlowError: even the lowest rate does not fit.
    """
    frame = _FRAME + (_SIGNATURE if signed else 0)

    def bytes_s(rates_hz: Mapping[int, float]) -> float:
        return sum(hz * float(MESSAGES[id_].unpacker.size + frame) for id_, hz in rates_hz.items())

    for every in range(1, max(1, int(rate_hz / min(rate_hz, _IN_A_ROW / own_age_max_s) + 1e-9)) + 1):
        hz = rate_hz / every
        need_in = bytes_s({**_IN_HZ, **dict.fromkeys(_STATE, hz)})
        found = LinePlan(every, hz, need_in, bytes_s({**_OUT_HZ, _SETPOINT: hz}))
        need = max(found.in_bytes_s, found.out_bytes_s)
        if baud is None or need <= baud / _BITS_PER_BYTE * _USABLE:
            return found
    enough = next((b for b in _BAUDS if b / _BITS_PER_BYTE * _USABLE >= need), None)
    use = f"set the line to {enough} baud or more" if enough else "use another link"
    raise LineTooSlowError(
        f"the serial line of {baud} baud is too slow: {found.text}; this is the lowest rate that keeps the "
        f"vehicle state younger than checks.own_age_max_s = {own_age_max_s:g} s, and the line "
        f"carries {(baud or 0) / _BITS_PER_BYTE:.0f} B/s each way, of which {_USABLE:.0%} may be used; {use}"
    )
