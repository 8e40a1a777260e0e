"""Process of the Crazyflie bridge: connects cflib to MAVLink clients.

The loop waits for both links. Each set-point goes to the radio, and each state to the clients, on arrival.
"""

from __future__ import annotations

import math
import re
import select
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING

from bridge.crazyflie.node import Node
from bridge.crazyflie.packets import SetParam
from bridge.crazyflie.rules import ECHO_MAX_S, ESTIMATOR, KALMAN, CrazyflieOptions
from bridge.frames import yaw_from_quaternion
from bridge.mavlink.endpoint import Endpoint, open_endpoint
from bridge.mavlink.server.server import COMPONENT_ID
from bridge.mavlink.transport.address import parse_url
from flightstack.common.hangup import Stop
from flightstack.common.pacing import run_promptly
from flightstack.common.text import pip_install
from flightstack.core.types import Vec3

if TYPE_CHECKING:
    from bridge.crazyflie.link import CrazyflieLink  # for type checking only, because it needs cflib
    from bridge.mocap.process import MocapSource

INITIAL = "kalman.initial"
RESET = "kalman.resetEstimation"


_URI = re.compile(
    r"^(radio://[0-9A-Fa-f]+/\d{1,3}/(250K|1M|2M)(/[0-9A-Fa-f]{1,10})?(\?rate_limit=\d+)?|usb://\d+"
    r"|(udp|tcp)://[^:/\s]+:\d{1,5})$"
)
TICK_S = 0.01  # maximum sleep of the loop, s
POSE_TICK_S = 0.002  # maximum sleep with motion capture, s; samples of motion capture cannot wake the loop
SHUT_DOWN_MAX_S = 20.0  # time limit of the landing when the bridge ends in flight, s


class Loop:
    def __init__(
        self,
        node: Node,
        link: CrazyflieLink,
        endpoint: Endpoint,
        poses: MocapSource | None,
        say: Callable[[str], None],
    ) -> None:
        self._node, self._link, self._endpoint, self._poses, self._say = node, link, endpoint, poses, say
        self._start_s = time.monotonic()
        self._begun: tuple[int, int] | None = None  # connection and pose series of the last estimator reset
        self._tick_s = TICK_S if poses is None else POSE_TICK_S

    @property
    def now_s(self) -> float:
        return time.monotonic() - self._start_s

    def turn(self) -> None:
        """Sleep until data arrives or a tick ends, then process all data."""
        select.select((self._endpoint.fileno(), self._link.fileno()), (), (), self._tick_s)
        node, endpoint = self._node, self._endpoint
        for at_s, event in self._link.poll():
            node.take(event, at_s - self._start_s)
        now_s = self.now_s
        for received in endpoint.receive():
            sender = (*received.sender, received.peer)
            endpoint.send(node.handle(received.message, sender, now_s), received.peer)
        if self._poses is not None:
            self._pass_pose(self._poses, now_s)
        messages, replies = node.step(now_s)
        for packet in node.vehicle.take_packets():
            self._link.send(packet)
        endpoint.send(messages)
        for reply in replies:
            if len(reply.sender) == 3:
                endpoint.send([reply.message], reply.sender[2])
        for notice in endpoint.take_notices():
            self._say(f"crazyflie: {notice}")
        for text in node.take_texts():
            self._say(f"crazyflie: {text.text}")

    def _pass_pose(self, poses: MocapSource, now_s: float) -> None:
        vehicle = self._node.vehicle
        passed = next(reversed(poses.poll(now_s, armed=vehicle.armed)), None)
        vehicle.mocap(poses.problem, passed)
        if passed is None or vehicle.link.protocol is None:
            return
        pose = passed.pose
        key = (id(vehicle.link), passed.resets)  # each connection has its own ``Connected`` object
        starts = self._begun != key and vehicle.link.params.get(ESTIMATOR) == KALMAN
        if starts and not vehicle.armed:
            self._begun = key
            x, y, z = pose.position_m
            values = {"X": x, "Y": y, "Z": z, "Yaw": yaw_from_quaternion(pose.orientation_wxyz)}
            for name, value in values.items():
                self._link.send(SetParam(INITIAL + name, value))
            self._link.send(SetParam(RESET, 1.0))
            self._link.send(SetParam(RESET, 0.0))
        self._link.send(pose)

    def run(self, stop: Stop, duration_s: float | None) -> int:
        """Loop until a signal; the first lands the vehicle, the second ends the loop. Return the exit status.

        An exception also lands the vehicle: without set-points the firmware would stop the motors.
        """
        vehicle, status = self._node.vehicle, 0
        ending_s: float | None = None
        left_s = math.inf  # time when the parameters are restored, s
        while stop.count < 2:
            try:
                self.turn()
            except Exception:
                if not status:
                    status = 1
                    self._say(f"crazyflie: lands, then ends: {traceback.format_exc()}")
                self._descend()
            over = stop.count or status or (duration_s is not None and self.now_s >= duration_s)
            if ending_s is None and over:
                ending_s = self.now_s
                vehicle.end(ending_s)
            if ending_s is None or (vehicle.busy and self.now_s - ending_s <= SHUT_DOWN_MAX_S):
                continue
            left_s = min(left_s, self.now_s)
            for packet in vehicle.settings.leave():
                self._link.send(packet)
            if not vehicle.settings.open or self.now_s - left_s > ECHO_MAX_S:
                break
        return status

    def _descend(self) -> None:
        """Continue only the landing after another part of the loop has failed."""
        time.sleep(self._tick_s)
        with suppress(Exception):
            self._node.step(self.now_s)
            for packet in self._node.vehicle.take_packets():
                self._link.send(packet)


