"""Hostile datagrams for a vehicle in flight, over a real socket, beside an owner who flies it."""

from __future__ import annotations

import math
import random
import socket
import struct
from collections import Counter

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.server.profile import PX4_CODES, FlightMode
from bridge.mavlink.signing.key import SigningKey
from bridge.mavlink.signing.signing import Signer
from tests.unit.autopilot.autopilot_fakes import COMPANION, NAN, Rig, setpoint

GROUND_STATIONS = (245, 255)
_STREAMS = (
    mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mav.MAVLINK_MSG_ID_SYS_STATUS,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mav.MAVLINK_MSG_ID_BATTERY_STATUS,
)  # fmt: skip
PER_TICK = 20  # datagrams
HEIGHT_M = 0.5
PATIENCE_S = 10.0
LAND = PX4_CODES[FlightMode.LAND]
_SIZES = {"char": 1, "int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4,
          "float": 4, "int64_t": 8, "uint64_t": 8, "double": 8}  # fmt: skip
_WORDS = [
    struct.pack("<f", v) for v in (math.nan, math.inf, -math.inf, 3e38, -3e38, 1e-45, 0.0, 1.0, 6.0, 4.0)
]
_WORDS += [
    struct.pack("<I", v) for v in (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0x7FC00000, 0x7F800001, 1, 2**16)
]
_COMMANDS = (
    400,
    22,
    20,
    176,
    185,
    179,
    192,
    246,
    252,
    300,
    420,
    511,
    510,
    512,
    520,
    519,
    521,
    410,
    401,
    178,
    43000,
)
_FOCUS = (
    mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT, mav.MAVLINK_MSG_ID_SET_MODE,
    mav.MAVLINK_MSG_ID_PARAM_SET, mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mav.MAVLINK_MSG_ID_MANUAL_CONTROL, mav.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE,
    mav.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL,
    mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST, mav.MAVLINK_MSG_ID_TIMESYNC, mav.MAVLINK_MSG_ID_SETUP_SIGNING,
    mav.MAVLINK_MSG_ID_SET_HOME_POSITION, mav.MAVLINK_MSG_ID_HEARTBEAT,
)  # fmt: skip
_PARAMETERS = (
    b"COM_OF_LOSS_T",
    b"MPC_LAND_SPEED",
    b"MIS_TAKEOFF_ALT",
    b"MPC_XY_P",
    b"COM_OBL_RC_ACT",
    b"MAV_SYS_ID",
)
_CODES = {PX4_CODES[mode][:2] for mode in FlightMode}


def _offsets(cls) -> dict[str, int]:
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    at, found = 0, {}
    for name, length in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True):
        found[name] = at
        at += _SIZES[kinds[name]] * max(1, length)
    assert at == cls.unpacker.size
    return found


_OFFSETS = {id_: _offsets(cls) for id_, cls in mav.mavlink_map.items()}


def checked(message_id: int, payload: bytes, ids: tuple[int, int], sequence: int = 0) -> bytes:
    """A frame with a right checksum around any payload."""
    body = bytes([len(payload), 0, 0, sequence, *ids]) + message_id.to_bytes(3, "little") + payload
    crc = mav.mcrf4xx(body + bytes([mav.mavlink_map[message_id].crc_extra]))
    return b"\xfd" + body + struct.pack("<H", crc)


class HostileFrames:
    """Valid checksums, hostile values: every message in turn, the dangerous ones more often."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._ids = list(mav.mavlink_map)
        self._turn = 0

    def frame(self, ids: tuple[int, int]) -> bytes:
        rng = self._rng
        if rng.random() < 0.5:
            message_id = rng.choice(_FOCUS)
        else:
            message_id = self._ids[self._turn % len(self._ids)]
            self._turn += 1
        payload = bytearray(self._payload(mav.mavlink_map[message_id].unpacker.size))
        self._aim(message_id, payload)
        cut = len(payload) if rng.random() < 0.8 else rng.randrange(1, len(payload) + 1)
        return checked(message_id, bytes(payload[:cut]), ids, rng.randrange(256))

    def _payload(self, size: int) -> bytes:
        rng = self._rng
        if rng.random() < 0.3:
            return rng.randbytes(size)
        return b"".join(rng.choice(_WORDS) for _ in range(size // 4 + 1))[:size]

    def _aim(self, message_id: int, payload: bytearray) -> None:
        """Most go to this vehicle, and name commands, modes, frames and parameters that it has."""
        rng, offsets = self._rng, _OFFSETS[message_id]
        if rng.random() < 0.9:
            for name, values in (("target_system", (1, 1, 0)), ("target_component", (1, 0))):
                if name in offsets:
                    payload[offsets[name]] = rng.choice(values)
        if "command" in offsets and message_id in (75, 76) and rng.random() < 0.8:
            struct.pack_into("<H", payload, offsets["command"], rng.choice(_COMMANDS))
            for n in range(1, 8):
                if f"param{n}" in offsets and rng.random() < 0.6:
                    value = rng.choice(
                        (0.0, 1.0, 21196.0, 2989.0, 4.0, 6.0, math.nan, math.inf, -1.0, 32.0, 1e9)
                    )
                    struct.pack_into("<f", payload, offsets[f"param{n}"], value)
        if message_id == mav.MAVLINK_MSG_ID_SET_MODE and rng.random() < 0.7:
            main, sub = rng.choice(sorted(_CODES))
            struct.pack_into("<I", payload, offsets["custom_mode"], main << 16 | sub << 24)
        if message_id == mav.MAVLINK_MSG_ID_PARAM_SET and rng.random() < 0.8:
            payload[offsets["param_id"] : offsets["param_id"] + 16] = rng.choice(_PARAMETERS).ljust(16, b"\0")
            payload[offsets["param_type"]] = rng.choice((6, 9))
        if message_id == mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED and rng.random() < 0.8:
            struct.pack_into("<H", payload, offsets["type_mask"], rng.choice((2503, 1479, 3527, 0)))
            payload[offsets["coordinate_frame"]] = rng.choice((1, 8, 0, 9))
            for name in ("vx", "vy", "vz", "yaw") if rng.random() < 0.5 else ():
                struct.pack_into("<f", payload, offsets[name], rng.uniform(-2.0, 2.0))


def asks_to_land(frame: bytes) -> bool:
    """Whether a frame asks for what anybody may ask for: to land."""
    message = decode(frame)
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
        self._hostile = HostileFrames(self.rng)
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
        while True:
            frame = self._hostile.frame(self._stranger_ids())
            if self.signer is not None or not asks_to_land(frame):
                return frame

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
