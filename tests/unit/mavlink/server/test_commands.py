"""Tests all command tables: both encodings, repeated commands, rejections and addresses."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.telemetry import degrees_e7
from tests.unit.mavlink.server.served import (
    ACCEPTED,
    DENIED,
    HOLD,
    NAN,
    NAN7,
    OFFBOARD,
    UNSUPPORTED,
    Served,
    as_int,
    as_long,
)

NEAR = tuple(v / 1e7 for v in degrees_e7(1.0, 2.0))  # latitude, longitude, degrees
# Parameters to test for each command; every command of each table must be here.
CASES: dict[int, list[tuple[float, ...]]] = {
    20: [NAN7],
    21: [NAN7, (0.0,) * 7],
    22: [NAN7, (*NAN7[:6], 0.7), (*NAN7[:6], 100.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.6)],
    176: [OFFBOARD, HOLD, (1.0, 4.0, 5.0), (1.0, 4.0, 2.0), (1.0, 4.0, 6.0), (1.0, 3.0), (0.0, 4.0, 3.0)],
    185: [(1.0,), (0.0,), NAN7],
    192: [(-1.0, 1.0), (-1.0, 1.0, 0.0, NAN, *NEAR, 1.5), (-1.0, 1.0, 0.0, NAN, NAN, NAN, 1.2), (-1.0, 0.0)],
    246: [(0.0,), (1.0,), (2.0,), NAN7],
    400: [(1.0, 0.0), (0.0, 0.0), (0.0, 21196.0), (1.0, 21196.0), (0.5,), NAN7],
    401: [NAN7],
    420: [(101.0, 1.0, 2.0), (101.5, 1.0), (101.0, 1.0, -1.0), NAN7],
    510: [(32.0,), (0.0,), NAN7],
    511: [(32.0, 50_000.0), (331.0, -1.0), (30.0, 0.0), (30.0,), (0.0, 1e6), (32.5, 1e6), NAN7],
    512: [(148.0,), (0.0,), (435.0,), (300.0,), NAN7],
    521: [(1.0,)],
}
SITUATIONS = ("disarmed", "homed", "fly", "offboard")


def outcome(served: Served, message) -> tuple[list[object], list[object]]:
    replies = served.handle(message)
    return [r.result if r.get_type() == "COMMAND_ACK" else r.get_type() for r in replies], served.state()


def test_every_command_of_the_table_has_cases(numbers) -> None:
    assert numbers <= set(CASES)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_both_encodings_give_the_same_result_and_state(fresh, situation: str) -> None:
    for number in CASES:
        for params in CASES[number]:
            first, second = fresh(situation), fresh(situation)
            long = outcome(first, as_long(number, params))
            assert outcome(second, as_int(number, params)) == long, params
            assert first.texts() == second.texts(), params


@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_command_that_comes_again_changes_nothing_and_is_answered_alike(
    fresh, user, situation: str
) -> None:
    for number in CASES:
        for params in CASES[number]:
            served = fresh(situation)
            result, after = outcome(served, as_long(number, params))
            again, later = outcome(served, as_long(number, params))
            if number == 185 and result == [ACCEPTED] and user == "px4":
                assert again == [DENIED]  # PX4 terminates only armed vehicles
            else:
                assert again == result, params
            if number != 246:  # 246 is a restart; the second restart also changes the vehicle
                assert later == after, params


@pytest.mark.parametrize("situation", SITUATIONS)
def test_every_refusal_gives_a_reason(fresh, numbers, situation: str) -> None:
    for number, cases in CASES.items():
        for params in cases:
            served = fresh(situation)
            result = served.handle(as_long(number, params))[0].result
            assert (result == UNSUPPORTED) >= (number not in numbers)
            assert bool(served.texts()) or result == ACCEPTED, (number, params)


def test_places_in_other_frames_are_denied(fresh) -> None:
    flying = fresh("fly")
    placed = [number for number, entry in flying.server.commands.table.items() if entry.place]
    assert 22 in placed
    for number in placed:
        for frame in (1, 2, 8, 10, 200):
            message = as_int(number, (1.0, 1.0, NAN, NAN, *NEAR, 1.0), frame)
            assert flying.handle(message)[0].result == DENIED
            assert f"frame {frame}" in flying.texts()[-1]
            flying.run(0.3)


@pytest.mark.parametrize("number", [31000, 9, 252, 241])
def test_unknown_commands_are_unsupported(served, number: int) -> None:
    assert served.command(number) == UNSUPPORTED
    assert served.texts() == [f"Command {number} is not supported"]


@pytest.mark.parametrize("target", [(2, 1), (1, 50), (0, 1), (0, 0)])
def test_commands_for_others_are_not_even_answered(served, target: tuple[int, int]) -> None:
    assert served.command(400, 1.0, target=target) is None
    served.run(0.2)
    assert not served.armed


def test_component_zero_means_us_and_system_zero_may_ask_who_is_there(served) -> None:
    assert served.command(400, 1.0, target=(1, 0)) == ACCEPTED
    assert served.command(512, 148.0, target=(0, 0)) == ACCEPTED


def test_infinite_parameters_and_nan_disguised_as_an_integer_are_denied(served) -> None:
    assert served.command(22, *[NAN] * 6, math.inf) == DENIED
    nan_int = mav.MAVLink_command_int_message(
        1, 1, 0, 22, 0, 0, NAN, NAN, NAN, NAN, 0x7FF80000, 0x7FF80000, 1.0
    )
    assert served.handle(nan_int)[0].result == DENIED
    assert served.mode is FlightMode.HOLD


@pytest.mark.parametrize(("main", "sub"), [(1, 0), (7, 2), (4, 4), (9, 9)])
def test_modes_there_are_not_are_denied_with_those_that_there_are(served, main: int, sub: int) -> None:
    word = f"Mode {main}/{sub} refused: only hold, take-off, land, offboard"
    assert served.command(176, 1.0, float(main), float(sub)) == DENIED
    assert word in served.texts()[-1]
    served.run(1.0)
    served.handle(mav.MAVLink_set_mode_message(1, 1, main << 16 | sub << 24))
    assert word in served.texts()[-1]
    assert served.mode is FlightMode.HOLD
    assert served.command(176, 0.0, 4.0, 3.0) == DENIED  # the flag for custom modes is missing
