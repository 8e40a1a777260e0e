"""Endpoints on UDP sockets, and their URLs."""

import random
import socket

import pytest

from bridge.mavlink.endpoint import Direction, Endpoint, dialect, parse_url
from tests.unit.mavlink.codec.frames_of_messages import frames_of, position


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
