"""Replays the recorded MAVLink frames of a flight through the current bridge and compares the results.

The recorded MAVLink frames and target samples run through the flight code without a socket
(``flightstack.onboard.runner``, ``bridge.mavlink.client.link``). The results must equal the recorded inputs,
and the frames sent for the replayed decisions must equal the recorded frames, except for sequence numbers.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.link import COMPONENT_ID
from bridge.mavlink.codec.messages import MESSAGES, Message, decode, message_id
from bridge.mavlink.endpoint import Endpoint, Received
from bridge.mavlink.line_budget import plan
from bridge.mavlink.profiles import AUTO, PROFILES, PX4, profile
from bridge.mavlink.transport.address import Peer
from bridge.target.odometry import RawSample
from flightstack.core.controller import Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Inputs
from flightstack.onboard.runner import LinkedVehicle, Refusals, decoded, open_link
from logs.compare import Tally, values_of
from logs.reader.reader import ROSOUT
from logs.replay.read import FlightInputs, TickRecord
from logs.schema.controller_rows import TickInputs

_SAID_BY_THE_WIRE = ("target sample refused: ", "vehicle: ")  # prefixes of the events that are compared
_ID_AND_PAYLOAD = slice(7, -2)  # message id and payload of an unsigned MAVLink 2 frame


class RecordedEndpoint(Endpoint):
    """An endpoint without a socket: returns recorded frames and stores sent frames."""

    def __init__(self, system_id: int) -> None:
        self.tap = None
        self.counters = Counter()
        self.warnings = ()
        self.local_port, self.baud = 0, None
        self.incoming: deque[tuple[bytes, str]] = deque()  # recorded frames, each with the name of its peer
        self.sent: list[bytes] = []
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=COMPONENT_ID)

    def receive(self) -> list[Received]:
        # the log also has frames of unknown messages
        known = [each for each in self.incoming if message_id(each[0]) in MESSAGES]
        received = [Received(decode(frame), (peer, 0)) for frame, peer in known]
        self.incoming.clear()
        return received

    def send(self, messages: Sequence[Message], peer: Peer | None = None) -> None:
        del peer
        self.sent += [self.pack(message) for message in messages]

    def repeat(self, frame: bytes, peer: Peer | None = None) -> None:
        """Do nothing: a log contains no repeated frames."""

    def take_notices(self) -> list[str]:
        return []

    def close(self) -> None: ...


class WireReplay:
    """MAVLink link of one recorded flight; for each tick call ``take``, then ``answer``."""

    def __init__(self, flight: FlightInputs, config: FlightConfig, found: Tally) -> None:
        """Create the link as it was at tick 0; ``found`` receives the differences from the log."""
        self._flight, self._found, onboard = flight, found, flight.onboard
        autopilot, recognised = onboard.get("autopilot", PX4.name), flight.preflight.get("profile", AUTO)
        if autopilot == AUTO and recognised in PROFILES:
            autopilot = recognised
        lockstep, every = onboard["lockstep"] == "true", 1
        if "baud" in onboard:
            signed, age_max_s = onboard.get("signed") == "true", config.checks.own_age_max_s
            every = plan(int(onboard["baud"]), config.loop.rate_hz, age_max_s, signed=signed).every
        system_id = flight.names.system_id
        self._endpoint = RecordedEndpoint(system_id)
        self._heard, self._refusals = False, Refusals()
        piloted = profile(autopilot)
        self._link = open_link(config, self._endpoint, system_id, piloted, lockstep=lockstep, every=every)
        self._vehicle = LinkedVehicle(self._link, lockstep=lockstep)

    def take(self, record: TickRecord, given: TickInputs) -> None:
        tick, self._heard = given.tick, self._link.heard
        self._endpoint.sent.clear()
        self._endpoint.incoming += record.frames_in
        try:
            self._link.poll(given.now_s)
        except Exception as error:  # a frame that the current dialect cannot decode is a difference
            self._endpoint.incoming.clear()
            self._found.add(self._flight.source, tick, [("frame", "a decodable frame", repr(error))])
            return
        arrived = decoded([RawSample(payload) for payload in record.odometry], given.now_s)
        own, status, command_failed, power = self._vehicle.read()
        neighbours = given.inputs.neighbours  # the log does not contain the bytes of fleet messages
        inputs = Inputs(own, status, arrived.samples, given.inputs.operator, power, neighbours)
        self._found.add("wire, inputs", tick, values_of(given.inputs, inputs))
        failed = values_of(given.command_failed, command_failed, "command_failed")
        self._found.add("wire, inputs", tick, failed)
        said = self._refusals.told(arrived.problems)
        said += [f"vehicle: {text}" for _, text in self._link.take_texts()]
        recorded = [row.msg for row in record.said if row.msg.startswith(_SAID_BY_THE_WIRE)]
        self._found.add(ROSOUT, tick, values_of(recorded, said, "wire"))

    def answer(self, record: TickRecord, given: TickInputs, out: Outputs) -> None:
        self._vehicle.answer(out, given.now_s)
        if self._heard:  # before the vehicle's first message, heartbeats are sent by wall time
            recorded = [frame[_ID_AND_PAYLOAD].hex() for frame in record.frames_out]
            replayed = [frame[_ID_AND_PAYLOAD].hex() for frame in self._endpoint.sent]
            self._found.add(self._flight.sink, given.tick, values_of(recorded, replayed, "frames"))
