"""Tests the search for frames in datagrams, and in byte streams that are noisy or split at any byte."""

import random
from collections import Counter

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.framing import Framer, split_frames
from bridge.mavlink.codec.messages import MESSAGES, decode, message_id
from tests.unit.mavlink.codec.frames_of_messages import UNKNOWN, frames_of, position, raw_frame


def test_bad_checksum_is_counted_and_the_next_frame_survives():
    first, second = frames_of(2)
    broken = first[:-1] + bytes([first[-1] ^ 1])
    counters = Counter()
    assert split_frames(broken + second, counters) == [second]
    assert counters["bad_crc"] == 1
    assert counters["garbage_bytes"] == len(broken)


def test_version_1_frames_are_dropped_and_counted():
    mav = dialect.MAVLink(None, 1, 1)
    old = position().pack(mav, force_mavlink1=True)
    new = position().pack(mav)
    counters = Counter()
    assert split_frames(old + new + old, counters) == [new]
    assert counters["version_1"] == 2
    assert counters["garbage_bytes"] == 0


@pytest.mark.parametrize("before", [0, 1, 3])
@pytest.mark.parametrize("behind", [0, 1])
def test_unknown_message_is_kept_raw_where_the_frames_around_show_its_length(before, behind):
    good, counters = frames_of(1)[0], Counter()
    found = split_frames(good + UNKNOWN * (before + 1) + good * behind, counters)
    assert found == [good, *[UNKNOWN] * (before + 1), *[good] * behind]
    assert (counters["unknown_frames"], counters["unknown_id"], counters["garbage_bytes"]) == (
        before + 1,
        0,
        0,
    )


@pytest.mark.parametrize(
    "datagram",
    [
        pytest.param(UNKNOWN + b"\x00", id="something else behind"),
        pytest.param(UNKNOWN[:-1], id="cut short"),
        pytest.param(UNKNOWN[:5] + b"\x00" + UNKNOWN[6:], id="no sender"),
    ],
)
def test_what_only_looks_like_an_unknown_message_is_garbage(datagram):
    counters = Counter()
    assert split_frames(datagram, counters) == []
    assert counters["garbage_bytes"] == len(datagram)


def test_signed_frame_is_kept_whole_and_unknown_flags_are_refused():
    payload = bytes(range(9))
    signed = raw_frame(0, payload, flags=1)
    strange = raw_frame(0, payload, flags=2)
    assert split_frames(strange + signed) == [signed]


def test_fuzz_never_raises_and_never_loses_a_good_frame():
    """Of 5000 datagrams with random bytes and changed, truncated and good frames, no good frame is lost."""
    rng = random.Random(1)
    pool = frames_of(200, seed=2)
    for _ in range(5_000):
        pieces, good = [], []
        for _ in range(rng.randrange(1, 5)):
            kind = rng.randrange(5)
            frame = rng.choice(pool)
            if kind == 0:
                pieces.append(rng.randbytes(rng.randrange(0, 40)))
            elif kind == 1:
                mutated = bytearray(frame)
                mutated[rng.randrange(len(mutated))] ^= 1 << rng.randrange(8)
                pieces.append(bytes(mutated))
            elif kind == 2:
                pieces.append(frame[: rng.randrange(len(frame))])
            elif kind == 3:
                pieces.append(bytes([0xFD, rng.randrange(256), rng.randrange(2)]))
            else:
                pieces.append(frame)
                good.append(frame)
        counters = Counter()
        datagram = b"".join(pieces)
        found = split_frames(datagram, counters)
        assert sum(map(len, found)) + counters["garbage_bytes"] == len(datagram) or counters["version_1"]
        remaining = iter(found)
        assert all(any(frame == other for other in remaining) for frame in good), datagram.hex()
        for frame in found:
            if message_id(frame) in MESSAGES:
                decode(frame)


def pieces_of(stream, rng, longest=40):
    at = 0
    while at < len(stream):
        size = rng.randrange(1, longest)
        yield stream[at : at + size]
        at += size


def push_all(counters, pieces):
    framer = Framer(counters, stream=True)
    return [frame for piece in pieces for frame in framer.push(piece)]


def test_hundred_thousand_bytes_of_noise_lose_no_frame():
    """Every frame is found, in order, between noise; about half of the noise consists of start bytes."""
    rng, counters = random.Random(2), Counter()
    frames, stream, noise = frames_of(2000, seed=3), bytearray(), 0
    for frame in frames:
        stray = rng.choice((rng.randbytes, lambda n: b"\xfd" * n))(rng.randrange(0, 102))
        noise += len(stray)
        stream += stray + frame
    assert noise > 100_000 - 5_000
    stream += b"".join(frames_of(12, seed=4))  # after a false header the search waits for more bytes
    found = push_all(counters, pieces_of(bytes(stream), rng))
    assert found == frames + frames_of(12, seed=4)
    assert counters["garbage_bytes"] == noise


@pytest.mark.parametrize("longest", [2, 9, 100])
def test_unknown_message_is_kept_raw_once_the_next_frame_shows_its_length(longest):
    frames, counters = frames_of(50, seed=12), Counter()
    stream = b"".join(frame + UNKNOWN for frame in frames) + frames[0]
    found = push_all(counters, pieces_of(stream, random.Random(13), longest))
    assert found == [*(each for frame in frames for each in (frame, UNKNOWN)), frames[0]]
    assert (counters["unknown_frames"], counters["garbage_bytes"]) == (50, 0)
