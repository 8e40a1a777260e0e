"""Tests the real PX4 program, if found: as a child process, and in flights to a driving robot.

One PX4 flies all flights, because a start of PX4 takes as long as a flight; after a landing the vehicle takes
off from the robot's pad. The position comes from motion capture, because with satellites PX4 does not arm on
a driving robot ("GPS Horizontal Pos Drift too high").
"""

import contextlib
import os
import signal
import time
from dataclasses import dataclass, replace

import numpy as np
import pytest

from flightstack.common.strict_toml import dumps
from flightstack.core.types import Mode
from logs.reader.flight import load_flight
from logs.reader.flight_data import Truth
from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.plant import Px4Plant
from sim.px4.program import Px4Error, Px4Model, Px4Program, find_px4, free_instance
from sim.scenarios.scenario import load
from tests.flight_suite.companion import companion
from tests.flight_suite.pilot import Pilot
from tests.flight_suite.room import on_px4
from tests.processes.bounded import AT_ONCE_S, wait_for
from tests.processes.started import StartedChild
from tests.px4_place import px4_or_skip

# only the worker of "stream 0" flies the real PX4
pytestmark = [pytest.mark.xdist_group("real-time"), pytest.mark.xdist_group("stream 0")]


@pytest.fixture
def instance():
    return free_instance()


def test_is_ready_with_the_parameters_wanted_and_counts_from_the_origin_of_the_room(tmp_path):
    """PX4 gets positions from motion capture; a test in test_autopilots.py uses satellites instead."""
    scenario = load("grid")
    wanted = parameters(params.load(scenario.vehicle.airframe), scenario.vehicle.mocap)
    with on_px4(tmp_path, px4_or_skip(), "grid", 0, mocap=True) as room:
        px4 = room.px4
        assert "Preflight check: OK" in px4.console("commander", "check")
        for name, value in wanted.items():
            px4.console("param", "compare", name, str(value))  # the call fails if the value differs
        said = px4.console("listener", "vehicle_local_position", "-n", "1").splitlines()
        place = {words[0]: words[1] for words in map(str.split, said) if len(words) > 1}
        east, north, _ = Px4Plant(scenario, 0).body().position_enu_m
        assert float(place["y:"]) == pytest.approx(east, abs=0.1)  # the local position of PX4 is NED
        assert float(place["x:"]) == pytest.approx(north, abs=0.1)


def test_a_px4_without_a_simulator_is_given_up_with_its_last_lines(tmp_path, instance):
    px4 = Px4Program(px4_or_skip(), tmp_path, Px4Model.NONE_IRIS, instance=instance)
    try:
        wait_for(lambda: "Waiting for simulator" in px4.output.read_text(), "PX4 that waits")
        with pytest.raises(Px4Error, match="Waiting for simulator"):
            px4.boot(1.0)
        os.killpg(px4.process.pid, signal.SIGSTOP)  # a stopped process must also end within the time-out
        began_s = time.monotonic()
        px4.end()
        assert time.monotonic() - began_s < AT_ONCE_S
        with pytest.raises(Px4Error, match="has ended"):
            px4.console("commander", "check")
    finally:
        px4.end()


def test_places_without_a_px4_are_refused_with_what_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match="no PX4 program found"):
        find_px4(tmp_path)
    (tmp_path / "px4").write_bytes(b"")
    (tmp_path / "px4").chmod(0o755)
    with pytest.raises(FileNotFoundError, match="its folder etc"):
        find_px4(tmp_path)
    (tmp_path / "etc").mkdir()
    with pytest.raises(FileNotFoundError, match=r"px4-alias\.sh"):
        find_px4(tmp_path / "px4")
    (tmp_path / "px4-alias.sh").write_text("")
    assert find_px4(tmp_path).binary == tmp_path / "px4"
    with pytest.raises(ValueError, match="0 to 9"):
        Px4Program(tmp_path, tmp_path, Px4Model.NONE_IRIS, instance=10)


FLIGHTS = 2
SPEED = 4.0  # maximum ratio of simulated to real time
FLIGHT_MAX_S = 120.0  # time-out of a flight, s of wall time, also on slow machines
LOST_S = 10.0  # time-out of PX4's fail-safe, s of wall time; COM_OF_LOSS_T = 1.0 s simulated, heartbeat 1 Hz
LANDED_MAX_S = 60.0
RECORDED_MAX_S = 60.0
ROBOT_M_S = 0.2
DRIVEN_M = 2.0  # minimum distance that the robot must drive during the flights, m
TAKEOFF_M = 1.2
KILLED_M = 0.2  # height of the kill in the climb, m: PX4 climbs about 0.8 m more until its fail-safe acts
ERROR_M = 0.25  # maximum allowed touchdown error, m; the pad has a radius of 0.5 m
STANDS_M = 0.12  # height of the reference point above the pad while the vehicle stands on it, m
NEAR_M = 0.05
TWITCH_S = 0.1  # duration below which a run of the motors is no flight, s; 12 ms was observed once
CARRIED_S = 2.0  # time after motors off for which the vehicle must remain on the pad, s


