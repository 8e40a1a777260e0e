"""A real PX4 on px4-sim: three flights in a row to a robot that drives on, then one that is left alone.

Skipped where there is no PX4 (tests/px4_program.py). One PX4 flies all of it, since its start takes as long
as a flight; nobody moves the vehicle: it takes off from where it landed, the robot's pad. By motion capture:
with satellites PX4 does not arm on a robot that drives ("GPS Horizontal Pos Drift too high").
"""

import contextlib
from dataclasses import dataclass, replace

import numpy as np
import pytest

from flightstack.common.processes import Child
from flightstack.common.strict_toml import dumps
from flightstack.core.types import Mode
from logs.reader.flight import load_flight
from logs.reader.flight_data import Truth
from sim.scenarios.scenario import load
from tests.flight_suite.companion import companion
from tests.flight_suite.pilot import Pilot
from tests.flight_suite.px4_room import on_px4
from tests.px4_program import px4_or_skip

pytestmark = pytest.mark.xdist_group("real-time")
FLIGHTS = 3
SPEED = 4.0  # at most, against real time
FLIGHT_MAX_S = 120.0  # of wall time, however slow the machine
LOST_S = 10.0  # the same, for COM_OF_LOSS_T = 1.0 s of simulated time, and a heartbeat once a second
LANDED_MAX_S = 60.0
RECORDED_MAX_S = 60.0
ROBOT_M_S = 0.2
DRIVEN_M = 2.0  # at least, while the three flights last
TAKEOFF_M = 1.2
KILLED_M = 0.4  # above the ground, in the climb
ERROR_M = 0.25  # of a pad of 0.5 m
STANDS_M = 0.12  # reference of the vehicle above the pad on which it stands
NEAR_M = 0.05
CARRIED_S = 2.0  # after its motors stopped; the robot drives on


def scenario_file(folder):
    """Scenario ``large`` with short ways: a flight ends within twenty seconds."""
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
    """What became of all flights.

    Attributes:
        ends: exit status and last line of the onboard process, of each flight that was let fly.
        truth: true states from the first to the last, while the robot drives on.
    """

    ends: list
    truth: Truth

    def armed_s(self):
        """Begin and end of each time with running motors."""
        running = np.diff(self.truth.motors_running.astype(int), prepend=0, append=0)
        edges = self.truth.t_s[np.minimum(np.flatnonzero(running), len(self.truth.t_s) - 1)]
        return list(zip(edges[::2], edges[1::2], strict=True))


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    place, folder = px4_or_skip(), tmp_path_factory.mktemp("px4")
    socket, log = folder / "feed", folder / "flight.mcap"
    words = ["record", "--socket", str(socket), "--out", str(log), "--until-clients", "1"]
    ends = []
    with contextlib.ExitStack() as stack:
        recorder = Child("record", words, folder)
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


def test_three_flights_in_a_row_land(flown):
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
    assert KILLED_M - NEAR_M < highest_m < TAKEOFF_M  # it did not go on to where it would have hovered
    assert truth.contacts[-1] > 0
    assert not truth.motors_running[-1]