def check_uri(uri: str) -> None:
    """Reject a URI with which cflib would try to connect without a time-out."""
    if not _URI.match(uri):
        raise ValueError(
            f"Crazyflie URI {uri!r} is not understood: allowed is radio://DONGLE/CHANNEL/RATE or "
            "radio://DONGLE/CHANNEL/RATE/ADDRESS with RATE 250K, 1M or 2M, usb://NUMBER, udp://HOST:PORT or "
            "tcp://HOST:PORT, for example radio://0/80/2M/E7E7E7E7E7"
        )


def run(options: CrazyflieOptions, drag_1_s: Vec3 | None, say: Callable[[str], None] = print) -> int:
    """Serve clients until a signal arrives; print ``ready URL`` when clients can connect.

    ``drag_1_s`` is the rotor drag for the firmware's filter, 1/s, body axes; None leaves it unchanged.
    """
    try:
        from bridge.crazyflie.link import CrazyflieLink
    except ModuleNotFoundError as error:
        package = (error.name or "cflib").partition(".")[0]
        raise ValueError(f"{package} is not installed: {pip_install('crazyflie')}") from error
    check_uri(options.uri)
    kind, host, port = parse_url(options.url)
    poses: MocapSource | None = None  # without motion capture the Crazyflie uses its own positioning
    with ExitStack() as stack:
        if options.mocap_key is not None:
            from bridge.mocap.process import MocapSource, summary

            poses = stack.enter_context(MocapSource.opened(options.mocap_key, options))
        endpoint = open_endpoint(
            "crazyflie", options.url, options.system_id, COMPONENT_ID, options, options.peers
        )
        stack.callback(endpoint.close)
        run_promptly()  # set the priority first: cflib's threads inherit the priority
        link = CrazyflieLink(options.uri, options.cache)
        stack.callback(link.close)
        stop = Stop().install()
        say(f"ready {kind}:{host}:{endpoint.local_port if kind == 'udpin' else port}")
        sys.stdout.flush()
        status = Loop(Node(options, drag_1_s), link, endpoint, poses, say).run(stop, options.duration_s)
    if poses is not None:
        say(summary(poses.checks))
    return status
