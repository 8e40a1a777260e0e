"""What is told of the battery and the links to people who watch."""

import math
from typing import NamedTuple

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.client.vehicle_state import Battery, VehicleState
from bridge.mavlink.profiles.autopilots import PX4
from flightstack.common.pacing import Tick
from flightstack.core.snapshot import Snapshot
from flightstack.core.types import Inputs, Landed, Mode, OwnState, VehicleStatus
from flightstack.onboard.publish_ros2 import BATTERY_AGE_MAX_S, health_row

NOW_S = 20.0
TICK = Tick(2000, NOW_S, 1_700_000_000_000_000_000, 0.01, 0.0, overruns=3)


class Out(NamedTuple):
    """As much of a controller's outputs as is looked at."""

    seen: Snapshot
    finished: bool = False
    target_accepted: int = 5
    target_rejected: int = 6


def view(**inputs):
    return Snapshot(Inputs(**inputs), None, own_ok=True, target_ok=False, link_ok=True, e_m=None)


def row(out, battery=None):
    return health_row(TICK, out, "because", battery, 4)


def test_ages_are_of_now_and_what_never_came_is_no_number():
    own = OwnState(NOW_S - 0.03, 1.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0)
    status = VehicleStatus(
        NOW_S - 0.7, armed=True, mode=Mode.EXTERNAL, landed=Landed.IN_AIR, ready_to_arm=True
    )
    found = row(Out(view(own=own, status=status)))
    assert found.own_age_s == pytest.approx(0.03)
    assert found.link_age_s == pytest.approx(0.7)
    assert math.isnan(found.target_age_s)
    assert (found.armed, found.mode, found.landed) == (True, Mode.EXTERNAL, Landed.IN_AIR)
    assert (found.own_valid, found.target_valid, found.link_valid) == (True, False, True)
    assert (found.overruns, found.feed_dropped, found.reason) == (3, 4, "because")
    nothing = row(Out(view()))
    assert all(map(math.isnan, (nothing.own_age_s, nothing.target_age_s, nothing.link_age_s)))
    assert (nothing.armed, nothing.mode) == (False, Mode.UNKNOWN)


@pytest.mark.parametrize(
    ("age_s", "known"), [(0.0, True), (BATTERY_AGE_MAX_S, True), (BATTERY_AGE_MAX_S + 0.1, False)]
)
def test_an_old_battery_state_is_none(age_s, known):
    found = row(Out(view()), Battery(NOW_S - age_s, 3.8, 0.5))
    if known:
        assert (found.battery_v, found.battery_share) == (3.8, 0.5)
    else:
        assert math.isnan(found.battery_v)
        assert math.isnan(found.battery_share)


@pytest.mark.parametrize(
    ("millivolts", "percent", "expected"),
    [(3870, 90, (3.87, 0.9)), (0xFFFF, -1, (None, None)), (0, 0, (0.0, 0.0))],
)
def test_the_battery_as_sys_status_says_it(millivolts, percent, expected):
    state = VehicleState(PX4)
    assert state.battery is None
    message = mav.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, -1, percent, 0, 0, 0, 0, 0, 0)
    state.update(message, 7.0)
    assert state.battery == Battery(7.0, *expected)
