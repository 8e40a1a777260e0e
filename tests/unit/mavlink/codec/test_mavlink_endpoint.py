import random
import socket
import struct

import pytest

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.codec.framing import FrameCounters, split_frames
from bridge.mavlink.endpoint import Direction, Endpoint, dialect, parse_url


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


def raw_frame(message_id, payload, flags=0):
    body = bytes([len(payload), flags, 0, 7, 3, 4]) + message_id.to_bytes(3, "little") + payload
    crc = dialect.x25crc(body + bytes([dialect.mavlink_map[message_id].crc_extra])).crc
    return b"\xfd" + body + struct.pack("<H", crc) + (bytes(range(13)) if flags else b"")


@pytest.fixture
def pair():
    server = Endpoint("udpin:127.0.0.1:0", 1, 1)
    client = Endpoint(f"udpout://127.0.0.1:{server.local_port}", 1, 191)
    yield server, client
    server.close()
    client.close()


def take(endpoint, count):
    received = []
    while len(received) < count:
        assert endpoint.wait(5.0), f"only {len(received)} of {count} frames came"
        received += endpoint.receive()
    return received


# --- framing


def test_frames_of_one_datagram_come_in_order():
    frames = frames_of(20)
    assert list(split_frames(b"".join(frames))) == frames


def test_stray_start_byte_costs_no_good_frame():
    frames = frames_of(8)
    counters = FrameCounters()
    assert list(split_frames(b"\xfd\xff\x00" + b"".join(frames), counters)) == frames
    assert counters.garbage_bytes == 3


def test_bad_checksum_is_counted_and_the_next_frame_survives():
    first, second = frames_of(2)
    broken = first[:-1] + bytes([first[-1] ^ 1])
    counters = FrameCounters()
    assert list(split_frames(broken + second, counters)) == [second]
    assert counters.bad_crc == 1
    assert counters.garbage_bytes == len(broken)


def test_version_1_frames_are_dropped_and_counted():
    mav = dialect.MAVLink(None, 1, 1)
    old = position().pack(mav, force_mavlink1=True)
    new = position().pack(mav)
    counters = FrameCounters()
    assert list(split_frames(old + new + old, counters)) == [new]
    assert counters.version_1 == 2
    assert counters.garbage_bytes == 0


UNKNOWN = b"\xfd\x02\x00\x00\x00\x01\x01\xff\xff\xff\x01\x02\x03\x04"


@pytest.mark.parametrize("before", [0, 1, 3])
@pytest.mark.parametrize("behind", [0, 1])
def test_unknown_message_is_kept_raw_where_the_frames_around_show_its_length(before, behind):
    good, kept = frames_of(1)[0], []
    counters = FrameCounters()
    found = list(split_frames(good + UNKNOWN * (before + 1) + good * behind, counters, kept.append))
    assert (found, kept) == ([good] * (1 + behind), [UNKNOWN] * (before + 1))
    assert (counters.unknown_frames, counters.unknown_id, counters.garbage_bytes) == (before + 1, 0, 0)


@pytest.mark.parametrize(
    "datagram",
    [
        pytest.param(UNKNOWN + b"\x00", id="something else behind"),
        pytest.param(UNKNOWN[:-1], id="cut short"),
        pytest.param(UNKNOWN[:5] + b"\x00" + UNKNOWN[6:], id="no sender"),
        pytest.param(UNKNOWN * 5, id="nothing but unknown ones"),
    ],
)
def test_what_only_looks_like_an_unknown_message_is_garbage(datagram):
    kept, counters = [], FrameCounters()
    assert list(split_frames(datagram, counters, kept.append)) == []
    assert len(kept) <= 4
    assert counters.garbage_bytes + sum(map(len, kept)) == len(datagram)
    assert counters.garbage_bytes > 0


def test_unknown_message_never_hides_a_good_frame():
    good, kept = frames_of(1)[0], []
    header = bytes([0xFD, len(good) + 3, 0, 0, 0, 1, 1, 255, 255, 255])
    assert list(split_frames(header + b"abc" + good + b"\x01\x02", None, kept.append)) == [good]
    assert kept == []


def test_signed_frame_is_kept_whole_and_unknown_flags_are_refused():
    payload = bytes(range(9))
    signed = raw_frame(0, payload, flags=1)
    strange = raw_frame(0, payload, flags=2)
    assert list(split_frames(strange + signed)) == [signed]


@pytest.mark.parametrize("cut", [1, 5, 11, 20])
def test_truncated_frame_is_garbage(cut):
    frame = frames_of(1)[0][:cut]
    counters = FrameCounters()
    assert list(split_frames(frame, counters)) == []
    assert counters.garbage_bytes == cut


def test_fuzz_never_raises_and_never_loses_a_good_frame():
    """20 000 datagrams: random bytes, mutations, cuts and good frames, mixed in any order."""
    rng = random.Random(1)
    pool = frames_of(200, seed=2)
    for _ in range(20_000):
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
        counters = FrameCounters()
        datagram = b"".join(pieces)
        unknown = []
        found = list(split_frames(datagram, counters, unknown.append))
        assert sum(map(len, found + unknown)) + counters.garbage_bytes == len(datagram) or counters.version_1
        remaining = iter(found)
        assert all(any(frame == other for other in remaining) for frame in good), datagram.hex()
        for frame in found:
            decode(frame)


# --- decoding


