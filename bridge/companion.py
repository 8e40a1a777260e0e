"""What the companion says of itself."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message


def companion_heartbeat() -> Message:
    """Heartbeat of an onboard controller that is active."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )
