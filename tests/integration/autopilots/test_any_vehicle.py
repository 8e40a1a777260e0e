"""Tests for any vehicle: the simulated vehicle, a vehicle by ``--vehicle URL --target KEY``, or ``--px4``.

Each step limits height, distance and time; a vehicle outside the limits is landed. A given vehicle is armed
only with ``--arm-ok``; see docs/how_to/hardware.md.
"""

from __future__ import annotations

import math
import signal
from dataclasses import replace

import pytest

from flightstack.core.types import ZERO, Landed, Mode, Request
from tests.flight_suite.companion import companion
from tests.flight_suite.pilot import Pilot
from tests.flight_suite.room import Fence, Lost, given, on_px4, simulated
from tests.integration.runs import flightstack

pytestmark = pytest.mark.vehicle
STANDING_M_S = 0.15  # estimated speed up to which a vehicle counts as standing, m/s
STOPPED_S = 2.0  # time-out from the emergency stop to motors off, s
AWAY_M_S = 0.3  # speed at which the pilot flies away from the start, m/s
FLIGHT_MAX_S = 90.0
LANDED_MAX_S = 40.0  # time-out from the loss of the companion until the vehicle has stopped the motors, s


@pytest.fixture
def room(request, tmp_path, flight_number):
    option = request.config.getoption
    if option("--vehicle") is not None:
        where = given(request.config, tmp_path)
    elif option("--px4") is not None:
        where = on_px4(
            tmp_path, option("--px4"), option("--scenario"), flight_number, speed=option("--speed")
        )
    else:
        where = simulated(tmp_path)
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
    assert pilot.link.state.counters["other_autopilot"] == 0
    assert speed_m_s(pilot) < STANDING_M_S


@pytest.mark.given  # a test in test_autopilots.py covers the simulated vehicle
def test_its_parameters_are_safe(room):
    words = ["--vehicle", room.url, "--autopilot", room.autopilot, "--config", room.config]
    words += ["--signing-key", room.signing_key] if room.signing_key else []
    done = flightstack("preflight", *words, "--system-id", room.system_id, "--json")
    assert done.code == 0, done.out + done.err
    assert done.json


@pytest.mark.arms
def test_takes_off_holds_follows_set_points_and_lands(pilot, room):
    limits = pilot.limits
    pilot.take_off()
    pilot.fly_for("settle", ZERO, limits.settle_s)
    begun = pilot.own.position_enu_m
    pilot.fly_for("hold", ZERO, 5.0)
    held = pilot.own.position_enu_m
    assert math.dist(begun, held) < limits.drift_m
    pilot.fly_for("north", (0.0, limits.step_m_s, 0.0), limits.step_s)
    turned = pilot.own.position_enu_m
    pilot.fly_for("south", (0.0, -limits.step_m_s, 0.0), limits.step_s)
    back = pilot.own.position_enu_m
    moved_m = (2.0 * turned[1] - held[1] - back[1]) / 2.0  # without the effect of a constant drift
    least, most = limits.moved_share
    assert least < moved_m / (limits.step_m_s * limits.step_s) < most, f"moved {moved_m:.2f} m"
    pilot.fly_for("stop", ZERO, 2.0)
    assert speed_m_s(pilot) < limits.still_m_s
    pilot.ask("land", Request.LAND, lambda: not pilot.status.armed, 30.0)
    assert pilot.status.landed is Landed.ON_GROUND
    assert pilot.max_height_m < room.takeoff_height_m + 0.5


@pytest.mark.arms
def test_emergency_stop_just_after_arming(pilot):
    pilot.rise("arm", lambda: pilot.status.armed, 20.0)
    took_s = pilot.ask("stop", Request.MOTORS_OFF, lambda: not pilot.status.armed, 5.0)
    assert took_s < STOPPED_S
    assert pilot.max_height_m < 0.3