def scenario_file(folder):
    """Write scenario ``large`` with short distances, so that flights last below 20 s; return its path."""
    large = load("large")
    start = replace(large.start, offset_m=(-1.0, 0.5, 1.1))
    short = replace(
        large, name="large_short", start=start, target=replace(large.target, speed_m_s=ROBOT_M_S),
        onboard=replace(large.onboard, takeoff=replace(large.onboard.takeoff, height_m=TAKEOFF_M)),
    )  # fmt: skip
    file = folder / "large_short.toml"
    file.write_text(dumps(short))
    return file


@dataclass
class Flown:
    """Results of consecutive flights of one PX4."""

    ends: list  # exit status and last line of the onboard process for each flight
    truth: Truth  # true states from the first to the last flight

    def armed_s(self):
        """Return start and end of each flight, s.

        PX4 may also run the motors for one sample before a flight; this does not count.
        """
        running = np.diff(self.truth.motors_running.astype(int), prepend=0, append=0)
        edges = self.truth.t_s[np.minimum(np.flatnonzero(running), len(self.truth.t_s) - 1)]
        times_s = zip(edges[::2], edges[1::2], strict=True)
        return [(begin_s, end_s) for begin_s, end_s in times_s if end_s - begin_s > TWITCH_S]


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    place, folder = px4_or_skip(), tmp_path_factory.mktemp("px4")
    socket, log = folder / "feed", folder / "flight.mcap"
    words = ["record", "--socket", str(socket), "--out", str(log), "--until-clients", "1"]
    ends = []
    with contextlib.ExitStack() as stack:
        recorder = StartedChild("record", words, folder)
        stack.callback(recorder.end, RECORDED_MAX_S)
        recorder.wait_ready()
        with on_px4(
            folder,
            place,
            str(scenario_file(folder)),
            seed=1,
            speed=SPEED,
            clocked=True,
            mocap=True,
            recorder=socket,
        ) as room:
            for _ in range(FLIGHTS):
                with companion(room) as flying:
                    ends.append((flying.ended(FLIGHT_MAX_S), flying.said[-1]))
            with companion(room) as flying:
                flying.until("-> TAKEOFF", FLIGHT_MAX_S)
                flying.until_high(KILLED_M, FLIGHT_MAX_S)
                flying.kill()
            with Pilot(room) as pilot:
                pilot.connect()
                pilot.watch("landing", lambda: pilot.status.mode is Mode.LAND, LOST_S)
                pilot.watch("motors off", lambda: not pilot.status.armed, LANDED_MAX_S)
        recorder.process.wait(RECORDED_MAX_S)
    return Flown(ends, load_flight(log).truth)


def test_flights_in_a_row_land(flown):
    assert [code for code, _ in flown.ends] == [0] * FLIGHTS, flown.ends
    assert all(line.startswith("LANDED") for _, line in flown.ends)


def test_after_each_of_them_the_vehicle_truly_stands_on_the_pad(flown):
    truth = flown.truth
    flights = flown.armed_s()
    assert len(flights) == FLIGHTS + 1
    for _, end_s in flights[:FLIGHTS]:
        for at in np.searchsorted(truth.t_s, (end_s, end_s + CARRIED_S)):
            assert truth.d_m[at] < ERROR_M
            assert truth.e_m[at, 2] == pytest.approx(STANDS_M, abs=NEAR_M)
    (first_s, _), *_, (last_s, _) = flights
    first, last = np.searchsorted(truth.t_s, (first_s, last_s))
    assert np.hypot(*(truth.pad_position_enu_m[last] - truth.pad_position_enu_m[first])[:2]) > DRIVEN_M


def test_killed_in_its_climb_it_came_down_by_itself(flown):
    truth = flown.truth
    begin_s, end_s = flown.armed_s()[-1]
    climb = (truth.t_s >= begin_s) & (truth.t_s <= end_s)
    highest_m = truth.position_enu_m[climb, 2].max() - truth.position_enu_m[climb, 2][0]
    assert KILLED_M - NEAR_M < highest_m < TAKEOFF_M  # the vehicle did not reach the hover height
    assert truth.contacts[-1] > 0
    assert not truth.motors_running[-1]
