"""Tests motion capture for a Crazyflie and for vehicles with other autopilots."""

from __future__ import annotations

import math
import signal
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.ros2.ros2_names import topic_key
from bridge.target.ros2_target import ROS_TYPES, TargetType
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.server import Server
from tests.integration.runs import called
from tests.integration.sim_processes import is_a
from tests.integration.wires.bridge_processes import KEY, Mocap, bridge, client, fly, plain_vehicle, verb
from tests.processes.bounded import wait_for

pytestmark = pytest.mark.xdist_group("real-time")


def test_a_crazyflie_that_needs_motion_capture_flies_by_a_topic_of_ros_2():
    plant = Point(0.4, -0.3)
    plant.yaw = 2.5
    firmware = Firmware(plant, needs_poses=True)
    firmware.params["deck.bcLighthouse4"].value = 0
    given = "ros2:/lab/cf1/pose"
    key = topic_key(0, given.removeprefix("ros2:"), *ROS_TYPES[TargetType.POSE])
    with (
        Mocap(key, lambda: (tuple(plant.position), plant.quaternion)) as mocap,
        Server(firmware) as server,
        bridge(
            server, "--mocap", "ros2:/lab/cf1/pose", "--frame", "map", "--connect", mocap.endpoint
        ) as started,
        client(started) as one,
    ):
        fly(one, server)
        _, last = firmware.poses[-1]
        assert last[:3] == pytest.approx(plant.position, abs=0.05)
        assert (last[5], last[6]) == pytest.approx((math.sin(1.25), math.cos(1.25)), abs=0.02)
        assert firmware.params["kalman.initialYaw"].value == pytest.approx(2.5, abs=0.01)
        rate_hz = len([1 for at_s, _ in firmware.poses if at_s > firmware.poses[-1][0] - 1.0])
        assert rate_hz > 50
        one.send(one.command(21))
        mocap.stop()
        wait_for(lambda: started.said("mocap: no pose for"), "the text")
        one.until(lambda m: is_a("HEARTBEAT")(m) and not m.base_mode & 128, each=one.hello)
        assert plant.on_surface
        one.send(one.command(400, 1.0))
        assert one.until(is_a("COMMAND_ACK", command=400)).result == 1
        settled_s = server.now_s + 1.0  # until this time the supervisor may be in its former state
        wait_for(lambda: server.now_s > settled_s, "time")
        one.send(one.command(400, 1.0))
        wait_for(lambda: started.said("Arming refused: mocap: no pose for"), "the reason")
        assert started.end(signal.SIGTERM) == 0
        wait_for(lambda: started.said("poses passed on"), "the summary")


@pytest.mark.parametrize(("autopilot", "kind"), [(12, "ODOMETRY"), (3, "VISION_POSITION_ESTIMATE")])
def test_a_vehicle_gets_poses_in_its_own_way(autopilot, kind):
    pose = ((1.0, 2.0, 0.5), (math.cos(0.3), 0.0, 0.0, math.sin(0.3)))
    with (
        Mocap(KEY, lambda: pose) as mocap,
        plain_vehicle(autopilot) as vehicle,
        verb(
            "mocap", "--key", KEY, "--connect", mocap.endpoint, "--origin", "47.4", "8.5", "430",
            "--vehicle", f"udpout:127.0.0.1:{vehicle._to[1]}",
        ) as started,
    ):  # fmt: skip
        vehicle.until(is_a("HEARTBEAT"))
        message = vehicle.until(is_a(kind), each=vehicle.beat)
        assert (message.x, message.y, message.z) == pytest.approx((2.0, 1.0, -0.5), abs=1e-6)
        yaw = message.yaw if kind != "ODOMETRY" else 2.0 * math.atan2(message.q[3], message.q[0])
        assert math.remainder(yaw - (math.pi / 2 - 0.6), math.tau) == pytest.approx(0.0, abs=1e-3)
        assert message.get_srcComponent() == 197
        vehicle.log.clear()
        start_s, came = time.monotonic(), []
        while came.count(kind) < 100:
            assert vehicle.receive(), "no poses"
            came = [m.get_type() for m in vehicle.log]
        assert time.monotonic() - start_s > 1.5  # 2 s at 50 Hz; less if delayed messages arrive together
        assert ("SET_GPS_GLOBAL_ORIGIN" in came) == (autopilot == 3)
        vehicle.send(mav.MAVLink_timesync_message(0, 4711))
        assert vehicle.until(is_a("TIMESYNC", ts1=4711)).tc1 > 0
        mocap.stop()
        wait_for(lambda: started.said("mocap: no pose for"), "the text")
        vehicle.send(mav.MAVLink_timesync_message(0, 4712))
        vehicle.until(is_a("TIMESYNC", ts1=4712))  # after this reply, all earlier messages have arrived
        vehicle.log.clear()
        vehicle.beat()
        vehicle.until(is_a("HEARTBEAT"), each=vehicle.beat)
        assert kind not in [m.get_type() for m in vehicle.log]
        assert started.end(signal.SIGTERM) == 0


def test_what_is_missing_is_named_with_key_endpoint_and_url():
    pose = ((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))
    words = ("--key", "lab/cf9/pose", "--vehicle", "udpout:127.0.0.1:9")
    with Mocap(KEY, lambda: pose) as mocap, verb("mocap", *words, "--connect", mocap.endpoint) as started:
        started.until("mocap: no message from the vehicle at udpout:127.0.0.1:9")
        started.until(f"mocap: no pose on lab/cf9/pose at {mocap.endpoint} yet; there are {KEY}")
        assert started.end(signal.SIGTERM) == 0


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--key", "a/b", "--origin", "95", "8", "400"], "latitude of -90 to 90"),
        (["--key", "a/b", "--origin", "47.4", "8.5", "0"], "height of 0 m"),
        (["--key", "ros2:/0bad"], "is not a full name"),
        (["--key", "a//b"], "Zenoh key 'a//b' is not allowed"),
    ],
)
def test_wrong_input_is_an_error_that_says_what_is_allowed(arguments, reason):
    done = called("bridge", "mocap", "--vehicle", "udpout:127.0.0.1:9", *arguments)
    assert done.code == 2
    assert reason in done.err
