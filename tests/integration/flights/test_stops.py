"""Tests abort and emergency stop by the operator in each phase, a closed terminal, and signals to bridges."""

from __future__ import annotations

import gc
import os
import pty
import select
import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from flightstack.core.types import Operator, Phase
from logs.reader.flight import load_flight
from sim.scenarios.fault_spec import Fault, Kind, What
from sim.scenarios.scenario import path_of
from sim.vehicle.vehicle import warm_up
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.server import Server
from tests.crazyflie_firmware.supervisor import State
from tests.fault_grid.flight import Flight
from tests.fault_grid.run import SEED, end_of, impact, scenario
from tests.fault_grid.table import End
from tests.integration.runs import COMMAND, Flying
from tests.integration.sim_processes import Client, is_a
from tests.integration.wires.bridge_processes import KEY, Mocap, fly, plain_vehicle, verb
from tests.processes.bounded import PATIENCE_S, wait_for

STOPPED_S = 0.3  # time-out from the emergency stop to motors off, s
# fault that leads to the phases which a flight without faults does not have
LOST = Fault(What.TARGET_ODOMETRY, Kind.OFF)
AT_ONCE, LATER_S = 0.0, 0.3
# moments of the request: phase, and time since the start of this phase, s
MOMENTS = [
    (Phase.WAIT, AT_ONCE), (Phase.TAKEOFF, AT_ONCE), (Phase.TAKEOFF, 3.0), (Phase.APPROACH, LATER_S),
    (Phase.LAND, LATER_S), (Phase.TOUCHDOWN, AT_ONCE), (Phase.LANDED, LATER_S), (Phase.HOLD, LATER_S),
    (Phase.CLIMB, LATER_S), (Phase.ABORT, LATER_S),
]  # fmt: skip
SILENT = """
[[fault]]
what = "own_state"
kind = "stuck"
after = "takeoff"
start_s = 4.0
"""
OFF_COURSE = (Phase.HOLD, Phase.CLIMB, Phase.ABORT)


@pytest.fixture(scope="module", autouse=True)
def compiled():
    warm_up(scenario())
    gc.collect()
    gc.freeze()  # later garbage collections skip the compiler, which is loaded now


def fly_and_ask(asked: Operator, phase: Phase, after_s: float):
    """Fly, and make the operator's request ``after_s`` after the start of a phase."""
    since = []

    def moment(flight: Flight) -> bool:
        memory = flight.controller.memory
        if phase in OFF_COURSE and flight.phase is Phase.APPROACH and not since:
            since.append(flight.now_ns)
            flight.target.fail(LOST, flight.now_ns)
        return flight.phase is phase and flight.now_ns * 1e-9 - memory.phase_since_s >= after_s

    flown = Flight(scenario(), SEED, moment, lambda flight: setattr(flight, "asked", asked)).fly()
    gc.collect()
    return flown


def named(moments):
    return [f"{phase.name.lower()} {after_s:g} s" for phase, after_s in moments]


@pytest.mark.parametrize(("phase", "after_s"), MOMENTS[2::2], ids=named(MOMENTS[2::2]))
def test_the_emergency_stop_stops_the_motors_in_flight(phase, after_s):
    """Some phases are flown; tests/unit/core/mission/test_phases.py tests all phases without flights."""
    flown = fly_and_ask(Operator.EMERGENCY_STOP, phase, after_s)
    assert flown.phases[-1] is (Phase.LANDED if phase is Phase.LANDED else Phase.ABORT)
    assert not flown.truth.motors_running[-1]
    assert flown.down_s <= STOPPED_S
    off = int(np.searchsorted(flown.truth.t_s, flown.disturbed_at_s + STOPPED_S))
    assert not flown.truth.motors_running[off:].any()  # the motors do not restart


