"""Tests a landing on a target from a ROS 2 topic, through a router, with a ROS 2 node as observer."""

import math
import re
import shlex
import signal
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from bridge.ros2.ros2_names import parse_topic_key
from bridge.zenoh import zenoh_link
from flightstack.core.types import Phase
from tests.integration.runs import WALL_MAX_S
from tests.processes.bounded import PATIENCE_S, killed, line_of, wait_for
from tests.unit.target.ros2_helpers import decode, on_free_ports, rmw_session

ROOT = Path(__file__).parents[3]


def commands():
    """Return the options of each command in docs/how_to/ros2.md, with free ports."""
    page = (ROOT / "docs" / "how_to" / "ros2.md").read_text()
    block = re.search(r"^```bash\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[1].replace("\\\n", " ")
    lines = on_free_ports(block).splitlines()
    return {shlex.split(line)[1]: shlex.split(line)[2:] for line in lines}


class Node:
    """Acts as a ROS 2 node: subscribes to all topics of domain 0, and decodes them with another library."""

    def __init__(self, endpoint):
        self.session = rmw_session(endpoint)
        self._heard = zenoh_link.ring_subscriber(self.session, "0/**", 4096)
        self.messages, self.sequences = defaultdict(list), defaultdict(list)
        self.types = {}

    def poll(self):
        for sample in zenoh_link.drain(self._heard):
            key = parse_topic_key(str(sample.key_expr))
            attachment = sample.attachment.to_bytes()
            assert len(attachment) == 33
            self.types[key.topic] = key.type_name
            self.sequences[key.topic].append(int.from_bytes(attachment[:8], "little"))
            self.messages[key.topic].append(decode(key.type_name, sample.payload.to_bytes()))

    def has_all_of_the_flight(self):
        """Whether the robot's newest message is as new as the vehicle's; a busy machine delays messages."""
        self.poll()
        own, target = self.messages["/cf1/odom"], self.messages["/cf1/target/odom"]
        return seconds(target[-1]) >= seconds(own[-1])

    def tokens(self):
        return [str(one.ok.key_expr) for one in self.session.liveliness().get("@ros2_lv/0/**", timeout=1.0)]


class Parts:
    """Starts the processes of the page in its order, and ends them."""

    def __init__(self, folder, stack):
        self._folder, self._stack, self._words = folder, stack, commands()
        assert list(self._words) == ["router", "target", "vehicle", "onboard"]
        onboard = self._words["onboard"]
        self.endpoint = onboard[onboard.index("--ros2") + 1]
        self._words["router"] += ["--listen", self.endpoint]
        self.running = {}

    def start(self, name):
        errors = self._stack.enter_context((self._folder / f"{name}.txt").open("w"))
        child = subprocess.Popen(
            [sys.executable, "-m", "flightstack.cli.main", name, *self._words[name]],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True,
        )  # fmt: skip
        self._stack.callback(end, child)
        self.running[name] = child
        if name in ("router", "vehicle"):
            self.line(name, "ready")

    def line(self, name, words):
        """Read the output of a process up to a line that contains these words."""
        child, deadline_s = self.running[name], time.monotonic() + WALL_MAX_S
        while time.monotonic() < deadline_s:
            line = line_of(child.stdout, WALL_MAX_S)
            assert line, f"{name} ended: {self.errors(name)}"
            if words in line:
                return
        pytest.fail(f"{name} did not say {words!r}")

    def errors(self, name):
        return (self._folder / f"{name}.txt").read_text()


@pytest.mark.xdist_group("real-time")
def test_the_page_lands_and_ros_2_sees_it(tmp_path):
    with ExitStack() as stack:
        parts = Parts(tmp_path, stack)
        parts.start("router")
        node = Node(parts.endpoint)
        stack.callback(node.session.close)
        for name in ("target", "vehicle", "onboard"):
            parts.start(name)
        wait_for(lambda: len(node.tokens()) >= 2 + 1 + 12, "nodes and publishers")
        tokens = node.tokens()
        onboard, deadline_s = parts.running["onboard"], time.monotonic() + WALL_MAX_S
        while onboard.poll() is None:
            assert time.monotonic() < deadline_s
            node.poll()
            time.sleep(0.02)
        assert onboard.returncode == 0, onboard.stdout.read() + parts.errors("onboard")
        wait_for(node.has_all_of_the_flight, "the robot's last place in the flight")
        assert "LANDED" in onboard.stdout.read()
        assert parts.errors("onboard") == ""
    names = {token.split("/")[8] for token in tokens if token.split("/")[5] == "NN"}
    assert names == {"flightstack_onboard", "flightstack_target"}
    told = {token.split("/")[9].replace("%", "/") for token in tokens if token.split("/")[5] == "MP"}
    assert told == set(node.types)
    check(node)


def check(node):
    for topic, numbers in node.sequences.items():
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), topic  # no message was lost
    phases = [message.data for message in node.messages["/cf1/phase"]]
    assert {Phase.TAKEOFF.name, Phase.APPROACH.name, Phase.LAND.name} <= set(phases)
    assert phases[-1] == Phase.LANDED.name
    steps = node.messages["/cf1/controller/step"]
    last = [repr(step.h_m) for step in steps[-50:]]  # repr, because NaN does not equal itself
    assert [repr(message.data) for message in node.messages["/cf1/h"][-50:]] == last
    landing = [step.h_m for step in steps if step.phase == Phase.LAND]
    assert len(landing) >= 5  # LAND lasts 0.45 to 0.6 s; 20 steps a second
    assert min(landing) > -0.1
    commands_ = node.messages["/cf1/cmd/velocity"]
    assert {one.header.frame_id for one in commands_} == {"map"}
    assert max(abs(one.twist.linear.z) for one in commands_) > 0.05
    own = node.messages["/cf1/odom"][-1]  # the robot publishes until the onboard process has ended
    target = min(node.messages["/cf1/target/odom"], key=lambda one: abs(seconds(one) - seconds(own)))
    assert (target.header.frame_id, target.child_frame_id) == ("map", "target")
    assert abs(seconds(target) - seconds(own)) < 0.1
    gap = [getattr(own.pose.pose.position, a) - getattr(target.pose.pose.position, a) for a in "xy"]
    assert math.hypot(*gap) < 0.2
    assert node.messages["/cf1/health"][-1].target_accepted > 500


def seconds(message):
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


def end(child):
    if child.poll() is None:
        child.send_signal(signal.SIGTERM)
    with suppress(subprocess.TimeoutExpired):
        child.communicate(timeout=PATIENCE_S)
    killed(child)
