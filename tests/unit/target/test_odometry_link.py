import contextlib
import select
import socket
import time
from pathlib import Path

import pytest

from bridge.target.odometry import OdometryPublisher, OdometrySubscriber, RawSample, sample_from_cdr
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import ZenohLinkError, check_endpoint, open_session

KEY = "cf1/target/odom"


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def until(condition, timeout_s=10.0):
    """Poll a condition of another thread or process, with a pause that gives it the processor."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        select.select((), (), (), 0.002)


@pytest.fixture
def sessions():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listener = open_session([endpoint])
    dialler = open_session(connect=[endpoint])
    until(lambda: zenoh_link.transports(listener) == 1)
    yield listener, dialler
    dialler.close()
    listener.close()


@pytest.mark.parametrize("lossless", [False, True])
def test_odometry_arrives_in_order_with_its_attachment(sessions, lossless):
    publisher = OdometryPublisher(sessions[0], KEY, "map", "target", lossless=lossless)
    assert publisher.matched is False
    subscriber = OdometrySubscriber(sessions[1], KEY, lossless=lossless)
    until(lambda: publisher.matched)
    payloads, received = [], []
    for i in range(100):
        payload = publisher.encode(
            i, (float(i), 0.0, 0.2), (1.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)
        )
        publisher.put(payload, source_time_ns=1000 + i)
        payloads.append(payload)
        if not lossless:  # a hundred at once may be too many for a busy machine, and then some are dropped
            until(lambda: received.extend(subscriber.poll()) or len(received) == len(payloads))
    until(lambda: received.extend(subscriber.poll()) or len(received) == 100)
    assert [raw.payload for raw in received] == payloads
    assert [(raw.sequence, raw.source_time_ns) for raw in received] == [(i + 1, 1000 + i) for i in range(100)]
    assert {len(raw.attachment) for raw in received} == {33}
    assert sample_from_cdr(received[7].payload, 0.0).position_enu_m == (7.0, 0.0, 0.2)
    subscriber.close()
    publisher.close()


def test_own_attachment_and_no_attachment(sessions):
    publisher = OdometryPublisher(sessions[0], KEY)
    plain = zenoh_link.blocking_publisher(sessions[0], KEY, "application/cdr")
    subscriber = OdometrySubscriber(sessions[1], KEY)
    until(lambda: publisher.matched and zenoh_link.is_matched(plain))
    publisher.put(b"one", 5, attachment=b"0123456789abcdef")
    plain.put(b"two")
    received = []
    until(lambda: received.extend(subscriber.poll()) or len(received) == 2)
    assert received == [RawSample(b"one", b"0123456789abcdef"), RawSample(b"two")]


def test_ring_drops_the_oldest_within_one_session():
    session = open_session()
    try:
        ring = zenoh_link.ring_subscriber(session, "t/ring", capacity=3)
        publisher = zenoh_link.dropping_publisher(session, "t/ring")
        for i in range(10):  # delivered in this thread, since it is the same session
            publisher.put(bytes([i]))
        assert [sample.payload.to_bytes()[0] for sample in zenoh_link.drain(ring)] == [7, 8, 9]
    finally:
        session.close()


def test_late_listener_is_found_by_retry():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    started = time.monotonic()
    dialler = open_session(connect=[endpoint])
    assert time.monotonic() - started < 0.4  # no wait for the peer that is not there
    assert zenoh_link.transports(dialler) == 0
    listener = open_session([endpoint])
    try:
        until(lambda: zenoh_link.transports(dialler) == 1)
    finally:
        dialler.close()
        listener.close()


def listening_addresses():
    """Local addresses, as the kernel writes them, on which this process listens for TCP."""
    own = set()
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the descriptor of this very listing is gone by now
            own.add(str(link.readlink()))
    rows = [
        row.split() for name in ("tcp", "tcp6") for row in Path("/proc/net", name).read_text().splitlines()
    ]
    return [row[1].partition(":")[0] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in own]


def test_default_session_listens_on_loopback_only():
    before = listening_addresses()
    session = open_session()
    try:
        assert len(listening_addresses()) == len(before) + 1
        assert set(listening_addresses()) == {"0100007F"}  # 127.0.0.1
    finally:
        session.close()


@pytest.mark.parametrize(
    "endpoint",
    [
        "",
        "127.0.0.1:7447",
        "tcp/127.0.0.1",
        "tcp/127.0.0.1:99999",
        "tcp://127.0.0.1:7447",
        "foo/1.2.3.4:5",
        "tcp/a b:1",
    ],
)
def test_malformed_endpoint_is_refused_both_ways(endpoint):
    for arguments in ({"listen": [endpoint]}, {"connect": [endpoint]}):
        with pytest.raises(ValueError, match=r"tcp/127\.0\.0\.1:7447"):
            open_session(**arguments)


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/127.0.0.1:7447",
        "tcp/[::1]:7447",
        "udp/robot.local:1",
        "tls/a.b:7447",
        "unixsock-stream//tmp/z.sock",
    ],
)
def test_good_endpoints_pass(endpoint):
    assert check_endpoint(endpoint) == endpoint


def test_port_in_use_is_a_clear_error():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    session = open_session([endpoint])
    try:
        with pytest.raises(ZenohLinkError, match=f"{endpoint}.*taken"):
            open_session([endpoint])
    finally:
        session.close()


@pytest.mark.parametrize("key", ["", "/a", "a//b", "a#b"])
def test_bad_key_is_a_clear_error(key):
    session = open_session()
    try:
        with pytest.raises(ValueError, match="cf1/target/odom"):
            OdometrySubscriber(session, key)
        with pytest.raises(ValueError, match="cf1/target/odom"):
            OdometryPublisher(session, key)
    finally:
        session.close()
