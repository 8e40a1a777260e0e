"""Who may do what while one sender flies the vehicle by set-points."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.owner import Right
from bridge.mavlink.server.profile import FlightMode
from tests.unit.autopilot.autopilot_fakes import setpoint
from tests.unit.mavlink.server.served import (
    ACCEPTED,
    COMPANION,
    GROUND_STATION,
    HOLD,
    KILL,
    LAND,
    MAVSDK,
    NAN,
    OFFBOARD,
    REJECTED,
    STRANGER,
)

FOR_OWNER_ONLY = {
    400: [(0.0, 0.0), (1.0, 0.0)],
    176: [HOLD, OFFBOARD],
    22: [(*[NAN] * 6, 1.0)],
    20: [()],
    192: [(-1.0, 1.0)],
    179: [(1.0,)],
    246: [(1.0,)],
    420: [(101.0, 1.0)],
}


@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION])
def test_others_cannot_take_a_vehicle_that_is_flown(flown, sender) -> None:
    table = flown.server.commands.table
    owned = {number for number, entry in table.items() if entry.right is Right.OWNER}
    assert owned <= set(FOR_OWNER_ONLY)
    for number in owned:
        for params in FOR_OWNER_ONLY[number]:
            assert flown.command(number, *params, sender=sender) == REJECTED, number
        assert flown.texts() == [f"Command {number} refused: 1/191 has control"]
        assert flown.mode is FlightMode.OFFBOARD
        assert flown.armed


def test_that_holds_in_every_mode_while_the_stream_lives(flown) -> None:
    assert flown.command(176, *HOLD) == ACCEPTED
    flown.run(0.1, (0.0, 0.0, 0.0))
    assert flown.command(22, *[NAN] * 6, 1.0, sender=GROUND_STATION) == REJECTED
    assert flown.command(22, *[NAN] * 6, 1.0) == ACCEPTED


@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION])
@pytest.mark.parametrize("land", [(21, ()), (176, LAND)])
def test_everybody_may_land_it(flown, sender, land) -> None:
    assert flown.command(land[0], *land[1], sender=sender) == ACCEPTED
    assert flown.mode is FlightMode.LAND


def test_set_mode_message_follows_the_same_rule(flown) -> None:
    flown.handle(mav.MAVLink_set_mode_message(1, 1, 0x03040000), STRANGER)
    assert flown.mode is FlightMode.OFFBOARD
    assert flown.texts()[-1] == "Mode refused: 1/191 has control"
    flown.handle(mav.MAVLink_set_mode_message(1, 1, 0x06040000), STRANGER)
    assert flown.mode is FlightMode.LAND


@pytest.mark.parametrize("kill", [(400, KILL), (185, (1.0,))])
@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION, MAVSDK])
def test_ground_stations_may_stop_the_motors_and_strangers_may_not(flown, kill, sender) -> None:
    number, params = kill
    assert flown.command(number, *params, sender=sender) == (REJECTED if sender == STRANGER else ACCEPTED)
    assert flown.armed is (sender == STRANGER)


def test_parameters_of_a_flown_vehicle_belong_to_its_owner_too(flown) -> None:
    message = mav.MAVLink_param_set_message(1, 1, b"MAV_TYPE", 0.8, mav.MAV_PARAM_TYPE_REAL32)
    error, _ = flown.handle(message, STRANGER)
    assert error.error == mav.MAV_PARAM_ERROR_PERMISSION_DENIED
    assert flown.texts()[-1] == "MAV_TYPE refused: 1/191 has control"


def test_questions_are_free(flown) -> None:
    for number, params in ((512, (148.0,)), (510, (30.0,)), (410, ()), (520, (1.0,))):
        assert flown.command(number, *params, sender=STRANGER) == ACCEPTED


def test_rates_may_be_raised_by_all_but_lowered_only_by_the_owner(flown) -> None:
    assert flown.command(511, 31.0, 10_000.0, sender=STRANGER) == ACCEPTED
    assert flown.command(511, 30.0, 20_000.0, sender=STRANGER) == REJECTED
    assert flown.command(511, 32.0, -1.0, sender=GROUND_STATION) == REJECTED
    assert flown.command(511, 30.0, 20_000.0) == ACCEPTED


def test_set_points_of_another_sender_are_dropped_with_one_text(flown) -> None:
    for _ in range(20):
        flown.handle(setpoint(0.1))
        flown.handle(setpoint(0.0, 0.5), STRANGER)
        flown.tick()
        assert flown.velocity_enu_m_s == pytest.approx((0.0, 0.1, 0.0))
    assert flown.texts() == ["Set-point dropped: 1/191 has control"]


def test_control_passes_on_when_the_owner_is_silent(flown) -> None:
    flown.run(flown.silence_s - 0.1)
    assert flown.command(176, *HOLD, sender=STRANGER) == REJECTED
    flown.run(0.15)
    assert flown.command(176, *HOLD, sender=STRANGER) == ACCEPTED
    assert flown.mode is FlightMode.HOLD


def test_control_passes_on_when_it_is_disarmed(flown) -> None:
    assert flown.command(400, *KILL) == ACCEPTED
    assert not flown.armed
    flown.handle(setpoint(0.0), COMPANION)
    assert flown.command(176, *HOLD, sender=STRANGER) == ACCEPTED  # nobody owns what stands disarmed
