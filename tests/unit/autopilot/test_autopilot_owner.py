"""Who may do what while somebody flies the vehicle by set-points."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from tests.unit.autopilot.autopilot_fakes import (
    COMPANION,
    GROUND_STATION,
    HOLD,
    NAN,
    OFFBOARD,
    Rig,
    set_real,
    setpoint,
)

MAVSDK = (245, 190)
STRANGER = (1, 190)
ACCEPTED, REJECTED = 0, 1
FOR_OWNER_ONLY = [
    (400, (0.0, 0.0)),
    (400, (1.0, 0.0)),
    (176, HOLD),
    (176, OFFBOARD),
    (22, (*[NAN] * 6, 1.0)),
    (20, ()),
    (192, (-1.0, 1.0)),
    (179, (1.0,)),
    (246, (1.0,)),
    (420, (101.0, 1.0)),
]


@pytest.mark.parametrize(("number", "params"), FOR_OWNER_ONLY)
@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION])
def test_others_cannot_take_a_vehicle_that_is_flown(number: int, params, sender) -> None:
    rig = Rig().offboard()
    rig.run(0.1, (0.1, 0.0, 0.0))
    rig.texts()
    assert rig.command(number, *params, sender=sender) == REJECTED
    assert rig.texts() == [f"Command {number} refused: 1/191 has control"]
    assert rig.mode is FlightMode.OFFBOARD
    assert rig.vehicle.armed


def test_that_holds_in_every_mode_while_the_stream_lives() -> None:
    rig = Rig().offboard()
    rig.command(176, *HOLD)
    rig.run(0.1, (0.0, 0.0, 0.0))
    assert rig.command(20, sender=GROUND_STATION) == REJECTED
    assert rig.command(20, sender=COMPANION) == ACCEPTED


@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION])
@pytest.mark.parametrize("land", [(21, ()), (176, (1.0, 4.0, 6.0))])
def test_everybody_may_land_it(sender, land) -> None:
    rig = Rig().offboard()
    assert rig.command(land[0], *land[1], sender=sender) == ACCEPTED
    assert rig.mode is FlightMode.LAND


def test_set_mode_message_follows_the_same_rule() -> None:
    rig = Rig().offboard()
    rig.handle(mav.MAVLink_set_mode_message(1, 1, 0x03040000), STRANGER)
    assert rig.mode is FlightMode.OFFBOARD
    assert rig.texts()[-1] == "Mode refused: 1/191 has control"
    rig.handle(mav.MAVLink_set_mode_message(1, 1, 0x06040000), STRANGER)
    assert rig.mode is FlightMode.LAND


@pytest.mark.parametrize("kill", [(400, (0.0, 21196.0)), (185, (1.0,))])
def test_ground_stations_may_stop_the_motors_and_strangers_may_not(kill) -> None:
    number, params = kill
    for sender, result in ((STRANGER, REJECTED), (GROUND_STATION, ACCEPTED), (MAVSDK, ACCEPTED)):
        rig = Rig().offboard()
        assert rig.command(number, *params, sender=sender) == result
        assert rig.vehicle.armed is (result == REJECTED)


def test_parameters_of_a_flown_vehicle_belong_to_its_owner_too() -> None:
    rig = Rig().offboard()
    message = mav.MAVLink_param_set_message(1, 1, b"MPC_LAND_SPEED", 0.8, mav.MAV_PARAM_TYPE_REAL32)
    assert rig.handle(message, STRANGER)[-1].param_value == pytest.approx(0.3)
    assert rig.texts()[-1] == "MPC_LAND_SPEED refused: 1/191 has control"
    assert set_real(rig, "MPC_LAND_SPEED", 0.7) == pytest.approx(0.7)


def test_questions_are_free() -> None:
    rig = Rig().offboard()
    for number, params in ((512, (148.0,)), (510, (30.0,)), (410, ()), (520, (1.0,))):
        assert rig.command(number, *params, sender=STRANGER) == ACCEPTED


def test_rates_may_be_raised_by_all_but_lowered_only_by_the_owner() -> None:
    rig = Rig().offboard()
    assert rig.command(511, 331.0, 20_000.0, sender=STRANGER) == ACCEPTED
    assert rig.command(511, 30.0, 20_000.0, sender=STRANGER) == REJECTED
    assert rig.command(511, 32.0, -1.0, sender=GROUND_STATION) == REJECTED
    assert rig.command(511, 30.0, 20_000.0, sender=COMPANION) == ACCEPTED


def test_control_passes_on_when_the_owner_is_silent_or_disarmed() -> None:
    rig = Rig().offboard()
    rig.run(0.4)
    assert rig.command(20, sender=STRANGER) == REJECTED
    rig.run(0.2)  # the fail-safe lands it now
    assert rig.command(176, *HOLD, sender=STRANGER) == ACCEPTED
    assert rig.mode is FlightMode.HOLD
    rig = Rig().offboard()
    rig.command(400, 0.0, 21196.0)
    assert not rig.vehicle.armed
    rig.handle(setpoint(0.0))
    assert rig.command(176, *HOLD, sender=STRANGER) == ACCEPTED  # nobody owns what stands disarmed
