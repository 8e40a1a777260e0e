"""What the vehicle process is made of, whatever its clock: vehicle, autopilot, endpoint, log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.endpoint import Endpoint, Received
from bridge.mavlink.server.profile import FlightMode
from logs.schema.events import Severity
from sim.autopilot.autopilot import Autopilot
from sim.plant.vehicle_types import Truth
from sim.runners.deck import DeckState
from sim.runners.vehicle_log import VehicleLog
from sim.runners.wire import Wire
from sim.vehicle.vehicle import VehicleSim


def _untold(armed: bool) -> None:
    del armed


@dataclass(slots=True)
class VehicleNode:
    """One simulated vehicle on the wire.

    Attributes:
        tell: called when the vehicle has been armed or disarmed.
    """

    vehicle: VehicleSim
    autopilot: Autopilot
    endpoint: Endpoint
    log: VehicleLog
    tell: Callable[[bool], None] = _untold
    wire: Wire = field(init=False)
    _armed: bool = field(default=False, init=False)
    _judged: bool = field(default=False, init=False)
    _state_text: str = field(default="", init=False)

    def __post_init__(self) -> None:
        self.wire = Wire(self.endpoint, self.vehicle.faults.link)

    def answer(self, received: Received, now_s: float) -> list[Message]:
        """Let the autopilot act on a frame; returns what to answer its sender."""
        header = received.message.get_header()
        return self.autopilot.handle(received.message, (header.srcSystem, header.srcComponent), now_s)

    def control(self, now_s: float) -> None:
        """Let the autopilot fly; its first flight by the companion's set-points begins the judging."""
        self.autopilot.control(now_s)
        if self.vehicle.armed is not self._armed:
            self._armed = self.vehicle.armed
            self.tell(self._armed)
        for fault in self.vehicle.faults.take_texts():
            severity = dialect.MAV_SEVERITY_WARNING if fault.begins else dialect.MAV_SEVERITY_NOTICE
            self.autopilot.flight.say(severity, str(fault))
        if not self._judged:
            flight = self.autopilot.flight
            if flight.mode is FlightMode.OFFBOARD and flight.airborne:
                self._judged = True
                self.vehicle.begin_judging()

    def move_deck(self, deck: DeckState) -> None:
        """Give the deck a pose and a twist."""
        self.vehicle.set_deck(deck.position_enu_m, deck.yaw_rad, deck.velocity_enu_m_s, deck.yaw_rate_rad_s)

    def write_log(self, tick: int, now_ns: int) -> Truth:
        """Log the true state, what the autopilot said and what the firmware's supervisor did."""
        truth = self.vehicle.truth()
        self.log.truth(tick, now_ns, truth)
        for text in self.autopilot.take_texts():
            self.log.statustext(now_ns, text.severity, text.text)
        state_text = self.vehicle.state_text
        if state_text != self._state_text:
            self._state_text = state_text
            self.log.event(now_ns, Severity.INFO, f"firmware: {state_text}")
        return truth