@pytest.mark.parametrize(("phase", "after_s"), MOMENTS, ids=named(MOMENTS))
def test_an_abort_ends_safely_on_ground_or_pad_from_every_phase(phase, after_s):
    flown = fly_and_ask(Operator.ABORT, phase, after_s)
    assert flown.phases[-1] is (Phase.LANDED if phase is Phase.LANDED else Phase.ABORT)
    truth = flown.truth
    assert not truth.motors_running[-1]
    assert impact(truth) < 1.0
    on_ground = phase is Phase.WAIT or (phase, after_s) == (Phase.TAKEOFF, AT_ONCE)
    ends = {End.LANDED} if phase in (Phase.LANDED,) else {End.ABORTED}
    assert end_of(flown) in ends
    if on_ground:
        assert truth.position_enu_m[:, 2].max() < 0.05
    elif phase is not Phase.LANDED:
        clear_m = flown.seen.config.checks.clearance_m
        assert truth.d_m[-1] > (clear_m if Phase.APPROACH in flown.phases else 0.5)


def test_ctrl_backslash_stops_the_motors_of_a_run(tmp_path):
    run = Flying(tmp_path, "--scenario", "grid", "--lockstep")
    run.until("-> TAKEOFF")
    run.process.send_signal(signal.SIGQUIT)
    run.until("-> ABORT: emergency stop (motors off)")
    assert run.end() == 1


def test_after_an_abort_the_run_goes_on_until_the_vehicle_stands(tmp_path):
    file = tmp_path / "silent.toml"
    file.write_text(path_of("grid").read_text() + SILENT)
    run = Flying(tmp_path / "out", "--scenario", file, "--lockstep")
    run.until("-> ABORT")
    assert run.end() == 1
    truth = load_flight(tmp_path / "out" / "flight.mcap").truth
    assert truth.position_enu_m[:, 2].max() > 0.5
    assert truth.position_enu_m[-1, 2] < 0.05
    assert not truth.motors_running[-1]


ARMED = 128


def test_an_onboard_process_whose_terminal_closes_flies_clear_and_lands(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_1", "--lockstep")
    run.until("-> APPROACH")
    for _ in range(3):  # a repeated SIGHUP is not a second Ctrl-C
        os.kill(run.children()["onboard-cf1"], signal.SIGHUP)
    run.until("-> ABORT")
    assert run.end() == 1
    truth = load_flight(tmp_path / "flight.mcap").truth
    assert truth.d_m[-1] > 0.5
    assert truth.position_enu_m[-1, 2] < 0.05
    assert not truth.motors_running[-1]


TAKES_ITS_TERMINAL = (
    "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    "os.execv(sys.argv[1], sys.argv[1:])"
)


def on_a_terminal(arguments):
    """Start a subcommand as leader of a new terminal; return the process and the terminal's other end."""
    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-c", TAKES_ITS_TERMINAL, *COMMAND, *arguments],
        stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
    )  # fmt: skip
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
    """Run a motion-capture bridge until an armed vehicle has its first pose; yield vehicle and bridge."""
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
        started.process.send_signal(signal.SIGTERM)
        wait_for(lambda: beat(vehicle, ARMED) or started.said("ends when it is disarmed"), "the reason")
        vehicle.log.clear()
        vehicle.until(is_a("ODOMETRY"), each=lambda: beat(vehicle, ARMED))
        assert started.process.poll() is None
        wait_for(lambda: beat(vehicle, 0) or started.process.poll() is not None, "the end")
        assert started.process.returncode == 0


@pytest.mark.xdist_group("real-time")
def test_told_twice_the_bridge_of_an_armed_vehicle_ends_at_once():
    with mocap_bridge() as (vehicle, started):
        started.process.send_signal(signal.SIGINT)
        wait_for(lambda: beat(vehicle, ARMED) or started.said("ends when it is disarmed"), "the reason")
        started.process.send_signal(signal.SIGINT)
        wait_for(lambda: beat(vehicle, ARMED) or started.process.poll() is not None, "the end")
        assert started.process.returncode == 0
