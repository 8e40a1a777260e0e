"""Sessions from configuration files, roles, and the word when nobody is at the other end."""

import json

import pytest

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
from tests.unit.target.ros2_helpers import free_endpoint, until


def setting(file, key, **arguments):
    """A setting of the session that a file would make."""
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


def test_without_a_file_nobody_is_looked_for_and_loopback_alone_is_listened_on():
    for role, listens in (
        (Role.PEER, ["tcp/127.0.0.1:0"]), (Role.CLIENT, []), (Role.ROUTER, ["tcp/127.0.0.1:7447"]),
    ):  # fmt: skip
        assert setting(None, "mode", role=role) == role.value
        assert setting(None, "listen/endpoints", role=role) == listens
        assert setting(None, "scouting/multicast/enabled", role=role) is False
    assert setting(None, "scouting/gossip/enabled") is False


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


def test_a_client_cannot_listen(file):
    path = file('{mode: "client"}')
    with pytest.raises(ValueError, match="cannot listen"):
        open_session(["tcp/127.0.0.1:0"], config_file=path)


def test_a_client_without_a_router_is_told_so(file):
    path = file("{connect: {timeout_ms: 200}}")
    with pytest.raises(ZenohLinkError, match="is the router there"):
        open_session(connect=[free_endpoint()], config_file=path, role=Role.CLIENT)


def test_a_router_passes_on_but_not_from_peer_to_peer():
    endpoint = free_endpoint()
    sessions = {"router": open_session([endpoint], role=Role.ROUTER)}
    for name in ("client", "other client"):
        sessions[name] = open_session(connect=[endpoint], role=Role.CLIENT)
    for name in ("peer", "other peer"):
        sessions[name] = open_session(connect=[endpoint])
    try:
        until(lambda: zenoh_link.transports(sessions["router"]) == 4, "all")
        heard = {name: zenoh_link.ring_subscriber(session, "a/*") for name, session in sessions.items()}
        puts = {
            key: zenoh_link.dropping_publisher(sessions[name], f"a/{key}")
            for key, name in (("from_peer", "peer"), ("from_client", "client"))
        }
        got = {name: set() for name in sessions}

        def all_there():
            for key, put in puts.items():  # the peer's before the client's, which arrives everywhere
                put.put(key)
            for name, subscriber in heard.items():
                got[name] |= {str(sample.key_expr) for sample in zenoh_link.drain(subscriber)}
            return all("a/from_client" in keys for keys in got.values())

        until(all_there, "the client's")
        until(lambda: all_there() and "a/from_peer" in got["other client"], "the peer's at a client")
        assert got["other peer"] == {"a/from_client"}
        alarm = ConnectionAlarm(sessions["peer"], [endpoint])
        [text] = alarm.poll(0.0)
        assert "is a router, and we are its peer" in text
        assert alarm.poll(10.0) == []
        assert ConnectionAlarm(sessions["client"], [endpoint], Role.CLIENT).poll(0.0) == []
    finally:
        for session in reversed(sessions.values()):
            session.close()


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
        until(lambda: zenoh_link.transports(session) == 1, "the connection")
        [text] = alarm.poll(200.0)
        assert f"connected to {endpoint} after 200 s" in text
        assert alarm.poll(202.0) == []
        other.close()
        until(lambda: zenoh_link.transports(session) == 0, "the end")
        assert alarm.poll(204.0) == []
        assert "no connection" in alarm.poll(208.0)[0]
    finally:
        session.close()


def test_who_dials_nobody_is_not_alone():
    session = open_session()
    try:
        assert [ConnectionAlarm(session, []).poll(float(t)) for t in range(0, 100, 10)] == [[]] * 10
    finally:
        session.close()