@pytest.mark.arms
def test_a_companion_that_falls_silent_leaves_a_safe_vehicle(pilot):
    pilot.take_off()
    pilot.fly_for("on the way", (0.0, pilot.limits.step_m_s, 0.0), 1.0)
    pilot.listen("silent", lambda: safe(pilot), pilot.limits.lost_s)
    if pilot.limits.lost is Lost.LANDS:
        pilot.listen("landing", lambda: stands(pilot), LANDED_MAX_S)


def safe(pilot) -> bool:
    """Whether the fail-safe has acted: the vehicle lands, is disarmed, or stands still (``Lost.STOPS``)."""
    if not pilot.status.armed or pilot.status.mode is Mode.LAND:
        return True
    return pilot.limits.lost is Lost.STOPS and speed_m_s(pilot) < pilot.limits.still_m_s


def stands(pilot) -> bool:
    """Whether the vehicle is on the ground with its motors off."""
    return not pilot.status.armed and pilot.status.landed is Landed.ON_GROUND


@pytest.mark.given  # a test in test_fly.py covers the simulated vehicle
@pytest.mark.arms
def test_follows_and_lands_on_the_target(room):
    with companion(room) as flying:
        code = flying.ended(FLIGHT_MAX_S)
    assert code == 0, flying.said
    assert flying.said[-1].startswith("LANDED")
    assert down(room)


# with the simulated vehicle, the fault grid and test_stops.py cover the other phases
@pytest.mark.arms
@pytest.mark.parametrize(
    "phase", ["TAKEOFF", *(pytest.param(p, marks=pytest.mark.given) for p in ("APPROACH", "LAND"))]
)
def test_an_abort_brings_it_down_clear_of_the_target(room, phase):
    with companion(room) as flying:
        flying.until(f"-> {phase}", FLIGHT_MAX_S)
        flying.signal(signal.SIGINT)
        code = flying.ended(FLIGHT_MAX_S)
    assert code == 1, flying.said
    assert flying.said[-1].startswith("ABORT")
    assert down(room)


@pytest.mark.arms
@pytest.mark.parametrize(
    "phase", [*(pytest.param(p, marks=pytest.mark.given) for p in ("TAKEOFF", "APPROACH")), "LAND"]
)
def test_a_killed_companion_leaves_a_safe_vehicle(room, phase):
    with companion(room) as flying:
        flying.until(f"-> {phase}", FLIGHT_MAX_S)
        flying.kill()
        left_alone(room)


def left_alone(room) -> None:
    """Observe a vehicle that gets no set-points, until it is in a safe state."""
    with Pilot(room) as pilot:
        pilot.connect()
        pilot.watch("safe state", lambda: safe(pilot), pilot.limits.lost_s)
        if pilot.limits.lost is Lost.LANDS:
            pilot.watch("landing", lambda: stands(pilot), LANDED_MAX_S)


def down(room) -> bool:
    """Wait until the motors are off; return whether the vehicle is on the ground."""
    with Pilot(room) as pilot:
        pilot.connect()
        pilot.watch("motors off", lambda: not pilot.status.armed, 20.0)
        return pilot.status.landed is Landed.ON_GROUND


# Tests of the suite itself, and tests that need the simulated vehicle.


@pytest.mark.simulated
def test_a_step_beyond_the_fence_ends_on_the_ground(room):
    for fence, said in ((Fence(2.0, 0.3), "m away"), (Fence(0.25, 4.0), "m high")):
        with Pilot(replace(room, fence=fence)) as pilot:
            pilot.connect()
            with pytest.raises(AssertionError, match=said):
                fly_away(pilot)
            assert not pilot.status.armed
            assert pilot.height_m < 0.1


def fly_away(pilot):
    pilot.take_off()
    pilot.fly_for("away", (AWAY_M_S, 0.0, 0.0), 6.0)


@pytest.mark.simulated
def test_a_companion_beyond_the_fence_is_called_off(room):
    with companion(replace(room, fence=Fence(2.0, 0.3))) as flying:
        with pytest.raises(AssertionError, match="beyond Fence"):
            flying.ended(FLIGHT_MAX_S)
        assert "-> ABORT" in " ".join(flying.said)
    assert down(room)
