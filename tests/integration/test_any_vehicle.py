"""The tests that fly anything: our simulated vehicle by default, any other by ``--vehicle URL --target KEY``.

Each step ends at a limit of height, distance or time with the vehicle being brought down. On a vehicle that
was given, nothing arms without ``--arm-ok``; see docs/hardware.md.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from dataclasses import replace

import pytest

from flightstack.types import ZERO, Landed, Mode, Request
from tests.flight_suite.companion import companion
from tests.flight_suite.pilot import Pilot
from tests.flight_suite.radio import Radio
from tests.flight_suite.room import Fence, given, simulated
from tests.integration.runs import WALL_MAX_S, flightstack
from tests.integration.sim_processes import ROOT

pytestmark = pytest.mark.vehicle
SAFE_S = 2.0  # from the loss of a part to a safe state
HEARTBEAT_LOST_S = 3.0  # it comes once a second, and two may be lost
SLOW_M_S = 0.15  # a vehicle that holds still
HOLD_M = 0.3  # that it may drift in five seconds
STEP_M_S, STEP_S = 0.3, 2.0
FLIGHT_MAX_S = 90.0


@pytest.fixture
def room(request, tmp_path, personality, flight_number):
    given_room = request.config.getoption("--vehicle") is not None
    where = given(request.config, tmp_path) if given_room else simulated(tmp_path, personality)
    with where as one:
        yield one


@pytest.fixture
def pilot(room):
    with Pilot(room) as one:
        one.connect()
        yield one


def speed_m_s(pilot):
    return math.hypot(*pilot.own.velocity_enu_m_s)


def test_connects_and_tells_who_and_where_it_is(pilot):
    seen = set()

    def newer() -> bool:
        seen.add(pilot.own.source_time_s)
        return False

    until_s = pilot.vehicle_s + 2.0
    pilot.watch("count states", lambda: newer() or pilot.vehicle_s >= until_s, 5.0)
    assert len(seen) / 2.0 >= 20.0, "states a second"
    assert pilot.status.landed is Landed.ON_GROUND
    assert not pilot.status.armed
    assert pilot.link.state.counters.other_autopilot == 0
    assert speed_m_s(pilot) < SLOW_M_S


def test_its_parameters_are_safe(room):
    words = ["--vehicle", room.url, "--autopilot", room.autopilot, "--config", room.config]
    words += ["--signing-key", room.signing_key] if room.signing_key else []
    done = flightstack("preflight", *words, "--system-id", room.system_id, "--json")
    assert done.code == 0, done.out + done.err
    assert done.json


@pytest.mark.arms
def test_takes_off_holds_follows_set_points_and_lands(pilot, room):
    pilot.take_off()
    pilot.fly_for("settle", ZERO, 3.0)
    x, y, z = pilot.own.position_enu_m
    pilot.fly_for("hold", ZERO, 5.0)
    held = pilot.own.position_enu_m
    assert math.dist((x, y, z), held) < HOLD_M
    pilot.fly_for("north", (0.0, STEP_M_S, 0.0), STEP_S)
    moved = pilot.own.position_enu_m[1] - held[1]
    assert 0.4 < moved / (STEP_M_S * STEP_S) < 1.3, f"moved {moved:.2f} m"
    pilot.fly_for("stop", ZERO, 2.0)
    assert speed_m_s(pilot) < SLOW_M_S
    pilot.ask("land", Request.LAND, lambda: not pilot.status.armed, 30.0)
    assert pilot.status.landed is Landed.ON_GROUND
    assert pilot.max_height_m < room.takeoff_height_m + 0.5


@pytest.mark.arms
def test_emergency_stop_just_after_arming(pilot):
    pilot.ask("arm", Request.TAKEOFF, lambda: pilot.status.armed, 20.0)
    took_s = pilot.ask("stop", Request.MOTORS_OFF, lambda: not pilot.status.armed, 5.0)
    assert took_s < SAFE_S
    assert pilot.max_height_m < 0.3


@pytest.mark.arms
def test_a_companion_that_falls_silent_leaves_a_safe_vehicle(pilot):
    pilot.take_off()
    pilot.fly_for("on the way", (0.0, STEP_M_S, 0.0), 1.0)
    pilot.listen("silent", lambda: safe(pilot), SAFE_S)


def safe(pilot) -> bool:
    """Landing, down, or holding still: no longer flying what it was told last."""
    if not pilot.status.armed or pilot.status.mode is Mode.LAND:
        return True
    return speed_m_s(pilot) < SLOW_M_S


@pytest.mark.arms
def test_follows_and_lands_on_the_target(room):
    with companion(room) as flying:
        code = flying.ended(FLIGHT_MAX_S)
    assert code == 0, flying.said
    assert flying.said[-1].startswith("LANDED")
    assert down(room)


@pytest.mark.arms
@pytest.mark.parametrize("phase", ["TAKEOFF", "APPROACH", "LAND"])
def test_an_abort_brings_it_down_clear_of_the_target(room, phase):
    with companion(room) as flying:
        flying.until(f"-> {phase}", FLIGHT_MAX_S)
        flying.signal(signal.SIGINT)
        code = flying.ended(FLIGHT_MAX_S)
    assert code == 1, flying.said
    assert flying.said[-1].startswith("ABORT")
    assert down(room)


@pytest.mark.arms
@pytest.mark.parametrize("phase", ["TAKEOFF", "APPROACH", "LAND"])
def test_a_killed_companion_leaves_a_safe_vehicle(room, phase):
    with companion(room) as flying:
        flying.until(f"-> {phase}", FLIGHT_MAX_S)
        flying.signal(signal.SIGKILL)
        with Pilot(room) as pilot:
            pilot.connect()
            pilot.watch("safe state", lambda: safe(pilot), SAFE_S)


def down(room) -> bool:
    """Whether it stands with its motors off, soon."""
    with Pilot(room) as pilot:
        pilot.connect()
        pilot.watch("motors off", lambda: not pilot.status.armed, 20.0)
        return pilot.status.landed is Landed.ON_GROUND


# Of the suite itself, and of what only the simulated room can do.


@pytest.mark.simulated
@pytest.mark.parametrize("phase", ["TAKEOFF", "APPROACH", "LAND"])
def test_a_target_that_falls_silent_is_left_alone(room, phase):
    with companion(room) as flying:
        flying.until(f"-> {phase}", FLIGHT_MAX_S)
        room.target.process.kill()
        flying.until("-> HOLD", SAFE_S)
        assert flying.ended(FLIGHT_MAX_S) == 1
    assert down(room)


@pytest.mark.simulated
@pytest.mark.parametrize("phase", ["TAKEOFF", "APPROACH", "LAND"])
def test_a_cut_radio_leaves_a_safe_vehicle(room, phase):
    with Radio(room.url) as radio, companion(replace(room, url=radio.url)) as flying:
        flying.until(f"-> {phase}", FLIGHT_MAX_S)
        radio.cut()
        with Pilot(room) as pilot:
            pilot.connect()
            pilot.watch("safe state", lambda: safe(pilot), SAFE_S)
        flying.until("-> ABORT", HEARTBEAT_LOST_S + SAFE_S)
    assert down(room)


@pytest.mark.simulated
@pytest.mark.parametrize("fence", [Fence(0.25, 4.0), Fence(2.0, 0.3)], ids=["height", "distance"])
def test_a_step_beyond_the_fence_ends_on_the_ground(room, fence):
    with Pilot(replace(room, fence=fence)) as pilot:
        pilot.connect()
        with pytest.raises(AssertionError, match=r"m high|m away"):
            fly_away(pilot)
        assert not pilot.status.armed
        assert pilot.height_m < 0.1


def fly_away(pilot):
    pilot.take_off()
    pilot.fly_for("away", (STEP_M_S, 0.0, 0.0), 6.0)


@pytest.mark.simulated
def test_a_companion_beyond_the_fence_is_called_off(room):
    with companion(replace(room, fence=Fence(2.0, 0.3))) as flying:
        with pytest.raises(AssertionError, match="beyond Fence"):
            flying.ended(FLIGHT_MAX_S)
        assert "-> ABORT" in " ".join(flying.said)
    assert down(room)


def suite(room, *more):
    """The suite on a vehicle that is given: this simulated one."""
    words = ["--vehicle", room.url, "--config", room.config, "--target", room.target_key]
    words += ["--connect", room.connect[0], "--listen", room.listen, "--autopilot", room.autopilot, *more]
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", "tests/integration",
         *map(str, words)],
        cwd=ROOT, capture_output=True, text=True, timeout=WALL_MAX_S, check=False,
    )  # fmt: skip


@pytest.mark.simulated
def test_a_given_vehicle_arms_only_where_that_was_allowed(room):
    careful = suite(room, "--collect-only")
    assert "test_connects" in careful.stdout
    assert "test_follows" not in careful.stdout
    allowed = suite(room, "--collect-only", "--arm-ok")
    assert "test_follows" in allowed.stdout
    assert "silent_is_left_alone" not in allowed.stdout
    assert "test_mavsdk" not in allowed.stdout


@pytest.mark.simulated
def test_a_given_vehicle_is_flown(room):
    done = suite(room, "--arm-ok", "-k", "test_connects or test_follows")
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout
