"""Frames in a byte stream: cut anywhere, between noise, lost in part."""

import random

import pytest

from bridge.mavlink.codec.framing import REST_MAX, FrameCounters, StreamFramer
from bridge.mavlink.endpoint import dialect
from tests.unit.mavlink.codec.test_mavlink_endpoint import UNKNOWN, frames_of


def pieces_of(stream, rng, longest=40):
    at = 0
    while at < len(stream):
        size = rng.randrange(1, longest)
        yield stream[at : at + size]
        at += size


def push_all(framer, pieces, unknown=None):
    return [frame for piece in pieces for frame in framer.push(piece, unknown)]


@pytest.mark.parametrize("longest", [2, 7, 40, 600])
def test_frames_cut_anywhere_come_whole_and_in_order(longest):
    frames, counters = frames_of(300, seed=longest), FrameCounters()
    found = push_all(StreamFramer(counters), pieces_of(b"".join(frames), random.Random(1), longest))
    assert found == frames
    assert counters == FrameCounters()


def test_frame_is_given_with_its_last_byte():
    frame = frames_of(1)[0]
    framer = StreamFramer(FrameCounters())
    assert list(framer.push(frame[:-1])) == []
    assert framer.waiting_bytes == len(frame) - 1
    assert list(framer.push(frame[-1:])) == [frame]
    assert framer.waiting_bytes == 0


def test_hundred_thousand_bytes_of_noise_lose_no_frame():
    """Noise between the frames, half of it start bytes; every good frame comes, in order."""
    rng, counters = random.Random(2), FrameCounters()
    frames, stream, noise = frames_of(2000, seed=3), bytearray(), 0
    for frame in frames:
        stray = rng.choice((rng.randbytes, lambda n: b"\xfd" * n))(rng.randrange(0, 102))
        noise += len(stray)
        stream += stray + frame
    assert noise > 100_000 - 5_000
    stream += b"".join(frames_of(12, seed=4))  # what the last false start waits for
    found = push_all(StreamFramer(counters), pieces_of(bytes(stream), rng))
    assert found == frames + frames_of(12, seed=4)
    assert counters.garbage_bytes == noise


def test_noise_in_frames_loses_those_it_hits_and_no_other():
    rng, counters = random.Random(5), FrameCounters()
    frames = frames_of(4000, seed=6)
    hit = {i for i in range(len(frames)) if rng.random() < 0.2}
    damaged = []
    for i, frame in enumerate(frames):
        if i in hit:
            at = rng.randrange(len(frame))
            frame = frame[:at] + bytes([frame[at] ^ 1 << rng.randrange(8)]) + frame[at + 1 :]
        damaged.append(frame)
    tail = frames_of(12, seed=7)
    found = push_all(StreamFramer(counters), pieces_of(b"".join(damaged + tail), rng))
    assert found == [frame for i, frame in enumerate(frames) if i not in hit] + tail


def test_lost_bytes_cost_the_frames_they_belong_to():
    rng, counters = random.Random(8), FrameCounters()
    frames = frames_of(3000, seed=9)
    kept, stream = [], b""
    for frame in frames:
        if rng.random() < 0.1:
            at = rng.randrange(len(frame))
            stream += frame[:at] + frame[at + rng.randrange(1, 20) :]
        else:
            stream += frame
            kept.append(frame)
    tail = frames_of(12, seed=10)
    found = push_all(StreamFramer(counters), pieces_of(stream + b"".join(tail), rng))
    missing = iter(found)
    assert all(any(frame == other for other in missing) for frame in kept + tail)


def test_buffer_is_bounded_whatever_comes():
    rng, framer = random.Random(11), StreamFramer(FrameCounters())
    for _ in range(3000):
        header = bytes([0xFD, 255, 0, 0, 0, 1, 1, rng.randrange(256), rng.randrange(2), 0])
        list(framer.push(header + rng.randbytes(rng.randrange(0, 60))))
        assert framer.waiting_bytes <= REST_MAX + 280


def test_false_start_behind_noise_keeps_nothing_back():
    """Its header names no message, so the good frame behind it is not waited with."""
    good, framer = frames_of(1)[0], StreamFramer(FrameCounters())
    assert list(framer.push(b"\x00\xfd\xff\x00" + bytes(range(1, 8)) + good)) == [good]


@pytest.mark.parametrize("longest", [2, 9, 100])
def test_unknown_message_is_kept_raw_once_the_next_frame_shows_its_length(longest):
    frames, kept, counters = frames_of(50, seed=12), [], FrameCounters()
    stream = b"".join(frame + UNKNOWN for frame in frames) + frames[0]
    framer = StreamFramer(counters)
    found = push_all(framer, pieces_of(stream, random.Random(13), longest), kept.append)
    assert found == [*frames, frames[0]]
    assert kept == [UNKNOWN] * 50
    assert (counters.unknown_frames, counters.garbage_bytes) == (50, 0)


def test_signed_frames_are_kept_whole():
    frame = frames_of(1)[0]
    signed = dialect.MAVLink(None, 1, 1)
    signed.signing.secret_key, signed.signing.sign_outgoing = bytes(range(32)), True
    stream = b"".join(dialect.MAVLink_timesync_message(0, n).pack(signed) for n in range(20)) + frame
    found = push_all(StreamFramer(FrameCounters()), pieces_of(stream, random.Random(14), 9))
    assert b"".join(found) == stream
    assert len(found) == 21
