"""Constants of a batch of ticks, besides the controller's state, as a record for compiled code."""

from __future__ import annotations

from flightstack.compiled.records import Record, Vector
from sim.autopilot.watches import WatchRecord


class RulesRecord(Record):
    """Constants of a batch of ticks; times are on the controller's clock."""

    flies: bool  # set-points are sent
    lasting: int  # flags of the mission
    status_s: float  # arrival of the newest heartbeat
    status_age_max_s: float
    ends_s: float  # time limit of the flight
    # inputs of the vehicle's autopilot
    yaw_told_rad: float  # commanded heading as received
    cos_yaw: float
    sin_yaw: float
    speeds: Vector  # speed limits, m/s: horizontal, up, down
    delay_ms: int  # delay of the radio
    armed: bool
    standing: bool
    supervisor: int  # state of the firmware's supervisor
    stream_until_s: float  # end of the autopilot's wait for set-points; used while none are sent
    watch: WatchRecord
