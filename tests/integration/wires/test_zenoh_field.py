"""Tests the configurations of docs/how_to/zenoh.md: certificates, passwords, access rules, router loss."""

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from bridge.ros2.ros2_names import parse_topic_key
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import Role, ZenohLinkError
from logs.reader.reader import LogFile
from tests.integration.runs import WALL_MAX_S, flightstack
from tests.integration.sim_processes import verb
from tests.processes.bounded import AT_ONCE_S, PATIENCE_S, killed, wait_for
from tests.processes.ports import free_endpoint, free_port
from tests.unit.target.ros2_helpers import rmw_session

ROOT = Path(__file__).parents[3]
FILES = ROOT / "docs" / "how_to" / "zenoh"
USERS = {"robot": "change me", "companion": "to land", "watcher": "to see"}
TARGET, STEP = "cf1/target/odom", "cf1/controller/step"
BACK_MAX_S = 0.5  # time-out after the router's return, s, from docs/how_to/zenoh.md


def recipe():
    """Return the page's commands that make certificates."""
    page = (ROOT / "docs" / "how_to" / "zenoh.md").read_text()
    return re.search(r"^```bash\n(mkdir.*?)^```", page, re.MULTILINE | re.DOTALL)[1]


def make_keys(folder):
    subprocess.run(["bash", "-e", "-c", recipe()], cwd=folder, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Return a folder with keys of one certificate authority, and a stranger's key of another authority."""
    folder = make_keys(tmp_path_factory.mktemp("zenoh"))
    stranger = make_keys(tmp_path_factory.mktemp("stranger"))
    for end in ("key", "pem"):
        (folder / f"keys/stranger.{end}").write_bytes((stranger / f"keys/robot.{end}").read_bytes())
    (folder / "keys/users").write_text("".join(f"{name}:{word}\n" for name, word in USERS.items()))
    return folder


@pytest.fixture
def at_home(home, monkeypatch):
    monkeypatch.chdir(home)
    return home


def client_file(kind, name, secret=None):
    """Write the page's configuration of this client with a time-out of 1 s; return the file's path."""
    text = (FILES / f"client_{kind}.json5").read_text()
    text = text.replace("connect: {", "connect: { timeout_ms: 1000,", 1).replace("keys/me", f"keys/{name}")
    text = text.replace('"robot"', f'"{name}"').replace("change me", secret or USERS.get(name, ""))
    file = Path(f"{kind}_{name}.json5")
    file.write_text(text)
    return file


@contextmanager
def router(kind):
    """Run a router with the page's configuration; yield its endpoint."""
    port = free_port()
    session = zenoh_link.open_session(
        [f"tls/127.0.0.1:{port}"], config_file=FILES / f"router_{kind}.json5", role=Role.ROUTER
    )
    try:
        yield f"tls/localhost:{port}"
    finally:
        session.close()


questions = itertools.count()


def who_hears(sessions, sender, key):
    """Return the names of the clients that receive the sample which ``sender`` sends on this key."""
    asked, marks = (f"{word} {next(questions)}".encode() for word in ("asked", "mark"))
    publisher = zenoh_link.dropping_publisher(sessions[sender], key)
    mark = zenoh_link.dropping_publisher(sessions["robot"], TARGET)
    heard = {name: zenoh_link.ring_subscriber(session, "cf1/**") for name, session in sessions.items()}
    others = [name for name in sessions if name not in (sender, "robot")]
    found, marked = set(), set()  # clients that received the tested sample, and the robot's sample

    def passed():
        # the wait ends when the others have the robot's permitted sample, sent after the tested sample
        publisher.put(asked)
        mark.put(marks)
        for name, subscriber in heard.items():
            for sample in zenoh_link.drain(subscriber):
                payload = sample.payload.to_bytes()
                found.update({name} if payload == asked and name != sender else set())
                marked.update({name} if payload == marks else set())
        return marked.issuperset(others)

    wait_for(passed, "what the robot sends")
    for _ in range(20):  # the path of the tested sample may be slower
        passed()
        time.sleep(0.005)
    for one in (publisher, mark, *heard.values()):
        one.undeclare()
    return found


@pytest.mark.parametrize("kind", ["tls", "password"])
def test_each_may_do_what_is_his_and_nothing_else(at_home, kind):
    with router(kind) as endpoint, ExitStack() as stack:
        sessions = {}
        for name in USERS:
            session = zenoh_link.open_session(connect=[endpoint], config_file=client_file(kind, name))
            stack.callback(session.close)
            sessions[name] = session
        assert who_hears(sessions, "robot", TARGET) == {"companion", "watcher"}
        assert who_hears(sessions, "companion", STEP) == {"watcher"}
        assert who_hears(sessions, "companion", "cf1/health") == {"watcher"}
        assert who_hears(sessions, "robot", STEP) == set()
        assert who_hears(sessions, "robot", "cf1/target/pose") == set()
        assert who_hears(sessions, "companion", TARGET) == set()
        assert who_hears(sessions, "watcher", TARGET) == set()
        assert who_hears(sessions, "watcher", STEP) == set()
        assert who_hears(sessions, "watcher", "cf1/health") == set()


@pytest.mark.parametrize(
    ("kind", "name", "secret"),
    [
        ("tls", "stranger", None),  # certificate of another authority, for the name robot
        ("password", "robot", "wrong"),
        ("password", "mallory", "change me"),
    ],
)
def test_who_is_not_known_does_not_get_in(at_home, kind, name, secret):
    with router(kind) as endpoint:
        with pytest.raises(ZenohLinkError, match="does it accept us"):
            zenoh_link.open_session(connect=[endpoint], config_file=client_file(kind, name, secret))
        known = zenoh_link.open_session(connect=[endpoint], config_file=client_file(kind, "robot"))
        known.close()  # a client with a valid certificate is admitted


def test_without_a_certificate_nobody_gets_in(at_home):
    file = Path("bare.json5")
    file.write_text(
        '{connect: {timeout_ms: 1000}, transport: {link: {tls: {root_ca_certificate: "keys/ca.pem"}}}}'
    )
    with router("tls") as endpoint:
        for one in (endpoint, endpoint.replace("tls/", "tcp/")):
            with pytest.raises(ZenohLinkError):
                zenoh_link.open_session(connect=[one], config_file=file, role=Role.CLIENT)


def test_a_router_under_another_name_is_not_believed(at_home):
    file = client_file("tls", "robot")
    with router("tls") as endpoint:
        address = endpoint.replace("localhost", "127.0.0.1")  # the certificate lacks this address
        with pytest.raises(ZenohLinkError):
            zenoh_link.open_session(connect=[address], config_file=file)


def test_peers_find_each_other(at_home):
    port = str(free_port(udp=True))  # the default port would find other Zenoh processes
    file = Path("peers.json5")
    file.write_text((FILES / "peers.json5").read_text().replace("7446", port))
    one = zenoh_link.open_session(config_file=file)
    two = zenoh_link.open_session(config_file=file)
    try:
        wait_for(lambda: zenoh_link.transports(two) == 1, "the other")
    finally:
        two.close()
        one.close()


def router_process(endpoint):
    return verb("router", "--listen", endpoint, "--zenoh-config", FILES / "router.json5")


@pytest.mark.xdist_group("real-time")
def test_a_router_that_is_killed_and_comes_back(at_home):
    endpoint = free_endpoint()
    file = FILES / "client.json5"
    with ExitStack() as stack:
        with router_process(endpoint) as (child, _):
            robot = zenoh_link.open_session(connect=[endpoint], config_file=file)
            stack.callback(robot.close)
            companion = zenoh_link.open_session(connect=[endpoint], config_file=file)
            stack.callback(companion.close)
            heard = zenoh_link.ring_subscriber(companion, TARGET)
            put = zenoh_link.dropping_publisher(robot, TARGET)

            def flows():
                put.put(b"x")
                return zenoh_link.drain(heard)

            wait_for(flows, "the first sample")
            child.kill()
            child.wait(PATIENCE_S)
            for session in (robot, companion):
                wait_for(lambda s=session: zenoh_link.transports(s) == 0, "the end of the connection")
            zenoh_link.drain(heard)  # samples in transit are discarded
        assert not flows()
        with router_process(endpoint) as (child, _):
            back_s = time.monotonic()
            wait_for(flows, "a sample after the router came back")
            assert time.monotonic() - back_s < BACK_MAX_S + AT_ONCE_S
            child.send_signal(signal.SIGTERM)
            assert child.wait(PATIENCE_S) == 0


@pytest.mark.parametrize("name", sorted(path.name for path in FILES.glob("*.json5")))
def test_every_configuration_of_the_page_is_understood(at_home, name):
    role, endpoints = zenoh_link.dialled(config_file=FILES / name)
    assert role is (Role.ROUTER if "router" in name else Role.CLIENT if "client" in name else Role.PEER)
    assert bool(endpoints) == (name.startswith(("client", "peer_")))
    assert f"zenoh/{name}" in (ROOT / "docs" / "how_to" / "zenoh.md").read_text()


def test_the_verb_router_wants_a_router_and_a_free_port(at_home):
    done = flightstack("router", "--zenoh-config", FILES / "client.json5")
    assert (done.code, 'mode "router" is needed' in done.err) == (2, True)
    endpoint = free_endpoint()
    session = zenoh_link.open_session([endpoint])
    done = flightstack("router", "--listen", endpoint)
    session.close()
    assert (done.code, "Traceback" in done.err) == (1, False)
    assert "is the port taken" in done.err


@pytest.mark.xdist_group("real-time")
def test_sitl_is_watched_by_certificate_and_seen_by_ros_2(at_home, tmp_path):
    """With the companion's access rules, processes on loopback fly, a client with a certificate can watch,
    and all other access is rejected."""
    listen, ros_router = free_endpoint().replace("tcp/", "tls/"), free_endpoint()
    dial = listen.replace("127.0.0.1", "localhost")
    with ExitStack() as stack:
        router = zenoh_link.open_session([ros_router], role=Role.ROUTER)
        stack.callback(router.close)
        node = rmw_session(ros_router)
        stack.callback(node.close)
        seen = zenoh_link.ring_subscriber(node, "0/cf1/**", 20_000)
        words = ["--scenario", "paper_static_1", "--filter", "paper", "--lockstep", "--no-report", "--json"]
        words += ["--zenoh-config", str(FILES / "companion_tls.json5"), "--listen", listen]
        words += ["--ros2", ros_router, "--out", str(tmp_path / "run")]
        sitl = subprocess.Popen(
            [sys.executable, "-m", "flightstack.cli.main", "sitl", *words],
            cwd=at_home, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True,
            stderr=subprocess.PIPE,
        )  # fmt: skip
        sessions, heard = {}, {}
        for name in ("watcher", "robot", "stranger"):
            file = client_file("tls", name)
            file.write_text(file.read_text().replace('"client"', '"peer"'))
            sessions[name] = zenoh_link.open_session(connect=[dial], config_file=file)
            stack.callback(sessions[name].close)
            heard[name] = zenoh_link.ring_subscriber(sessions[name], "cf1/**", 20_000)
        forged = zenoh_link.dropping_publisher(sessions["watcher"], TARGET)
        stack.callback(killed, sitl)
        until_s = time.monotonic() + WALL_MAX_S
        while sitl.poll() is None:
            assert time.monotonic() < until_s, "sitl did not end"
            forged.put(b"forged")
            time.sleep(0.01)
        said, errors = sitl.communicate(timeout=PATIENCE_S)
        assert sitl.returncode == 0, said + errors
        got = {
            name: {str(sample.key_expr) for sample in zenoh_link.drain(subscriber)} - {TARGET}
            for name, subscriber in heard.items()
        }
        topics = {parse_topic_key(str(sample.key_expr)).topic for sample in zenoh_link.drain(seen)}
    assert got == {"watcher": {STEP, "cf1/loop/timing", "cf1/health"}, "robot": set(), "stranger": set()}
    assert {"/cf1/target/odom", "/cf1/h", "/cf1/controller/step"} <= topics
    result = json.loads(said.strip().splitlines()[-1])
    assert result["outcome"] == "landed"
    refused = [one for one in LogFile(Path(result["log"])).messages() if one.topic == "/rosout"]
    assert not any(b"target sample refused" in one.data for one in refused)  # no forged sample arrived
