"""The MAVLink autopilot that other programs see: PX4, played by the simulated vehicle.

Pure: messages and times in, messages out. No socket, no clock, no randomness.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.server.commands import Entry
from bridge.mavlink.server.owner import Sender
from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.server import COMPONENT_ID, SYSTEM_ID, Server
from bridge.mavlink.server.services import Handler
from bridge.mavlink.server.telemetry import Snapshot
from flightstack.core.types import ZERO, Vec3
from sim.autopilot.commands import SimCommands
from sim.autopilot.flight import Flight
from sim.autopilot.ground import degrees_e7
from sim.autopilot.profiles import PX4, px4_parameters
from sim.autopilot.telemetry import BUILDERS
from sim.autopilot.vehicle_like import VehicleLike

__all__ = ["COMPONENT_ID", "SYSTEM_ID", "Autopilot"]


class Autopilot(Server[Flight]):
    """One autopilot. At each tick: ``telemetry``, ``handle`` each message, ``control``, physics."""

    def __init__(
        self,
        vehicle: VehicleLike,
        rate_hz: float,
        *,
        system_id: int = SYSTEM_ID,
        epoch_ns: int = 0,
        trim_enu_m_s: Vec3 = ZERO,
    ) -> None:
        """Set up; a vehicle that is flying already is held at its place.

        ``rate_hz`` is that of the loop, and of position and attitude on the wire. ``epoch_ns`` is the Unix
        time of time zero. ``trim_enu_m_s`` keeps a vehicle in place that starts in the air.
        """
        parameters = Parameters(px4_parameters(system_id))
        self.flight = Flight(vehicle, parameters, 1.0 / rate_hz, trim_enu_m_s)
        self._epoch_ns = epoch_ns
        super().__init__(self.flight, PX4, parameters, rate_hz, BUILDERS, system_id=system_id)

    def control(self, now_s: float) -> None:
        """Fly; call it after ``handle`` and before the physics."""
        self.flight.control(now_s)

    def snapshot(self, now_s: float) -> Snapshot[Flight]:
        """State of the vehicle; its boot clock is the simulated time."""
        estimate = self.flight.vehicle.estimate()
        return Snapshot(self.flight, self.profile, estimate, estimate.valid, now_s, now_s, self._epoch_ns)

    def on_heartbeat(self, message: Any, _sender: Sender, now_s: float) -> list[Message]:
        if self.flight.watches.heartbeat(message.type, now_s):
            self.flight.say(dialect.MAV_SEVERITY_INFO, "Ground station is back")
        return []

    def own_commands(self) -> dict[int, Entry]:
        return SimCommands(self.flight, self.parameters, self.streams).table

    def own_handlers(self) -> dict[int, Handler]:
        return {dialect.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: self._set_origin}

    def condition(self, snapshot: Snapshot[Flight]) -> object:
        return super().condition(snapshot), self.flight.vehicle.locked

    def _set_origin(self, _message: Any, _sender: Sender, now_s: float) -> list[Message]:
        self.flight.texts.refuse("Origin refused: the simulated room does not move", now_s)
        return [dialect.MAVLink_gps_global_origin_message(*degrees_e7(0.0, 0.0), 0, round(now_s * 1e6))]
