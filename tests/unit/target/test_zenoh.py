"""Tests odometry over Zenoh, sessions, and the search for a target's key."""

import contextlib
import json
import time
from pathlib import Path

import pytest

from bridge.target.odometry import OdometryPublisher, RawSample, raw_sample, sample_of
from bridge.target.ros2_target import KeySearch
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import (
    LOOK_EVERY_S,
    PATIENCE_S,
    ConnectionAlarm,
    Role,
    ZenohLinkError,
    dialled,
    open_session,
)
from tests.processes.bounded import wait_for
from tests.processes.ports import free_endpoint

KEY = "cf1/target/odom"


@pytest.fixture
def sessions():
    endpoint = free_endpoint()
    listener = open_session([endpoint])
    dialler = open_session(connect=[endpoint])
    wait_for(lambda: zenoh_link.transports(listener) == 1)
    yield listener, dialler
    dialler.close()
    listener.close()


@pytest.mark.parametrize("lossless", [False, True])
def test_odometry_arrives_in_order_with_its_attachment(sessions, lossless):
    publisher = OdometryPublisher(sessions[0], KEY, "map", "target", lossless=lossless)
    assert publisher.matched is False
    declare = zenoh_link.fifo_subscriber if lossless else zenoh_link.ring_subscriber
    subscriber = declare(sessions[1], KEY)
    wait_for(lambda: publisher.matched)
    payloads, received = [], []

    def count():
        received.extend(map(raw_sample, zenoh_link.drain(subscriber)))
        return len(received)

    for i in range(100):
        payload = publisher.encode(
            i, (float(i), 0.0, 0.2), (1.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)
        )
        publisher.put(payload, source_time_ns=1000 + i)
        payloads.append(payload)
        if not lossless:  # on a busy machine some of the hundred messages may be lost
            wait_for(lambda: count() == len(payloads))
    wait_for(lambda: count() == 100)
    assert [raw.payload for raw in received] == payloads
    assert [(raw.sequence, raw.source_time_ns) for raw in received] == [(i + 1, 1000 + i) for i in range(100)]
    assert sample_of(RawSample(received[7].payload), 0.0).position_enu_m == (7.0, 0.0, 0.2)
    subscriber.undeclare()


def listening_addresses():
    """Return the local TCP addresses on which this process listens, in the kernel's format."""
    own = set()
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the descriptor of the listing itself is closed by now
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
        assert set(listening_addresses()) == {"0100007F"}  # the only address is 127.0.0.1
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


LIKELY = {
    "robot1/odom": "robot1/odom",
    "robot/odometry/filtered": "robot/odometry/filtered",
    "arena/pose": "arena/pose",
    "3/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported": (
        "ros2:/odom (nav_msgs/msg/Odometry, domain 3)"
    ),
}
OTHERS = ("cf1/controller/step", "camera/image")


def until_found(search, publishers, count):
    deadline_s = time.monotonic() + 10.0
    while len(search.keys()) < count:
        assert time.monotonic() < deadline_s, search.keys()
        for publisher in publishers:
            publisher.put(b"x")
        time.sleep(0.01)
    return search.keys()


def test_likely_keys_are_found_and_others_are_not(sessions):
    there, here = sessions
    search = KeySearch(here)
    assert search.keys() == ()
    publishers = [zenoh_link.dropping_publisher(there, key) for key in (*OTHERS, *LIKELY)]
    own = zenoh_link.dropping_publisher(here, "cf1/own/odom")
    assert set(until_found(search, [*publishers, own], len(LIKELY))) == set(LIKELY.values())
    search.stop()
    assert not any(zenoh_link.is_matched(one) for one in publishers[: len(OTHERS)])
    assert search.keys() == ()  # a new search has found no key yet


def setting(file, key, **arguments):
    """Return a setting of the session from a configuration file."""
    role = arguments.pop("role", Role.PEER)
    config = zenoh_link._configuration(arguments.get("listen", ()), arguments.get("connect", ()), file, role)
    return json.loads(config.get_json(key))


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "zenoh.json5"
        path.write_text(text)
        return path

    return write


def test_what_a_file_sets_is_kept_and_the_rest_is_ours(file):
    path = file(
        '{mode: "peer", scouting: {multicast: {enabled: true}}, listen: {endpoints: ["tcp/127.0.0.1:1234"]}}'
    )
    assert setting(path, "scouting/multicast/enabled") is True
    assert setting(path, "listen/endpoints") == ["tcp/127.0.0.1:1234"]
    assert setting(path, "scouting/gossip/enabled") is False
    assert setting(path, "connect/retry")["period_max_ms"] == 500
    assert setting(path, "listen/endpoints", listen=["tcp/127.0.0.1:5"]) == ["tcp/127.0.0.1:5"]


def test_who_is_dialled_and_as_what(file):
    path = file('{mode: "client", connect: {endpoints: ["tcp/robot:7447"]}}')
    assert dialled(config_file=path) == (Role.CLIENT, ["tcp/robot:7447"])
    assert dialled(["tcp/other:1"], config_file=path) == (Role.CLIENT, ["tcp/other:1"])
    assert dialled() == (Role.PEER, [])
    path = file('{connect: {endpoints: {peer: ["tcp/a:1"], router: ["tcp/b:2"]}}}')
    assert dialled(config_file=path) == (Role.PEER, ["tcp/a:1"])
    assert dialled(config_file=path, role=Role.ROUTER) == (Role.ROUTER, ["tcp/b:2"])


@pytest.mark.parametrize(
    "text", ['{moode: "peer"}', "{", '{mode: "boss"}', '{transport: {link: {tx: {lease: "x"}}}}']
)
def test_a_file_that_is_wrong_is_named(file, text):
    path = file(text)
    with pytest.raises(ValueError, match=r"Zenoh configuration .*zenoh\.json5"):
        open_session(config_file=path)


def test_a_client_without_a_router_is_told_so(file):
    path = file("{connect: {timeout_ms: 200}}")
    with pytest.raises(ZenohLinkError, match="is the router running"):
        open_session(connect=[free_endpoint()], config_file=path, role=Role.CLIENT)


def test_a_connection_that_is_not_there_lost_and_back_is_told_once_each():
    endpoint = free_endpoint()
    session = open_session(connect=[endpoint])
    alarm = ConnectionAlarm(session, [endpoint])
    try:
        assert alarm.poll(0.0) == []
        assert alarm.poll(PATIENCE_S - 0.1) == []
        [text] = alarm.poll(PATIENCE_S + LOOK_EVERY_S)
        assert f"no connection to {endpoint} for 4 s" in text
        assert "certificate or password" in text
        assert alarm.poll(100.0) == []
        other = open_session([endpoint])
        wait_for(lambda: zenoh_link.transports(session) == 1, "the connection")
        [text] = alarm.poll(200.0)
        assert f"connected to {endpoint} after 200 s" in text
        assert alarm.poll(202.0) == []
        other.close()
        wait_for(lambda: zenoh_link.transports(session) == 0, "the end")
        assert alarm.poll(204.0) == []
        assert "no connection" in alarm.poll(208.0)[0]
    finally:
        session.close()


@pytest.mark.parametrize("key", ["", "/a", "a//b", "a#b"])
def test_bad_key_is_a_clear_error(key):
    session = open_session()
    try:
        with pytest.raises(ValueError, match="cf1/target/odom"):
            zenoh_link.ring_subscriber(session, key)
        with pytest.raises(ValueError, match="cf1/target/odom"):
            OdometryPublisher(session, key)
    finally:
        session.close()
