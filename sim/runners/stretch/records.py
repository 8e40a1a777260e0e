"""What does not change in a stretch besides the controller's state, as a record for compiled code."""

from __future__ import annotations

from flightstack.compiled.records import Record, Vector
from sim.autopilot.watches import WatchRecord


class RulesRecord(Record):
    """Times are on the controller's clock."""

    flies: bool  # set-points go out
    lasting: int  # flags of the mission
    status_s: float  # arrival of the heartbeat
    status_age_max_s: float
    ends_s: float  # when the flight is too long
    # the vehicle's autopilot
    yaw_told_rad: float  # heading as it arrives there
    cos_yaw: float
    sin_yaw: float
    speeds: Vector  # m/s, over ground, up, down
    delay_ms: int  # of the radio
    armed: bool
    standing: bool
    supervisor: int  # state of the firmware's supervisor
    stream_until_s: float  # the autopilot waits for set-points until then; without them
    watch: WatchRecord
