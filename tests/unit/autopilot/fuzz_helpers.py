"""Hostile datagrams for a vehicle in flight, over a real socket, beside an owner who flies it."""

from __future__ import annotations

import itertools
import math
import random
import socket
from collections import Counter

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.codec.packing import pack
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.server.profile import PX4_CODES, FlightMode
from bridge.mavlink.signing.key import SigningKey
from bridge.mavlink.signing.signing import Signer
from tests.unit.autopilot.autopilot_fakes import COMPANION, NAN, Rig, setpoint
from tests.unit.mavlink.server.hostile import hostile

GROUND_STATIONS = (245, 255)
_STREAMS = (
    mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mav.MAVLINK_MSG_ID_SYS_STATUS,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mav.MAVLINK_MSG_ID_BATTERY_STATUS,
)  # fmt: skip
PER_TICK = 20  # datagrams
HEIGHT_M = 0.5
PATIENCE_S = 10.0
LAND = PX4_CODES[FlightMode.LAND]
_FOCUS = (
    mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT, mav.MAVLINK_MSG_ID_SET_MODE,
    mav.MAVLINK_MSG_ID_PARAM_SET, mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mav.MAVLINK_MSG_ID_MANUAL_CONTROL, mav.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE,
    mav.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL,
    mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST, mav.MAVLINK_MSG_ID_TIMESYNC, mav.MAVLINK_MSG_ID_SETUP_SIGNING,
    mav.MAVLINK_MSG_ID_SET_HOME_POSITION, mav.MAVLINK_MSG_ID_HEARTBEAT,
)  # fmt: skip


def asks_to_land(message) -> bool:
    """Whether a message asks for what anybody may ask for: to land."""
    kind = message.get_type()
    if kind in ("COMMAND_LONG", "COMMAND_INT"):
        codes = (message.param2, message.param3)
        is_land = all(map(math.isfinite, codes)) and tuple(map(round, codes)) == (LAND.main, LAND.sub)
        return message.command == 21 or (message.command == 176 and is_land)
    return kind == "SET_MODE" and message.custom_mode >> 16 & 0xFFFF == LAND.main | LAND.sub << 8


def _ask(rig: Rig, number: int, *params: float) -> list:
    """Messages that a command of the owner brings."""
    command = mav.MAVLink_command_long_message(1, 1, number, 0, *params, *[NAN] * (7 - len(params)))
    return rig.autopilot.handle(command, COMPANION, rig.now_s)


def state(rig: Rig) -> tuple:
    """All that only the owner may change, as the owner sees it."""
    flight, count = rig.autopilot.flight, len(rig.autopilot.parameters)
    ack, home = _ask(rig, mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_HOME_POSITION)
    assert ack.result == mav.MAV_RESULT_ACCEPTED
    reads = [mav.MAVLink_param_request_read_message(1, 1, b"", i) for i in range(count)]
    values = [p for read in reads for p in rig.autopilot.handle(read, COMPANION, rig.now_s)]
    parameters = [(p.param_id, p.param_type, repr(p.param_value)) for p in values]
    assert len(parameters) == count > 20
    place = (home.latitude, home.longitude, home.altitude, home.x, home.y, home.z)
    return flight.mode, flight.failsafe, flight.landed_state, rig.vehicle.armed, place, parameters


def intervals_us(rig: Rig) -> list[int]:
    """Intervals of streams that clients fly by."""
    answers = [_ask(rig, mav.MAV_CMD_GET_MESSAGE_INTERVAL, id_) for id_ in _STREAMS]
    found = [messages[1].interval_us for messages in answers]
    return [us if us >= 0 else 2**31 for us in found]


class Speaker:
    """A socket that sends to the vehicle."""

    def __init__(self, port: int) -> None:
        self._to = ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))

    def send(self, datagram: bytes) -> None:
        self.socket.sendto(datagram, self._to)


