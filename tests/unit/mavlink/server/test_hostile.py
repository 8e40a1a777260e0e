"""Tests that no input from the network crashes or floods the server, or makes it use invalid numbers."""

from __future__ import annotations

import copy
import math
import random
import struct
import subprocess
import sys

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.messages import decode
from bridge.mavlink.server.profile import PX4_CODES, FlightMode
from tests.unit.mavlink.server.served import GROUND_STATION, STRANGER, setpoint

NAN = math.nan
EXTREMES = [b"\x00", b"\xff", b"\x7f", b"\x80", b"\x7f\xc0", b"\x80\x7f", b"\xff\xff\xff\x7f"]
VALUES = (NAN, 0.0, 1.0, -1.0, 6.0, 4.0, 21196.0, 1e30, math.inf)
PARAMETERS = ["COM_OF_LOSS_T", "MPC_XY_P", "MIS_TAKEOFF_ALT", "COM_OBL_RC_ACT", "MAV_SYS_ID"]


def frame_of(cls, id_: int, payload: bytes):
    """Return the message that a receiver decodes from this payload."""
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 9, 9, id_ & 0xFFFF, id_ >> 16) + payload
    crc = mav.x25crc(body + bytes((cls.crc_extra,))).crc
    return decode(b"\xfd" + body + struct.pack("<H", crc))


def hostile(rng: random.Random, id_: int, commands: list[int]):
    """Return a random message with this id, often addressed to the vehicle and with its parameter names."""
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
        message._param_id_raw = message.param_id.encode()  # pymavlink packs ``_param_id_raw``
        if hasattr(message, "param_type"):
            message.param_type = rng.choice((6, 9))
    return message


@pytest.mark.parametrize("seed", range(2))
def test_nothing_from_the_network_raises_and_every_answer_can_be_sent(flown, seed: int) -> None:
    rng = random.Random(seed)
    link = mav.MAVLink(None, 1, 1)
    commands, sent = list(flown.server.commands.table), len(flown.telemetry)
    for id_ in [*mav.mavlink_map, *sorted(flown.server._handlers) * 20]:
        for _ in range(5):
            sender = rng.choice(((1, 191), (255, 190), (rng.randrange(256), rng.randrange(256))))
            replies = flown.handle(hostile(rng, id_, commands), sender)
            assert len(replies) <= 2
            for reply in replies:
                reply.pack(link)
        flown.run(0.01)
        said, sent = flown.telemetry[sent:], len(flown.telemetry)
        for message in said:
            message.pack(link)
        assert len(said) < 150
        assert flown.velocity_enu_m_s is None or all(map(math.isfinite, flown.velocity_enu_m_s))


def test_a_flood_of_different_refusals_says_little(served) -> None:
    for tick in range(500):
        for number in range(20):
            served.command(10_000 + 20 * tick + number, sender=GROUND_STATION)
        served.run(0.01)
    texts = served.texts()
    assert 20 <= len([t for t in texts if t.endswith("not supported")]) <= 6 * 20
    assert any(t.endswith("refusals not shown") for t in texts)


def test_asking_for_everything_at_the_highest_rate_is_bounded_by_the_loop(served) -> None:
    for id_ in mav.mavlink_map:
        served.command(511, float(id_), 1.0)
    served.run(0.05)
    before = len(served.telemetry)
    served.run(1.0)
    counts: dict[int, int] = {}
    for message in served.telemetry[before:]:
        counts[message.get_msgId()] = counts.get(message.get_msgId(), 0) + 1
    assert max(counts.values()) <= 100
    for _ in range(1000):
        served.handle(mav.MAVLink_param_request_list_message(1, 1))
    before = len(served.telemetry)
    served.run(0.01)
    assert len(served.telemetry) - before <= 20 + 30  # PARAM_VALUE has a rate limit


LAND = PX4_CODES[FlightMode.LAND]


def asks_to_land(message) -> bool:
    """Whether a message requests a landing, the only request that every sender may make."""
    kind = message.get_type()
    if kind in ("COMMAND_LONG", "COMMAND_INT"):
        codes = (message.param2, message.param3)
        is_land = all(map(math.isfinite, codes)) and tuple(map(round, codes)) == (LAND.main, LAND.sub)
        return message.command == 21 or (message.command == 176 and is_land)
    return kind == "SET_MODE" and message.custom_mode >> 16 & 0xFFFF == LAND.main | LAND.sub << 8


@pytest.mark.parametrize("seed", range(2))
def test_a_stranger_can_neither_fly_it_nor_change_what_its_owner_has_set(flown, seed: int) -> None:
    rng = random.Random(seed)
    commands, handled = list(flown.server.commands.table), sorted(flown.server._handlers)
    parameters, (mode, armed, intervals_us, *rest) = copy.deepcopy(flown.server.parameters), flown.state()
    for i in range(1500):
        message = hostile(rng, rng.choice(handled if i % 2 else list(mav.mavlink_map)), commands)
        if not asks_to_land(message):
            flown.handle(message, STRANGER)
        flown.handle(setpoint(0.1))
        flown.tick()
        assert flown.velocity_enu_m_s == pytest.approx((0.0, 0.1, 0.0)), message
    now_mode, now_armed, now_us, *now_rest = flown.state()
    assert (now_mode, now_armed, now_rest) == (mode, armed, rest)
    assert flown.server.parameters._values == parameters._values
    rarer = zip(now_us, intervals_us, strict=True)  # us; -1: stream off; strangers may only shorten intervals
    assert all(0 < now <= before or before < 0 for now, before in rarer)


def test_nothing_else_imports_cflib():
    code = (
        "import sys, flightstack.onboard.process, bridge.crazyflie, bridge.mocap; "
        "from flightstack.cli.main import VERBS, main; "
        "verbs = [main.get_command(None, name) for name in VERBS]; "
        "assert all(verbs); assert 'cflib' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
