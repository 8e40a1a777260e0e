"""Makes MAVLink frames for the tests of codec and endpoint."""

import random
import socket
import struct

from pymavlink.dialects.v20 import ardupilotmega as dialect

UNKNOWN = b"\xfd\x02\x00\x00\x00\x01\x01\xff\xff\xff\x01\x02\x03\x04"


def position(x=1.5):
    return dialect.MAVLink_local_position_ned_message(10, x, 2.0, 3.0, 4.0, 5.0, 6.0)


def frames_of(count, seed=0):
    rng = random.Random(seed)
    mav = dialect.MAVLink(None, 1, 1)
    makers = (
        lambda: position(rng.uniform(-9, 9)),
        lambda: dialect.MAVLink_heartbeat_message(2, 12, 81, rng.getrandbits(32), 3, 3),
        lambda: dialect.MAVLink_statustext_message(4, b"rejected: \xfd\xfe " * 3, 0, 0),
        lambda: dialect.MAVLink_timesync_message(0, rng.getrandbits(60)),
    )
    return [rng.choice(makers)().pack(mav) for _ in range(count)]


def packed(message, sequence=0, system=1, component=1):
    mav = dialect.MAVLink(None, system, component)
    mav.seq = sequence
    return message.pack(mav)


def raw_frame(message_id, payload, flags=0):
    body = bytes([len(payload), flags, 0, 7, 3, 4]) + message_id.to_bytes(3, "little") + payload
    crc = dialect.x25crc(body + bytes([dialect.mavlink_map[message_id].crc_extra])).crc
    return b"\xfd" + body + struct.pack("<H", crc) + (bytes(range(13)) if flags else b"")


class Caller:
    """A UDP socket that sends frames or messages to an endpoint and returns what the endpoint receives."""

    def __init__(self, server, ids=(1, 191)):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5.0)
        self.mav, self.server = dialect.MAVLink(None, *ids), server
        self.address = self.socket.getsockname()

    def put(self, *frames):
        self.socket.sendto(b"".join(frames), ("127.0.0.1", self.server.local_port))
        assert self.server.wait(5.0)
        return self.server.receive()

    def send(self, *messages):
        return self.put(*(message.pack(self.mav) for message in messages))
