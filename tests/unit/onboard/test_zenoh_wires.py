"""The onboard process on Zenoh: which session a target is on, what is said, what is refused."""

import subprocess
import sys
from pathlib import Path

import pytest

from bridge.ros2.ros2_names import Ros2Network
from bridge.target.ros2_target import TargetSpec, TargetType
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_alarm import PATIENCE_S
from flightstack.config.files import load
from flightstack.onboard.zenoh_wires import ZenohPlan, ZenohWires
from tests.unit.target import ros2_helpers as ros
from tests.unit.target.ros2_helpers import until

ROOT = Path(__file__).parents[3]
CONFIG = load("crazyflie")
STAMP = 1_700_000_000_000_000_000


@pytest.fixture
def wires():
    opened = []

    def open_wires(target="cf1/target/odom", kind=TargetType.ODOMETRY, **plan):
        opened.append(ZenohWires(CONFIG, ZenohPlan(TargetSpec.parse(target, kind), **plan)))
        return opened[-1]

    yield open_wires
    for one in opened:
        one.close()


def test_a_target_of_ros_is_on_the_network_of_ros(wires):
    with ros.network() as (endpoint, ours, _):
        ours_ = wires("ros2:/odom", ros2=Ros2Network(endpoint))
        put = zenoh_link.dropping_publisher(
            ours, "0/odom/nav_msgs::msg::dds_::Odometry_/TypeHashNotSupported"
        )
        until(lambda: zenoh_link.is_matched(put), "the subscription")
        put.put(ros.odometry(STAMP, "odom", "base_footprint"))
        samples = []
        until(lambda: samples.extend(ours_.odometry.poll()) or samples, "the sample")
        [text, other] = ours_.texts(0.0)
        assert "frame_id is 'odom', checks.target_frame is 'map'" in text
        assert "checks.target_child_frame is 'target'" in other
        assert zenoh_link.transports(ours_.session) == 0  # what is flown by has nothing to do with it


def test_without_one_it_is_on_the_flight_s_own_session(wires):
    with ros.network() as (endpoint, ours, _):
        plain = wires("ros2dds:/odom", connect=[endpoint])
        put = zenoh_link.dropping_publisher(ours, "odom")
        until(lambda: zenoh_link.is_matched(put), "the subscription")
        [text] = plain.texts(0.0)
        assert "is a router, and we are its peer" in text
        payload = ros.odometry(STAMP, "map", "target")
        put.put(payload)
        samples = until(plain.odometry.poll, "the sample")
        assert [one.payload for one in samples] == [payload]


def test_a_robot_that_is_not_there_is_told_in_real_time_alone(wires):
    for lockstep in (False, True):
        dialling = wires(connect=[ros.free_endpoint()], lockstep=lockstep)
        assert dialling.texts(0.0) == []
        texts = dialling.texts(PATIENCE_S + 1.0)
        assert [("no connection to" in text) for text in texts] == ([] if lockstep else [True])


def test_a_door_to_the_network_without_rules_is_told_once(wires):
    port = ros.free_endpoint().rsplit(":", 1)[1]
    open_door = wires(listen=[f"tcp/0.0.0.0:{port}"])
    [text] = open_door.texts(0.0)
    assert f"listens on tcp/0.0.0.0:{port} without rules" in text
    assert open_door.texts(0.01) == []
    assert wires().texts(0.0) == []


@pytest.mark.parametrize(
    ("target", "kind"), [("ros2:/odom", TargetType.ODOMETRY), ("cf1/target/pose", TargetType.POSE)]
)
def test_lockstep_is_with_the_simulated_target(wires, target, kind):
    with pytest.raises(ValueError, match="in lockstep"):
        wires(target, kind, lockstep=True)


def run(*words):
    return subprocess.run(
        [sys.executable, "-m", "flightstack.cli.main", *words],
        cwd=ROOT, capture_output=True, text=True, timeout=120.0, check=False,
    )  # fmt: skip


ONBOARD = ("onboard", "--vehicle", "udpout:127.0.0.1:9", "--config", "crazyflie")
CLIENT = ("--zenoh-config", "docs/how_to/zenoh/client.json5")


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ((*ONBOARD, "--target", "ros2:odom"), 2, "for example /odom"),
        ((*ONBOARD, "--target", "ros2:/1/odom"), 2, "not by a digit"),
        ((*ONBOARD, "--target", "a//b"), 2, "cf1/target/odom"),
        ((*ONBOARD, "--target", "ros2:/odom", "--lockstep"), 2, "in lockstep"),
        ((*ONBOARD, "--target-type", "twist"), 2, "pose-covariance"),
        ((*ONBOARD, "--ros-domain", "300"), 2, "0<=x<=232"),
        ((*ONBOARD, "--ros2", "localhost"), 2, "tcp/127.0.0.1:7447"),
        ((*ONBOARD, "--zenoh-config", "pyproject.toml"), 2, "Zenoh configuration pyproject.toml"),
        ((*ONBOARD, *CLIENT, "--listen", "tcp/127.0.0.1:0"), 2, "cannot listen"),
        (("target", "--scenario", "straight", "--namespace", "1", "--ros2", "{router}"), 2, "not by a digit"),
        (("watch", "--once", "--zenoh-config", "no.json5"), 2, "does not exist"),
    ],
)  # fmt: skip
def test_wrong_words_are_refused_with_what_is_allowed(words, status, said):
    with ros.network(0) as (endpoint, _):
        done = run(*(word.replace("{router}", endpoint) for word in words))
    assert (done.returncode, "Traceback" in done.stderr) == (status, False), done.stderr
    assert said in done.stderr


def test_a_router_of_ros_that_is_not_there_is_said_before_the_flight():
    done = run(*ONBOARD, "--ros2", ros.free_endpoint())
    assert done.returncode == 2
    assert "is the router there" in done.stderr
