"""Tests landings in one process: rounding of messages, equal seeds, and the stored landings."""

import json
import math
import random
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.frames import quaternion_from_yaw
from bridge.mavlink.codec.messages import decode
from bridge.ros2.cdr import Odometry
from bridge.target.odometry import RawSample, sample_of
from flightstack.common.pacing import EPOCH_NS
from sim.runners.landing_wire import PEER, wires
from sim.runners.robot import sample_rows, target_sample
from tests.golden.landings import CASES, FILE, differences

pytestmark = pytest.mark.slow

_EXTREMES = {"float": (0.1, -1e-9, 12345.678, math.nan, math.inf), "double": (0.1, 1e300), "char": (0,)}


def some_message(cls, rng):
    """Return a message of a class; 32 bits cannot represent some of its numbers."""
    values = []
    lengths = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    for name, kind in zip(cls.fieldnames, cls.fieldtypes, strict=True):
        length = lengths[name]
        if kind == "char":
            values.append(b"abc"[: length or 1])
            continue
        pick = _EXTREMES.get(kind, (0, 1, 7, 100))
        values.append([rng.choice(pick) for _ in range(length)] if length else rng.choice(pick))
    return cls(*values)


def same(a, b):
    return a == b or (a != a and b != b) or struct.pack("<d", a) == struct.pack("<d", b)


def test_every_message_is_handed_over_as_it_would_arrive():
    for id_ in sorted(mav.mavlink_map):
        rng = random.Random(id_)
        cls = mav.mavlink_map[id_]
        here, there = wires((1, 1), (1, 191))
        message, twin = some_message(cls, random.Random(id_)), some_message(cls, rng)
        expected = decode(twin.pack(mav.MAVLink(None, 1, 1)))
        here.send([message])
        (arrived,) = there.receive()
        assert arrived.peer == PEER
        header = arrived.message.get_header()
        assert (header.msgId, header.srcSystem, header.srcComponent) == (id_, 1, 1)
        for name in cls.fieldnames:
            got, wanted = getattr(arrived.message, name), getattr(expected, name)
            pairs = zip(got, wanted, strict=True) if isinstance(wanted, list) else [(got, wanted)]
            assert all(same(a, b) for a, b in pairs), name


def test_a_target_sample_is_what_cdr_makes_of_it():
    rng = np.random.default_rng(5)
    samples = rng.normal(0.0, 1.5, (50, 9))
    samples[:, 0], samples[:, 4] = rng.uniform(0.0, 90.0, 50), rng.uniform(-math.pi, math.pi, 50)
    for sample, row in zip(samples.tolist(), sample_rows(samples).tolist(), strict=True):
        time_s, x, y, z, yaw, vx, vy, vz, rate = sample
        q, now_ns = quaternion_from_yaw(yaw), EPOCH_NS + round(time_s * 1e9)
        sent = Odometry(now_ns, "map", "target", (x, y, z), q, (vx, vy, vz), (0.0, 0.0, rate))
        assert target_sample(1.25, row) == sample_of(RawSample(sent.pack()), 1.25)


STORED = json.loads(FILE.read_text())


@pytest.mark.parametrize("name", CASES)
def test_a_landing_is_flown_as_it_was(name):
    found = json.loads(json.dumps(CASES[name]()))
    different = differences(STORED.get(name), found)
    assert different == [], "if this is meant: python -m tests.golden.landings"


def test_nothing_else_is_stored():
    assert set(STORED) == set(CASES)
