"""Starts subcommands of ``flightstack bridge`` and a motion capture, and flies through the bridges."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.zenoh import zenoh_link
from sim.scenarios.scenario import Scenario
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.server import Server
from tests.crazyflie_firmware.sim_plant import SimPlant
from tests.integration.runs import Background
from tests.integration.sim_processes import Client, is_a, setpoint
from tests.processes.bounded import PATIENCE_S
from tests.processes.ports import free_endpoint, free_port
from tests.unit.target.ros2_helpers import pose_stamped

OFFBOARD, HOLD = 0x00060000, 0x03040000
HOVERS_M = 0.3  # height above the start from which the vehicle hovers, after a take-off to 0.5 m
ASKS_EVERY_S = 1.5  # period of a pilot's requests, s; heartbeats, once a second, show the result


class Verb(Background):
    """Process of ``flightstack bridge`` that has printed its URL."""

    def __init__(self, *arguments: str) -> None:
        super().__init__("bridge", *arguments)
        self.url = self.until("ready").removeprefix("ready ")
        assert self.lines[0].startswith("ready"), self.lines


@contextmanager
def verb(*arguments: str) -> Iterator[Verb]:
    started = Verb(*arguments)
    try:
        yield started
    finally:
        started.kill()


@contextmanager
def bridge(server: Server, *arguments: str) -> Iterator[Verb]:
    with verb("crazyflie", "--uri", server.uri, "--url", "udpin:127.0.0.1:0", *arguments) as started:
        yield started


@contextmanager
def member_behind_the_bridge(
    scenario: Scenario, seed: int, number: int, url: str, robots: str
) -> Iterator[SimPlant]:
    """Run a Crazyflie as a fleet member, with firmware model and bridge; yield its simulated vehicle.

    ``number``: system id; ``robots``: Zenoh endpoint of the robots; this member's robot moves the deck.
    """
    session = zenoh_link.open_session([], [robots])
    try:
        plant = SimPlant(scenario, seed, session, f"cf{number}")
        with Server(Firmware(plant)) as server:
            words = ("--uri", server.uri, "--url", url, "--system-id", str(number))
            with verb("crazyflie", *words):
                yield plant
    finally:
        session.close()


@contextmanager
def client(started: Verb) -> Iterator[Client]:
    one = Client(started.url)
    try:
        one.hello()
        yield one
    finally:
        one.close()


def fly(one: Client, server: Server) -> None:
    """Arm, take off, and enter OFFBOARD with a stream of zero velocities.

    If the host stalls, state and poses become stale: arming is rejected, or the take-off ends on the ground
    or in a landing. The requests are repeated until the vehicle hovers, as a pilot would do.
    """
    ready = lambda m: is_a("SYS_STATUS")(m) and m.onboard_control_sensors_health & 0x10000000  # noqa: E731
    one.until(ready, each=one.hello)
    low = lambda: server.firmware.plant.position[2] < HOVERS_M  # noqa: E731
    hovers = lambda m: is_a("HEARTBEAT", custom_mode=HOLD)(m) and m.base_mode & 0x80 and not low()  # noqa: E731
    asked_s = -math.inf

    def ask(*messages) -> None:
        nonlocal asked_s
        one.hello()
        if time.monotonic() - asked_s > ASKS_EVERY_S:
            asked_s = time.monotonic()
            one.send(*messages)

    take_off = (one.command(400, 1.0), one.command(22))
    one.until(hovers, 2 * PATIENCE_S, each=lambda: ask(*take_off) if low() else one.hello())
    one.send(setpoint(), one.command(176, 1.0, 6.0))
    asked_s = time.monotonic()

    def stream() -> None:
        one.send(setpoint())
        ask(one.command(176, 1.0, 6.0))

    one.until(is_a("HEARTBEAT", custom_mode=OFFBOARD), each=stream)
    assert not low()


KEY = "lab/cf1/pose"


class Mocap:
    """Publishes a pose at 100 Hz on a Zenoh key, until it is stopped."""

    def __init__(self, key: str, pose: Callable[[], tuple]) -> None:
        self.endpoint = free_endpoint()
        self._session = zenoh_link.open_session([self.endpoint])
        self._publisher = zenoh_link.dropping_publisher(self._session, key)
        self._pose, self._done = pose, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._done.wait(0.01):
            self._publisher.put(pose_stamped(time.time_ns(), "map", *self._pose()))

    def stop(self) -> None:
        self._done.set()
        self._thread.join(PATIENCE_S)

    def __enter__(self) -> Mocap:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._session.close()


@contextmanager
def plain_vehicle(autopilot: int) -> Iterator[Client]:
    """Yield a pymavlink client that acts as an autopilot; its ``beat()`` sends a heartbeat."""
    one = Client(f"udpin:127.0.0.1:{free_port(udp=True)}", 1, 1, listen=True)
    try:
        one.beat = lambda: one.send(mav.MAVLink_heartbeat_message(2, autopilot, 0, 0, 3, 3))
        yield one
    finally:
        one.close()
