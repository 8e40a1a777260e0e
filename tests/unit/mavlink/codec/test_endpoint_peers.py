"""Who an endpoint answers, how much, and on which addresses it listens at all."""

import socket

import pytest

from bridge.mavlink.endpoint import Endpoint, dialect, parse_peer
from bridge.mavlink.signing.key import SigningKey

KEY = SigningKey(bytes(range(32)))


def heartbeat():
    return dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


def position():
    return dialect.MAVLink_local_position_ned_message(10, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


class Caller:
    """A plain socket that speaks unsigned MAVLink."""

    def __init__(self, server, ids=(1, 191)):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5.0)
        self.mav = dialect.MAVLink(None, *ids)
        self.server = server
        self.address = self.socket.getsockname()
        self.sent = 0

    def send(self, *messages):
        data = b"".join(message.pack(self.mav) for message in messages)
        self.sent += len(data)
        self.socket.sendto(data, ("127.0.0.1", self.server.local_port))
        assert self.server.wait(5.0)
        return self.server.receive()

    def waiting(self, at_least=0):
        """Bytes that have come and were not taken yet; so many are waited for."""
        size = 0
        while size < at_least:
            size += len(self.socket.recv(65536))
        self.socket.setblocking(False)
        try:
            while True:
                size += len(self.socket.recv(65536))
        except BlockingIOError:
            return size
        finally:
            self.socket.settimeout(5.0)


@pytest.fixture
def server():
    endpoint = Endpoint("udpin:127.0.0.1:0", 1, 1, max_peers=2)
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
    server.send([position()])  # nobody known: nothing is sent, no number is used
    caller = call()
    caller.send(position())
    assert server.peers == ()
    server.send([position()])
    caller.send(heartbeat())
    assert server.peers == (caller.address,)
    server.send([position()])
    frame = caller.socket.recv(2048)
    assert frame[4] == 0


def test_garbage_makes_no_entry(server):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"\xfdhello", ("127.0.0.1", server.local_port))
        assert server.wait(5.0)
        assert server.receive() == []
    assert server._peers.remembered == 0
    assert server.counters.garbage_bytes == 6


def test_sender_without_heartbeat_gets_no_more_bytes_than_it_sent(server, call):
    caller = call()
    received = 0
    for _ in range(5):
        (request,) = caller.send(dialect.MAVLink_param_request_list_message(1, 1))
        server.send([position()] * 80, request.peer)
        received += caller.waiting()
        assert received <= caller.sent
    assert server.counters.withheld > 300
    ack = dialect.MAVLink_command_ack_message(400, 0, 0, 0, 1, 191)
    (command,) = caller.send(dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, *[float("nan")] * 6))
    server.send([ack], command.peer)
    assert caller.waiting(21) > 20  # the answer to a single command fits
    caller.send(heartbeat())
    server.send([position()] * 80, caller.address)
    assert caller.waiting(80 * 30 + 1) > 80 * 30


def test_repeats_count_against_the_allowance_too(server, call):
    caller = call()
    (received,) = caller.send(position())
    for _ in range(10):
        server.repeat(received.raw, caller.address)
    assert caller.waiting(caller.sent) == caller.sent
    assert server.counters.withheld == 9


def test_nobody_unheard_is_answered(server, call):
    server.send([position()], call().address)
    assert (server.counters.sent, server.counters.withheld) == (0, 1)


def test_withheld_answers_use_no_numbers(server, call):
    caller = call()
    (request,) = caller.send(dialect.MAVLink_param_request_list_message(1, 1))
    server.send([position()] * 3, request.peer)
    caller.send(heartbeat())
    server.send([position()])
    assert caller.socket.recv(2048)[4] == 0


def test_tables_are_bounded_and_expire(server, call, monkeypatch):
    now = 100.0
    monkeypatch.setattr("bridge.mavlink.transport.address.time.monotonic", lambda: now)
    callers = [call() for _ in range(30)]
    for caller in callers:
        caller.send(position())
    assert server._peers.remembered == 16
    for caller in callers[:3]:
        caller.send(heartbeat())
    assert server.peers == (callers[0].address, callers[1].address)
    assert server.counters.peers_refused == 1
    assert server._peers.remembered <= 18
    now = 111.0  # all silent for longer than 10 s
    assert server.peers == ()
    server.send([position()] * 60, callers[0].address)  # who wants to speak to one of them still can
    assert callers[0].waiting(60 * 30 + 1) > 60 * 30
    callers[2].send(heartbeat())
    assert server.peers == (callers[2].address,)


def test_strangers_cannot_keep_a_peer_out(server, call):
    for _ in range(40):
        call().send(position())
    caller = call()
    caller.send(heartbeat())
    assert server.peers == (caller.address,)


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
    assert "anybody on the network can command" in unsigned.warnings[0]
    unsigned.close()
    with pytest.raises(ValueError, match="exclude each other"):
        Endpoint("udpin:0.0.0.0:0", 1, 1, signing_key=KEY, allow_unsigned=True)


def test_all_of_loopback_needs_no_key():
    for url in ("udpin:127.0.0.1:0", "udpin:127.9.9.9:0", "udpin:localhost:0"):
        endpoint = Endpoint(url, 1, 1)
        assert endpoint.warnings == ()
        endpoint.close()


def test_peers_that_cannot_be_served_are_refused():
    with pytest.raises(ValueError, match="listens on loopback only"):
        Endpoint("udpin:127.0.0.1:0", 1, 1, always=[("192.0.2.1", 14550)])
    with pytest.raises(ValueError, match="use udpin"):
        Endpoint("udpout:127.0.0.1:14550", 1, 1, always=[("127.0.0.1", 14540)])


def test_caller_hears_only_whom_it_calls(server):
    client = Endpoint(f"udpout:127.0.0.1:{server.local_port}", 1, 191)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(position().pack(dialect.MAVLink(None, 1, 1)), ("127.0.0.1", client.local_port))
    client.send([heartbeat()])
    assert server.wait(5.0)
    server.receive()
    server.send([position()])
    assert client.wait(5.0)
    assert [r.peer for r in client.receive()] == [("127.0.0.1", server.local_port)]
    client.close()
