"""A terminal that closes in flight, and bridges told to end while a vehicle flies by them."""

import fcntl
import os
import pty
import select
import signal
import subprocess
import termios
from contextlib import contextmanager

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from logs.reader.flight import load_flight
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.server import Server
from tests.crazyflie_firmware.supervisor import State
from tests.integration.runs import COMMAND, Flying
from tests.integration.sim_processes import PATIENCE_S, Client, is_a, wait_for
from tests.integration.wires.crazyflie_processes import fly, verb
from tests.integration.wires.mocap_processes import KEY, Mocap, plain_vehicle

ARMED = 128


def test_an_onboard_process_whose_terminal_closes_flies_clear_and_lands(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_1", "--lockstep")
    run.wait_for("-> APPROACH")
    for _ in range(3):  # however often: it is no second Ctrl-C
        os.kill(run.children()["onboard"], signal.SIGHUP)
    run.wait_for("-> ABORT")
    assert run.end() == 1
    truth = load_flight(tmp_path / "flight.mcap").truth
    assert truth.d_m[-1] > 0.5
    assert truth.position_enu_m[-1, 2] < 0.05
    assert not truth.motors_running[-1]


def on_a_terminal(arguments):
    """Start a verb as the leader of a session on a terminal of its own; returns it and the other end."""
    ours, theirs = pty.openpty()

    def take_terminal():
        os.setsid()
        fcntl.ioctl(theirs, termios.TIOCSCTTY, 0)

    child = subprocess.Popen(
        [*COMMAND, *arguments], stdin=theirs, stdout=theirs, stderr=theirs, preexec_fn=take_terminal
    )
    os.close(theirs)
    return child, ours


def line_of(terminal):
    text = b""
    while not text.endswith(b"\n"):
        assert select.select([terminal], [], [], PATIENCE_S)[0], text
        text += os.read(terminal, 1)
    return text.decode().strip()


@pytest.mark.xdist_group("real-time")
def test_a_crazyflie_bridge_whose_terminal_closes_lands_first():
    with Server(Firmware()) as server:
        child, terminal = on_a_terminal(
            ["bridge", "crazyflie", "--uri", server.uri, "--url", "udpin:127.0.0.1:0"]
        )
        one = Client(line_of(terminal).removeprefix("ready "))
        try:
            one.hello()
            fly(one, server)
            os.close(terminal)
            assert child.wait(2 * PATIENCE_S) == 0
        finally:
            one.close()
            child.kill()
            child.wait(PATIENCE_S)
        assert server.firmware.plant.on_surface
        wait_for(lambda: server.firmware.supervisor.state is State.READY, "the next flight")
        assert State.LOCKED not in [state for _, state in server.firmware.supervisor.history]


def beat(vehicle, base_mode):
    vehicle.send(mav.MAVLink_heartbeat_message(2, 12, base_mode, 0, 3, 3))


@contextmanager
def mocap_bridge():
    """A vehicle that has been heard by the bridge of its poses."""
    with (
        Mocap(KEY, lambda: ((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))) as mocap,
        plain_vehicle(12) as vehicle,
        verb(
            "mocap", "--key", KEY, "--connect", mocap.endpoint,
            "--vehicle", f"udpout:127.0.0.1:{vehicle._to[1]}",
        ) as started,
    ):  # fmt: skip
        vehicle.until(is_a("HEARTBEAT"))
        vehicle.until(is_a("ODOMETRY"), each=lambda: beat(vehicle, ARMED))
        yield vehicle, started


@pytest.mark.xdist_group("real-time")
def test_a_vehicle_that_is_armed_keeps_its_poses_although_their_bridge_was_told_to_end():
    with mocap_bridge() as (vehicle, started):
        started.child.send_signal(signal.SIGTERM)
        wait_for(lambda: beat(vehicle, ARMED) or started.said("ends when it is not"), "the reason")
        vehicle.log.clear()
        vehicle.until(is_a("ODOMETRY"), each=lambda: beat(vehicle, ARMED))
        assert started.child.poll() is None
        wait_for(lambda: beat(vehicle, 0) or started.child.poll() is not None, "the end")
        assert started.child.returncode == 0


@pytest.mark.xdist_group("real-time")
def test_a_vehicle_that_is_not_heard_any_more_does_not_hold_the_bridge():
    with mocap_bridge() as (_, started):
        assert started.end() == 0


@pytest.mark.xdist_group("real-time")
def test_told_twice_the_bridge_of_an_armed_vehicle_ends_at_once():
    with mocap_bridge() as (vehicle, started):
        started.child.send_signal(signal.SIGINT)
        wait_for(lambda: beat(vehicle, ARMED) or started.said("ends when it is not"), "the reason")
        started.child.send_signal(signal.SIGINT)
        wait_for(lambda: beat(vehicle, ARMED) or started.child.poll() is not None, "the end")
        assert started.child.returncode == 0
