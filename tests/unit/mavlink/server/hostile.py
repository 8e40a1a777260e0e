"""Messages with a valid checksum and hostile values."""

from __future__ import annotations

import math
import random
import struct

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.server.profile import PX4_CODES

NAN = math.nan
EXTREMES = [b"\x00", b"\xff", b"\x7f", b"\x80", b"\x7f\xc0", b"\x80\x7f", b"\xff\xff\xff\x7f"]
VALUES = (NAN, 0.0, 1.0, -1.0, 6.0, 4.0, 21196.0, 1e30, math.inf)
PARAMETERS = ["COM_OF_LOSS_T", "MPC_XY_P", "MIS_TAKEOFF_ALT", "COM_OBL_RC_ACT", "COM_DL_LOSS_T",
              "SYS_FAILURE_EN", "MAV_SYS_ID"]  # fmt: skip


def frame_of(cls, id_: int, payload: bytes):
    """A message as it comes from the wire."""
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 9, 9, id_ & 0xFFFF, id_ >> 16) + payload
    crc = mav.x25crc(body + bytes((cls.crc_extra,))).crc
    return decode(b"\xfd" + body + struct.pack("<H", crc))


def hostile(rng: random.Random, id_: int, commands: list[int]):
    """A message of this id; most are addressed to the vehicle and name what it has."""
    cls = mav.mavlink_map[id_]
    size = cls.unpacker.size
    pattern = rng.choice([None, *EXTREMES])
    payload = rng.randbytes(size) if pattern is None else (pattern * size)[:size]
    message = frame_of(cls, id_, payload)
    names = list(cls.ordered_fieldnames)
    if "target_system" in names:
        message.target_system, message.target_component = rng.choice(((1, 1), (1, 0), (0, 0)))
    if isinstance(getattr(message, "command", None), int):
        message.command = rng.choice([*commands, 9])
        message.frame = rng.choice((0, 3, 6, getattr(message, "frame", 0)))
    for name in names:
        if name.startswith("param") and isinstance(getattr(message, name), float) and rng.random() < 0.7:
            setattr(message, name, rng.choice(VALUES))
    if id_ == mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED and rng.random() < 0.7:
        message.type_mask, message.coordinate_frame = rng.choice((2503, 1479, 3527)), rng.choice((1, 8))
        for name in ("vx", "vy", "vz", "yaw", "yaw_rate"):
            setattr(message, name, rng.choice((rng.uniform(-4.0, 4.0), *VALUES)))
    if id_ == mav.MAVLINK_MSG_ID_SET_MODE and rng.random() < 0.7:
        message.custom_mode = rng.choice(list(PX4_CODES.values())).custom_mode
    if hasattr(message, "param_id") and rng.random() < 0.8:
        message.param_id = rng.choice(PARAMETERS)
        message._param_id_raw = message.param_id.encode()  # what is packed
        if hasattr(message, "param_type"):
            message.param_type = rng.choice((6, 9))
    return message
