"""Nothing from the network can break the autopilot, make it talk without end, or fly on broken numbers."""

from __future__ import annotations

import math
import random
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.server.texts import Texts
from tests.unit.autopilot.autopilot_fakes import GROUND_STATION, NAN, Rig

EXTREMES = [b"\x00", b"\xff", b"\x7f", b"\x80", b"\x7f\xc0", b"\x80\x7f", b"\xff\xff\xff\x7f"]
HANDLED = sorted(Rig().autopilot.handled)


def frame_of(cls, id_: int, payload: bytes):
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 9, 9, id_ & 0xFFFF, id_ >> 16) + payload
    crc = mav.x25crc(body + bytes((cls.crc_extra,))).crc
    return decode(b"\xfd" + body + struct.pack("<H", crc))


def hostile(rng: random.Random, id_: int, commands: list[int]):
    cls = mav.mavlink_map[id_]
    size = cls.unpacker.size
    pattern = rng.choice([None, *EXTREMES])
    payload = rng.randbytes(size) if pattern is None else (pattern * size)[:size]
    message = frame_of(cls, id_, payload)
    names = list(cls.ordered_fieldnames)
    if "target_system" in names:
        message.target_system, message.target_component = rng.choice(((1, 1), (1, 0), (0, 0)))
    if "command" in names:
        message.command = rng.choice([*commands, 9])
        message.frame = rng.choice((0, 3, 6, getattr(message, "frame", 0)))
    for name in names:
        if name.startswith("param") and isinstance(getattr(message, name), float) and rng.random() < 0.7:
            setattr(message, name, rng.choice((NAN, 0.0, 1.0, -1.0, 6.0, 4.0, 21196.0, 1e30, math.inf)))
    if hasattr(message, "param_id") and rng.random() < 0.8:
        message.param_id = rng.choice(["COM_OF_LOSS_T", "MPC_XY_P", "GF_ACTION", "SYS_FAILURE_EN"])
        if hasattr(message, "param_type"):
            message.param_type = rng.choice((6, 9))
    return message


@pytest.mark.parametrize("seed", range(4))
def test_nothing_from_the_network_raises_and_every_answer_can_be_sent(seed: int) -> None:
    rng = random.Random(seed)
    rig = Rig().offboard()
    rig.telemetry.clear()
    link = mav.MAVLink(None, 1, 1)
    commands = list(rig.autopilot.commands.table)
    for id_ in [*mav.mavlink_map, *HANDLED * 20]:
        for _ in range(5):
            sender = rng.choice(((1, 191), (255, 190), (rng.randrange(256), rng.randrange(256))))
            replies = rig.handle(hostile(rng, id_, commands), sender)
            assert len(replies) <= 2
            for reply in replies:
                reply.pack(link)
        rig.run(0.01)  # the fake vehicle refuses set-points that are not finite
        for message in rig.telemetry:
            message.pack(link)
        assert len(rig.telemetry) < 150
        rig.telemetry.clear()


def test_a_flood_of_different_refusals_says_little() -> None:
    rig = Rig()
    for tick in range(500):
        for number in range(20):
            rig.command(10_000 + 20 * tick + number, sender=GROUND_STATION)
        rig.run(0.01)
    texts = rig.texts()
    assert 20 <= len([t for t in texts if t.endswith("not supported")]) <= 20 + 5 * 5 + 1
    assert any(t.endswith("refusals not shown") for t in texts)


def test_texts_waiting_are_bounded_and_the_same_refusal_comes_once_a_second() -> None:
    texts = Texts()
    for i in range(1000):
        texts.say(6, f"event {i}")
    assert len(texts.take()) == 64
    for tick in range(250):
        texts.refuse("no", 0.01 * tick)
    assert [t.text for t in texts.take()] == ["no"] * 3
    for i in range(1000):
        texts.refuse(f"no {i}", 100.0 + i)
    assert len(texts._said_s) <= 64


def test_texts_nobody_logs_do_not_pile_up() -> None:
    rig = Rig()
    for i in range(3000):
        rig.autopilot.flight.say(6, f"event {i}")
        rig.run(0.01)
    texts = rig.autopilot.take_texts()
    assert len(texts) == 1024
    assert texts[-1].text == "event 2999"


def test_asking_for_everything_at_the_highest_rate_is_bounded_by_the_loop() -> None:
    rig = Rig()
    for id_ in mav.mavlink_map:
        rig.command(511, float(id_), 1.0)
    rig.run(0.05)
    rig.telemetry.clear()
    rig.run(1.0)
    counts: dict[int, int] = {}
    for message in rig.telemetry:
        counts[message.get_msgId()] = counts.get(message.get_msgId(), 0) + 1
    assert max(counts.values()) <= 100
    for _ in range(1000):
        rig.handle(mav.MAVLink_param_request_list_message(1, 1))
    before = len(rig.telemetry)
    rig.run(0.01)
    assert len(rig.telemetry) - before <= 20 + 30  # PARAM_VALUE is paced
