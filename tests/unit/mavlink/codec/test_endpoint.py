"""Tests endpoints on UDP sockets: URLs, peers that receive messages, limits, and local addresses."""

import socket

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.transport.address import parse_peer, parse_url
from tests.unit.mavlink.codec.frames_of_messages import Caller, frames_of, position
from tests.unit.mavlink.signing.signing_helpers import KEY, heartbeat


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


def test_too_much_for_one_datagram_is_split_in_order(pair):
    server, client = pair
    texts = [dialect.MAVLink_statustext_message(6, f"{i:050d}".encode(), 0, 0) for i in range(60)]
    client.send(texts)
    assert [int(r.message.text) for r in take(server, 60)] == list(range(60))


def test_full_datagrams_do_not_keep_the_loop(pair):
    """One call reads only a part of 50 datagrams with 90 frames each; later calls read all other frames."""
    server, _ = pair
    frames = [position().pack(dialect.MAVLink(None, 1, 191))] * 90
    datagram = b"".join(frames)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flood:
        for _ in range(50):
            flood.sendto(datagram, ("127.0.0.1", server.local_port))
    assert server.wait(5.0)
    first = len(server.receive())
    assert 0 < first < 50 * 90
    while server.counters["received"] < 50 * 90:
        assert server.wait(5.0)
        server.receive()
    assert server.counters["received"] == 50 * 90


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr("bridge.mavlink.transport.address.PEERS_MAX", 2)
    endpoint = Endpoint("udpin:127.0.0.1:0", 1, 1)
    yield endpoint
    endpoint.close()


@pytest.fixture
def call(server):
    callers = []

    def make(*arguments):
        callers.append(Caller(server, *arguments))
        return callers[-1]

    yield make
    for caller in callers:
        caller.socket.close()


def test_heartbeat_makes_a_peer_and_numbers_begin_with_it(server, call):
    server.send([position()])  # without a known peer nothing is sent, and no sequence number is used
    caller = call()
    caller.send(position())
    assert server.peers == ()
    server.send([position()])
    caller.send(heartbeat())
    assert server.peers == (caller.address,)
    server.send([position()])
    frame = caller.socket.recv(2048)
    assert frame[4] == 0


def test_the_table_is_bounded_and_peers_expire(server, call, monkeypatch):
    now = 100.0
    monkeypatch.setattr("bridge.mavlink.transport.address.time.monotonic", lambda: now)
    callers = [call() for _ in range(4)]
    for caller in callers[:3]:
        caller.send(heartbeat())
    assert server.peers == (callers[0].address, callers[1].address)
    assert server.counters["peers_refused"] == 1
    callers[3].send(position())
    server.send([position()], callers[3].address)  # a peer without a heartbeat gets replies only
    assert callers[3].socket.recv(2048)
    now = 111.0  # all peers have been silent for more than 10 s
    assert server.peers == ()
    server.send([position()], callers[0].address)  # an explicit receiver
    assert callers[0].socket.recv(2048)
    callers[2].send(heartbeat())
    assert server.peers == (callers[2].address,)


def test_configured_peers_get_telemetry_before_they_speak():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5.0)
        peer = parse_peer(f"127.0.0.1:{listener.getsockname()[1]}")
        server = Endpoint("udpin:127.0.0.1:0", 1, 1, always=[peer, peer])
        server.send([heartbeat()])
        assert listener.recv(2048)[7:10] == bytes(3)
        assert server.peers == (peer,)
        server.close()


@pytest.mark.parametrize("text", ["", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:70000", "a b:1", "::1:5"])
def test_bad_peer_says_what_is_allowed(text):
    with pytest.raises(ValueError, match="allowed is HOST:PORT"):
        parse_peer(text)


@pytest.mark.parametrize("url", ["udpin:0.0.0.0:0", "udpin:192.0.2.1:14550"])
def test_network_without_a_key_is_refused(url):
    with pytest.raises(ValueError, match="--signing-key FILE"):
        Endpoint(url, 1, 1)


def test_network_with_a_key_or_on_purpose_without():
    signed = Endpoint("udpin:0.0.0.0:0", 1, 1, signing_key=KEY)
    assert signed.warnings == ()
    signed.close()
    unsigned = Endpoint("udpin:0.0.0.0:0", 1, 1, allow_unsigned=True)
    assert "any host on the network can command" in unsigned.warnings[0]
    unsigned.close()
    with pytest.raises(ValueError, match="exclude each other"):
        Endpoint("udpin:0.0.0.0:0", 1, 1, signing_key=KEY, allow_unsigned=True)


def test_peers_that_cannot_be_served_are_refused():
    with pytest.raises(ValueError, match="listens on loopback only"):
        Endpoint("udpin:127.0.0.1:0", 1, 1, always=[("192.0.2.1", 14550)])
    with pytest.raises(ValueError, match="use udpin"):
        Endpoint("udpout:127.0.0.1:14550", 1, 1, always=[("127.0.0.1", 14540)])


def test_datagram_beyond_every_network_is_not_looked_at(pair):
    server, client = pair
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"".join(frames_of(200)), ("127.0.0.1", server.local_port))
    client.send([position(7.0)])
    assert take(server, 1)[0].message.x == 7.0
    assert server.counters["oversize"] == 1