def test_decoding_equals_pymavlink_for_every_message():
    rng = random.Random(3)
    mav = dialect.MAVLink(None, 1, 1)
    for message_id, cls in dialect.mavlink_map.items():
        for length in (cls.unpacker.size, rng.randrange(0, 256)):
            frame = raw_frame(message_id, rng.randbytes(min(length, 255)), flags=rng.getrandbits(1))
            ours, theirs = decode(frame), mav.decode(bytearray(frame))
            ours_header, theirs_header = (
                vars(ours.__dict__.pop("_header")),
                vars(theirs.__dict__.pop("_header")),
            )
            assert ours_header == theirs_header
            assert type(ours) is type(theirs)
            assert repr(ours.__dict__) == repr(theirs.__dict__), cls.msgname  # repr: NaN equals itself


# --- endpoint


@pytest.mark.parametrize(
    "url",
    [
        "",
        "udp:1:2",
        "udpin:127.0.0.1",
        "udpin:127.0.0.1:99999",
        "udpout:127.0.0.1:0",
        "tcp:1.2.3.4:0",
        "tcp:1.2.3.4",
        "serial:ttyS0",
        "serial:",
        "serial:/dev/ttyS0:1",
        "serial:/dev/ttyS0:99999999",
        "udpin:a b:1",
    ],
)
def test_bad_url_says_what_is_allowed(url):
    with pytest.raises(ValueError, match="allowed is"):
        parse_url(url)


@pytest.mark.parametrize("ids", [(0, 1), (1, 256)])
def test_bad_ids_are_refused(ids):
    with pytest.raises(ValueError, match="allowed is 1 to 255"):
        Endpoint("udpin:127.0.0.1:0", *ids)


def test_port_in_use_is_a_clear_error():
    first = Endpoint("udpin:127.0.0.1:0", 1, 1)
    try:
        with pytest.raises(OSError, match="another process"):
            Endpoint(f"udpin:127.0.0.1:{first.local_port}", 1, 1)
    finally:
        first.close()


def test_messages_travel_in_one_datagram_with_our_ids_and_numbers(pair):
    server, client = pair
    client.send([position(), dialect.MAVLink_timesync_message(0, 5)])
    assert server.wait(5.0)
    received = server.receive()
    assert [r.message.get_type() for r in received] == ["LOCAL_POSITION_NED", "TIMESYNC"]
    assert [r.message.get_seq() for r in received] == [0, 1]
    assert {(r.message.get_srcSystem(), r.message.get_srcComponent()) for r in received} == {(1, 191)}
    assert received[0].peer == ("127.0.0.1", client.local_port)
    assert received[0].raw == bytes(received[0].message.get_msgbuf())


def test_tap_sees_every_frame_both_ways(pair):
    server, client = pair
    seen = []
    server.tap = lambda direction, frame, peer: seen.append((direction, frame, peer))
    client.send([dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), position()])
    incoming = [r.raw for r in take(server, 2)]
    server.send([dialect.MAVLink_timesync_message(1, 2)])
    outgoing = take(client, 1)[0].raw
    peer = ("127.0.0.1", client.local_port)
    assert seen == [(Direction.IN, frame, peer) for frame in incoming] + [(Direction.OUT, outgoing, peer)]


def test_too_much_for_one_datagram_is_split_in_order(pair):
    server, client = pair
    texts = [dialect.MAVLink_statustext_message(6, f"{i:050d}".encode(), 0, 0) for i in range(60)]
    client.send(texts)
    assert [int(r.message.text) for r in take(server, 60)] == list(range(60))


def test_endpoint_survives_a_flood_of_garbage(pair):
    server, client = pair
    rng = random.Random(4)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(100):
            for _ in range(20):
                stranger.sendto(rng.randbytes(rng.randrange(0, 300)), ("127.0.0.1", server.local_port))
            server.receive()
    client.send([position(7.0)])
    assert take(server, 1)[0].message.x == 7.0


def test_datagram_beyond_every_network_is_not_looked_at(pair):
    server, client = pair
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"".join(frames_of(200)), ("127.0.0.1", server.local_port))
    client.send([position(7.0)])
    assert take(server, 1)[0].message.x == 7.0
    assert server.counters.oversize == 1


def test_full_datagrams_do_not_keep_the_loop(pair):
    """50 datagrams of 90 frames are more than one call takes; nothing of them is lost."""
    server, _ = pair
    frames = [position().pack(dialect.MAVLink(None, 1, 191))] * 90
    datagram = b"".join(frames)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flood:
        for _ in range(50):
            flood.sendto(datagram, ("127.0.0.1", server.local_port))
    assert server.wait(5.0)
    first = len(server.receive())
    assert 0 < first < 50 * 90
    while server.counters.received < 50 * 90:
        assert server.wait(5.0)
        server.receive()
    assert server.counters.received == 50 * 90


def test_closed_port_of_the_other_side_is_survived(pair):
    """A connected socket reports it at the next call, which must not swallow a datagram of ours."""
    server, client = pair
    url = f"udpin:127.0.0.1:{server.local_port}"
    server.close()
    for _ in range(3):
        client.send([position()])
        client.wait(0.2)
        assert client.receive() == []
    again = Endpoint(url, 1, 1)
    client.send([position(9.0)])
    assert take(again, 1)[0].message.x == 9.0
    again.close()


def test_wait_gives_up_after_the_time_and_close_can_be_repeated():
    endpoint = Endpoint("udpin:127.0.0.1:0", 1, 1)
    assert endpoint.wait(0.001) is False
    assert endpoint.receive() == []
    endpoint.close()
    endpoint.close()
