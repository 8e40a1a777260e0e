"""The simulated vehicle with its autopilot, MAVLink endpoint, link faults and log, for any clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Generic, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.endpoint import Endpoint, Received
from bridge.mavlink.server.profile import FlightMode
from bridge.mavlink.transport.address import Peer
from logs.schema.events import Severity
from sim.autopilot.autopilot import Autopilot
from sim.faults.link import Fate, LinkFaults, Way
from sim.faults.schedule import Running
from sim.runners.log import VehicleLog
from sim.runners.robot import Robot
from sim.vehicle.vehicle import VehicleSim

T = TypeVar("T")

HELD_MAX = 4096  # maximum number of delayed messages in each direction; more messages are lost
_HEADER_BYTES = 10  # length of a MAVLink 2 header


class Held(Generic[T]):
    """Queue of items that wait for a time or for the end of a stalled link."""

    def __init__(self) -> None:
        self._items: list[tuple[int, Running | None, T]] = []  # time, ns; stalled link or None; item

    @property
    def size(self) -> int:
        """Number of waiting items."""
        return len(self._items)

    def passed(self, item: T, fate: Fate, now_ns: int) -> list[T]:
        """Return the copies of an item that pass now; hold the delayed copies, up to ``HELD_MAX``."""
        out = []
        for due_ns in fate.due_ns:
            if fate.stall is None and due_ns <= now_ns:
                out.append(item)
            elif self.size < HELD_MAX:
                self._items.append((due_ns, fate.stall, item))
        return out

    def due(self, now_ns: int) -> list[T]:
        """Remove and return the items whose wait is over: items of a stall in order, then others by time."""
        items, self._items = self._items, []
        out = list[tuple[int, T]]()
        for each in items:
            due_ns, stall, item = each
            if due_ns <= now_ns if stall is None else stall.over:
                out.append((due_ns if stall is None else -1, item))
            else:
                self._items.append(each)
        return [item for _, item in sorted(out, key=itemgetter(0))]


_Frame = tuple[bytes, tuple[Peer, ...]]  # a packed message, and its receivers


class Wire:
    """Sends and receives messages through the active link faults."""

    def __init__(self, endpoint: Endpoint, faults: LinkFaults) -> None:
        self._endpoint, self._faults = endpoint, faults
        self._leaving: Held[_Frame] = Held()
        self._coming: Held[Received] = Held()

    @property
    def sound(self) -> bool:
        """Whether no fault acts on sent messages, and no message waits to be sent."""
        return not self._leaving.size and not self._faults.active(Way.OUT)

    def send(
        self, messages: Sequence[Message], now_ns: int, peer: Peer | None = None, last: Sequence[Message] = ()
    ) -> None:
        """Send all due messages, new and delayed; during a fault each message has its own datagram.

        ``messages`` may be changed; ``peer``: receiver, None: all peers; ``last``: sent last, without faults.
        """
        if self.sound:
            self._endpoint.send([*messages, *last], peer)
            return
        peers = self._endpoint.peers if peer is None else (peer,)
        frames = self._leaving.due(now_ns)
        for message in messages:
            fate = self._faults.fate(Way.OUT, message, now_ns)
            raw = self._endpoint.pack(message)  # a lost frame also uses a sequence number, as on a real link
            frames += self._leaving.passed((_damaged(raw) if fate.damaged else raw, peers), fate, now_ns)
        for frame, receivers in frames:
            for each in receivers:
                self._endpoint.repeat(frame, each)
        self._endpoint.send(last, peer)

    def receive(self, received: Received, now_ns: int) -> list[Received]:
        """Return the copies of an arrived message (none, one or two) that the autopilot receives now."""
        if not self._faults.active(Way.IN):
            return [received]
        fate = self._faults.fate(Way.IN, received.message, now_ns)
        return [] if fate.damaged else self._coming.passed(received, fate, now_ns)

    def late(self, now_ns: int) -> list[Received]:
        """Return the delayed messages that the autopilot receives now."""
        return self._coming.due(now_ns) if self._coming.size else []


def _damaged(raw: bytes) -> bytes:
    """Change a byte of the payload, so that the checksum is wrong."""
    at = _HEADER_BYTES + (len(raw) - _HEADER_BYTES) // 2
    return raw[:at] + bytes((raw[at] ^ 0xFF,)) + raw[at + 1 :]


@dataclass(slots=True)
class VehicleNode:
    """One simulated vehicle on MAVLink. ``number``: its number in the team; ``name``: its namespace."""

    number: int
    name: str
    vehicle: VehicleSim
    autopilot: Autopilot
    endpoint: Endpoint
    log: VehicleLog
    tell: Callable[[bool], None] | None = None  # called when the vehicle is armed or disarmed
    over: bool = False  # whether the flight is over; nothing is logged afterwards
    wire: Wire = field(init=False)
    _armed: bool = field(default=False, init=False)
    _judged: bool = field(default=False, init=False)
    _state_text: str = field(default="", init=False)

    def __post_init__(self) -> None:
        self.wire = Wire(self.endpoint, self.vehicle.faults.link)

    def answer(self, received: Received, now_s: float) -> list[Message]:
        """Pass a message to the autopilot; return the replies to its sender."""
        return self.autopilot.handle(received.message, (*received.sender, received.peer), now_s)

    def carry(self, robot: Robot, tick: int, now_ns: int) -> None:
        """Move the deck with its robot, and log the true pose."""
        self.vehicle.set_deck(*robot.take(tick))
        self.log.target(now_ns, robot.payload)

    def control(self, now_s: float) -> None:
        """Run the autopilot; judging starts when the vehicle first flies set-points."""
        vehicle = self.vehicle
        self.autopilot.control(now_s)
        if self.over:
            self._tell_change()
        for fault in vehicle.faults.take_texts():
            severity = dialect.MAV_SEVERITY_WARNING if fault.begins else dialect.MAV_SEVERITY_NOTICE
            self.report(severity, str(fault))
        if not self._judged:
            flight = self.autopilot.flight
            if flight.mode is FlightMode.OFFBOARD and flight.airborne:
                self._judged = True
                vehicle.begin_judging()

    @property
    def watches_nothing(self) -> bool:
        """Whether judging has started, and all changes of arming and firmware state are reported."""
        vehicle = self.vehicle
        return self._judged and vehicle.armed is self._armed and vehicle.state_text == self._state_text

    def say(self, now_ns: int, level: int, text: str) -> None:
        """Log an event, unless the flight is over."""
        if not self.over:
            self.log.event(now_ns, level, text)

    def write_log(self, tick: int, now_ns: int) -> None:
        """Log the true state, the autopilot's status texts and the state of the firmware's supervisor."""
        self.log.truth(tick, now_ns, self.vehicle.truth_values())
        for text in self.autopilot.take_texts():
            self.log.statustext(now_ns, text.severity, text.text)
        state_text = self.vehicle.state_text
        if state_text != self._state_text:
            self._state_text = state_text
            self.log.event(now_ns, Severity.INFO, f"firmware: {state_text}")
        self._tell_change()

    def report(self, severity: int, text: str) -> None:
        """Send a status text of the autopilot to the clients."""
        self.autopilot.flight.texts.say(severity, text)

    def _tell_change(self) -> None:
        """Report a change of arming; first it is logged, because the receiver may end this process."""
        armed = self.vehicle.armed
        if armed is not self._armed:
            self._armed = armed
            if self.tell is not None:
                self.tell(armed)