class Fuzz:
    """A vehicle that its owner flies by set-points, while strangers send what they can think of.

    Attributes:
        rig: the flying vehicle.
        lost: good frames of the owner that did not get through.
        accidents: garbage whose 16-bit checksum was right by chance; it may have covered a good frame.
        acts: valid frames of strangers, by message name.
    """

    def __init__(self, seed: int, key: SigningKey | None = None, rig: Rig | None = None) -> None:
        self.rng = random.Random(seed)
        self.rig = rig if rig is not None else Rig().offboard()
        self.endpoint = Endpoint("udpin:127.0.0.1:0", 1, 1, signing_key=key)
        self.owner = Speaker(self.endpoint.local_port)
        self.strangers = [Speaker(self.endpoint.local_port) for _ in range(12)]
        self.signer = Signer(key, *COMPANION) if key is not None else None
        self._forger = Signer(SigningKey(bytes(range(1, 33))), *COMPANION) if key is not None else None
        self._mav = mav.MAVLink(None, *COMPANION)
        self._turns = itertools.cycle(mav.mavlink_map)
        self._commands = [*self.rig.autopilot.commands.table, 178, 252, 300, 43000]
        self._overheard: list[bytes] = []
        self._datagram, self._wire = b"", list[bytes]()  # of the owner, last
        self._count = 0
        self.lost = self.accidents = self.good = self.datagrams = self.texts_max = 0
        self.acts: Counter[str] = Counter()
        self.wanted: tuple[float, float, float] | None = None

    def close(self) -> None:
        self.endpoint.close()
        for speaker in (self.owner, *self.strangers):
            speaker.socket.close()

    def run(self, datagrams: int) -> None:
        """So many datagrams, with a tick of the autopilot after every twenty."""
        for _ in range(datagrams // PER_TICK):
            for _ in range(PER_TICK):
                good = self._say()
                self.datagrams += 1
                self._hear(good)
            self.tick()

    def tick(self) -> None:
        rig = self.rig
        self.endpoint.send(rig.autopilot.telemetry(rig.now_s))
        rig.autopilot.control(rig.now_s)
        rig.vehicle.advance(0.01)
        rig.tick += 1
        self.texts_max = max(self.texts_max, len(rig.autopilot.take_texts()))
        for speaker in (self.owner, *self.strangers):
            _drain(speaker.socket)

    def _say(self) -> list[bytes]:
        """One datagram of somebody; returns the good frames in it."""
        rng = self.rng
        if rng.random() < 0.4:
            good = [self._setpoint() for _ in range(rng.randrange(1, 4))]
            wire = [self.signer.sign(frame) for frame in good] if self.signer else list(good)
            self._overheard = [*self._overheard, *wire][-50:]
            pieces: list[bytes] = []
            for frame in wire:
                pieces += [self._garbage() for _ in range(rng.randrange(3))]
                pieces.append(frame)
            pieces += [self._garbage() for _ in range(rng.randrange(2))]
            datagram = b"".join(pieces)
            self.owner.send(datagram)
            self._datagram, self._wire = datagram, wire
            return good
        if rng.random() < 0.02:
            datagram = rng.randbytes(rng.choice((0, 1, 1400, 4096, 4097, 20000)))
        else:
            datagram = b"".join(self._attack() for _ in range(rng.randrange(1, 5)))
        rng.choice(self.strangers).send(datagram)
        return []

    def _setpoint(self) -> bytes:
        """The owner keeps the vehicle where it is, each time with another velocity."""
        x, y, z = self.rig.vehicle.state.position_enu_m
        jitter = self.rng.uniform(-0.01, 0.01)
        message = setpoint(-0.5 * y + jitter, -0.5 * x, 0.5 * (z - HEIGHT_M))
        self._count += 1
        message.time_boot_ms = self._count
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return bytes(frame)

    def _stranger_ids(self) -> tuple[int, int]:
        """Anybody's ids where signatures count; else not those of the owner and of the ground stations."""
        rng = self.rng
        if self.signer is not None and rng.random() < 0.5:
            return rng.choice((COMPANION, (255, 190), (245, 190), (1, 1)))
        while True:
            ids = (
                rng.choice((1, 1, 2, 0, 254, rng.randrange(256))),
                rng.choice((1, 191, 190, rng.randrange(256))),
            )
            if ids != COMPANION and ids[0] not in GROUND_STATIONS:
                return ids

    def _frame(self) -> bytes:
        rng = self.rng
        while True:
            # every message in turn, the dangerous ones more often
            message_id = rng.choice(_FOCUS) if rng.random() < 0.5 else next(self._turns)
            message = hostile(rng, message_id, self._commands)
            if self.signer is not None or not asks_to_land(message):
                return pack(message, rng.randrange(256), *self._stranger_ids())

    def _garbage(self) -> bytes:
        rng = self.rng
        kind = rng.randrange(5)
        if kind == 0:
            return rng.randbytes(rng.randrange(40))
        if kind == 1:
            return bytes([0xFD, rng.randrange(256), rng.randrange(2)])
        frame = bytearray(self._frame())
        if kind == 2:
            return bytes(frame[: rng.randrange(len(frame))])
        if kind == 3:
            frame[2] |= rng.choice((2, 4, 128))
            return bytes(frame)
        bit = rng.randrange(8 * (len(frame) - 2))
        frame[bit // 8] ^= 1 << bit % 8
        frame[rng.randrange(len(frame))] ^= rng.randrange(256)
        return bytes(frame)

    def _attack(self) -> bytes:
        rng = self.rng
        kind = rng.randrange(8)
        if kind < 4:
            return self._frame()
        if kind == 4 and self._overheard:
            replay = rng.choice(self._overheard)
            if self._forger is None:
                return self._garbage()
            return replay if rng.random() < 0.5 else self._forger.sign(self._frame())[:-6] + replay[-6:]
        if kind == 5 and self._forger is not None:
            return self._forger.sign(self._frame())
        if kind == 6:
            old = mav.MAVLink(None, *self._stranger_ids())
            return bytes(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(old, force_mavlink1=True))
        return self._garbage()

    def _hear(self, good: list[bytes]) -> None:
        rig, heard = self.rig, []
        # not at once where a busy kernel puts it off
        assert self.endpoint.wait(PATIENCE_S), "the datagram did not come over the loopback"
        while self.endpoint.wait(0.0):
            for received in self.endpoint.receive():
                header = received.message.get_header()
                sender = (header.srcSystem, header.srcComponent)
                replies = rig.autopilot.handle(received.message, sender, rig.now_s)
                self.endpoint.send(replies, received.peer)
                if sender == COMPANION:
                    heard.append(received.raw)
                    if received.message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                        m = received.message
                        self.wanted = (m.vy, m.vx, -m.vz)
                else:
                    self.acts[received.message.get_type()] += 1
        self.good += len(good)
        missing = sum(frame not in heard for frame in good)
        if missing and set(split_frames(self._datagram)) <= set(self._wire):
            self.lost += missing
        elif missing:
            self.accidents += 1


def _drain(sock: socket.socket) -> None:
    try:
        while True:
            sock.recv(65536, socket.MSG_DONTWAIT)
    except BlockingIOError:
        return
