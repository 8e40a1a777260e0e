"""Tests the subcommand ``px4-sim`` over its real connections, with an imitation of PX4."""

import itertools
import signal
import time
from contextlib import contextmanager

import numpy as np
import pytest

from flightstack.common.processes import Port
from logs.reader.flight import load_flight
from tests.integration.runs import called
from tests.integration.sim_processes import verb
from tests.unit.px4.px4_fakes import FakePx4

PATIENCE_S = 120.0  # time-out, s; the first run on a machine compiles


@contextmanager
def simulator(name, *more, speed="0"):
    words = ("px4-sim", "--scenario", name, "--tcp", "127.0.0.1:0", "--speed", speed, *more)
    with verb(*words, within_s=PATIENCE_S) as (child, line):
        yield child, int(line.rsplit(":", 1)[1])


def lines(child):
    out, err = child.communicate(timeout=PATIENCE_S)
    return out.splitlines(), err


def test_outputs_lift_it_by_motion_capture_in_the_coordinates_of_the_room():
    with simulator("paper_moving_1", "--mocap", "--once") as (child, port):
        fake = FakePx4(port)
        fake.hello()
        fake.fly(1.0)
        assert (fake.pose.x, fake.pose.y, -fake.pose.z) == pytest.approx((0.3, -1.2, 0.0144), abs=0.01)
        fake.fly(1.6, (0.75,) * 4, armed=True)
        assert -fake.pose.z > 0.05
        fake.fly(3.0)
        assert -fake.pose.z < 0.05
        assert fake.counts["ODOMETRY"] == pytest.approx(3.0 * 50, abs=2)
        assert "HIL_GPS" not in fake.counts
        fake.close()
        said, _ = lines(child)
        assert child.returncode == 0
        assert said == ["connected", "lockstep", "armed", "disarmed"]


def first_steps(port, count=500):
    """Return the HIL_SENSOR values of the first steps, in which the motors start after one second."""
    fake = FakePx4(port)
    fake.hello()
    found = []
    for step in range(count):
        sensor = fake.sensor()
        found.append((sensor.time_usec, sensor.xacc, sensor.zacc, sensor.zgyro, sensor.abs_pressure))
        fake.answer(sensor.time_usec, (0.7, 0.7, 0.7, 0.7), armed=step >= 250)
    fake.close()
    return found


def test_a_new_px4_finds_the_vehicle_at_its_start_and_the_same_seed_reads_the_same():
    with simulator("paper_moving_1", "--seed", "5") as (child, port):
        first, second = first_steps(port), first_steps(port)
        assert {b[0] - a[0] for a, b in itertools.pairwise(first)} == {4000}
        assert first == second
        assert np.mean([s[2] for s in first[400:]]) < -10.2  # the vehicle has left the floor
        child.send_signal(signal.SIGTERM)
        said, err = lines(child)
        assert child.returncode == 0
        assert said.count("connected") == 2
        assert "listening for the next one" in err


def test_a_silent_px4_ends_it_with_the_reason():
    with simulator("paper_moving_1", "--silent-max", "1") as (child, port):
        fake = FakePx4(port)
        fake.hello()
        fake.answer(fake.sensor().time_usec, (0.0,) * 4)
        _, err = lines(child)
        assert child.returncode == 1
        assert "PX4 is silent" in err


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--scenario", "fault_motor_dead"], "[[fault]]"),
        (["--scenario", "nowhere"], "neither a file nor"),
        (["--scenario", "grid", "--tcp", "4560"], "HOST:PORT"),
        (["--scenario", "grid", "--tcp", "0.0.0.0:4560"], "--allow-unsigned"),
        (["--scenario", "grid", "--speed", "0", "--connect", "tcp/127.0.0.1:7447"], "a speed of its own"),
    ],
)
def test_wrong_input_is_status_2_with_a_reason(arguments, word):
    done = called("px4-sim", *arguments)
    assert done.code == 2
    assert word in done.err


@pytest.mark.xdist_group("real-time")
def test_in_real_time_the_deck_follows_the_robot_and_the_truth_is_recorded(tmp_path):
    socket, log = tmp_path / "feed", tmp_path / "flight.mcap"
    place = Port()
    recorder = verb("record", "--socket", str(socket), "--out", str(log), "--until-clients", "1")
    robot = verb("target", "--scenario", "large", "--listen", place.endpoint)
    plugs = ("--connect", place.endpoint, "--recorder", str(socket), "--once")
    with recorder as (record, _), simulator("large", *plugs, speed="1") as (child, port), robot:
        fake = FakePx4(port)
        fake.hello()
        began_s = time.monotonic()
        fake.fly(6.0)
        assert time.monotonic() - began_s > 5.5
        fake.close()
        lines(child)
        assert record.wait(PATIENCE_S) == 0
    place.close()
    flight = load_flight(log)
    assert flight.truth is not None
    pad = flight.truth.pad_position_enu_m
    assert np.linalg.norm(pad[-1] - pad[0]) > 0.5  # distance that the robot drives at 0.4 m/s
    assert len(pad) == pytest.approx(6.0 * 250 / 3, rel=0.05)
