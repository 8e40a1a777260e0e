"""Options of the tests."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import hypothesis
import pytest

from bridge.mavlink.profiles.autopilots import AUTO, CHOICES
from flightstack.config.files import path_of
from tests.flight_suite.room import PROFILES
from tests.overdue import pytest_exception_interact as pytest_exception_interact
from tests.overdue import pytest_runtest_logfinish as pytest_runtest_logfinish
from tests.overdue import pytest_runtest_logstart as pytest_runtest_logstart
from tests.overdue import pytest_sessionfinish as pytest_sessionfinish
from tests.overdue import pytest_sessionstart as pytest_sessionstart
from tests.pauses import in_real_time
from tests.pauses import pytest_runtest_protocol as pytest_runtest_protocol
from tests.quick import mark_slow
from tests.quick import pytest_runtest_call as pytest_runtest_call
from tests.quick import pytest_runtest_setup as pytest_runtest_setup

# Workers that fly in real time: two cores carry three, as other workers give way; two where a core is slow
STREAMS_SET = "FLIGHTSTACK_TEST_STREAMS"  # environment: told to the workers
STREAMS = int(os.environ.get(STREAMS_SET, "2"))
QUICK_S = (
    0.0065  # of processor time for a loop; this takes 0.0042 where three were tried, at a load of 13 to 30
)
# s of wall time of tests in real time that take long; the others: OTHERS_S
TAKES_S = {
    "test_arducopters_program_is_started_and_flown_over_tcp": 50,
    "test_flights_in_a_row_land": 45,
    "test_three_kinds_of_vehicles_hear_each_other_land_and_replay": 60,
    "test_three_kinds_cross_land_and_replay": 60,
    "test_one_command_lands_a_real_px4_and_its_log_knows_the_truth": 40,
    "test_the_commands_that_fly_in_real_time": 40,
    "test_the_target_is_landed_on": 35,
    "test_a_given_vehicle_is_flown": 30,
    "test_make_fly_lands": 30,
    "test_the_parts_apart_land": 28,
    "test_a_process_that_is_killed_in_flight_harms_nobody": 27,
    "test_a_target_that_falls_silent_is_left_alone": 25,
    "test_lands_records_judges_and_reports": 25,
    "test_follows_and_lands_on_the_target": 24,
    "test_real_time_landing_after_the_check": 24,
    "test_takes_off_holds_follows_set_points_and_lands": 24,
    "test_an_abort_brings_it_down_clear_of_the_target": 22,
    "test_whole_flight": 22,
    "test_whole_flight_as_arducopter": 22,
    "test_a_companion_beyond_the_fence_is_called_off": 20,
    "test_ctrl_c_flies_clear_and_lands_before_anything_ends": 20,
    "test_without_a_log_the_onboard_process_is_believed_and_nothing_measured": 20,
    "test_a_cut_radio_leaves_a_safe_vehicle": 19,
    "test_documented_example": 18,
    "test_a_kill_costs_half_a_second_of_the_log_at_most": 18,
    "test_refused_arming_has_a_reason_that_mavsdk_shows": 16,
    "test_a_killed_companion_leaves_a_safe_vehicle": 14,
    "test_in_real_time_the_deck_follows_the_robot_and_the_truth_is_recorded": 14,
    "test_second_client_does_not_take_over": 14,
    "test_signed_flight": 14,
    "test_motors_stop_in_the_air_when_asked_to": 11,
}
OTHERS_S = 4.0
STREAM_NAMES = [f"stream {number}" for number in range(STREAMS)]  # the first has the flights of a real PX4

# A shell's background job ignores Ctrl-C, and so would all that the tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # and what nohup starts ignores a closed terminal

# A busy machine is no failure, and the same code passes or fails each time. Others are looked for by
# pytest --hypothesis-profile="new examples"
hypothesis.settings.register_profile("new examples", deadline=None)
hypothesis.settings.register_profile("same examples", deadline=None, derandomize=True)
hypothesis.settings.load_profile("same examples")


def pytest_addoption(parser: pytest.Parser) -> None:
    add = parser.addoption
    add("--quick", action="store_true", help="fail a test that is slow and not marked so")
    add("--flights", type=int, default=1, metavar="N", help="fly each flight of a real client N times")
    add("--vehicle", metavar="URL", help="fly this vehicle and no other: only the tests that can are run")
    add("--px4", type=Path, metavar="PLACE", help="fly this PX4 SITL, by px4-sim, and no other vehicle")
    add("--scenario", default="large", metavar="NAME_OR_FILE", help="scenario of --px4")
    add("--speed", type=float, default=1.0, metavar="X", help="speed of --px4 against real time")
    add("--target", default="cf1/target/odom", metavar="KEY", help="Zenoh key of its target's odometry")
    add(
        "--target-offset", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "Z"),
        help="landing spot from the target's tracked frame, in that frame's axes, m: forward, left, up",
    )  # fmt: skip
    add("--connect", action="append", default=[], metavar="ENDPOINT", help="Zenoh endpoint of the target")
    add("--listen", metavar="ENDPOINT", help="Zenoh endpoint of the onboard process")
    add("--config", type=path_of, metavar="NAME_OR_FILE", help="configuration of the onboard process")
    add("--autopilot", default=AUTO, choices=CHOICES, help="profile of the vehicle; auto: by its heartbeat")
    add("--system-id", type=int, default=1, metavar="N", help="of the vehicle")
    add("--signing-key", type=Path, metavar="FILE", help="sign MAVLink with it")
    add("--takeoff-height", type=float, default=0.5, metavar="M", help="height of the steps without a target")
    add(
        "--fence", type=float, nargs=2, default=(2.0, 4.0), metavar=("HEIGHT_M", "DISTANCE_M"),
        help="a step beyond it ends, and the vehicle is brought down",
    )  # fmt: skip
    add("--arm-ok", action="store_true", help="the vehicle given may arm and fly: somebody watches it")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: needs more processor time than `make quick` allows a test")
    config.addinivalue_line("markers", "vehicle: flies our simulated vehicle, or the one of --vehicle")
    config.addinivalue_line("markers", "arms: not run on a vehicle that was given without --arm-ok")
    config.addinivalue_line("markers", "simulated: needs the simulated room")
    config.addinivalue_line("markers", "xdist_group(name): run by one worker, also where there is no xdist")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One for each stream of flights in real time, which mostly wait; one for each core, which gives way."""
    del config
    streams = 3 if min(_loop_s() for _ in range(20)) < QUICK_S else 2
    os.environ[STREAMS_SET] = str(streams)
    return streams + (os.cpu_count() or 1)


def _loop_s() -> float:
    """Processor time of some Python."""
    began_s = time.process_time()
    sum(number * number for number in range(200_000))
    return time.process_time() - began_s


@pytest.hookimpl(tryfirst=True)  # before the workers look at the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A vehicle that was given is flown by the tests made for it, and armed only where that was allowed."""
    mark_slow(items)
    px4 = config.getoption("--px4") is not None
    if config.getoption("--vehicle") is None and not px4:
        items[:] = [item for item in items if not _flown_otherwise(item)]
        if config.getoption("--flights") == 1:
            _deal_out(items)
        return
    arm_ok = px4 or config.getoption("--arm-ok")

    def runs(item: pytest.Item) -> bool:
        flies = _marked(item, "vehicle") and not _marked(item, "simulated")
        return flies and (arm_ok or not _marked(item, "arms"))

    left_out = [item for item in items if not runs(item)]
    items[:] = [item for item in items if runs(item)]
    config.hook.pytest_deselected(items=left_out)


def _deal_out(items: list[pytest.Item]) -> None:
    """Give the flights in real time to the streams so that these end at one time, the longest tests first.

    Tests that share a flight name their stream themselves.
    """
    load_s = dict.fromkeys(STREAM_NAMES, 0.0)
    free = []
    for item in items:
        if _marked(item, "vehicle"):
            item.add_marker(pytest.mark.xdist_group("real-time"))
        if in_real_time(item):
            named = [name for name in STREAM_NAMES if any(name in mark.args for mark in item.iter_markers())]
            if named:
                load_s[named[0]] += _takes_s(item)
            else:
                free.append(item)
    for item in sorted(free, key=_takes_s, reverse=True):
        least = min(load_s, key=load_s.__getitem__)
        load_s[least] += _takes_s(item)
        item.add_marker(pytest.mark.xdist_group(least))


def _takes_s(item: pytest.Item) -> float:
    """Wall time of a test in real time, as measured once."""
    return TAKES_S.get(item.name.partition("[")[0], OTHERS_S)


def _flown_otherwise(item: pytest.Item) -> bool:
    """What is shown by another test: of the suite itself, of the grid of faults, or as the other autopilot.

    One server profile flies the first phase, the other one the last.
    """
    given = item.callspec.params if hasattr(item, "callspec") else {}
    if "server_profile" not in given:
        return False
    first = given["server_profile"] == next(iter(PROFILES))
    if item.name.startswith("test_follows") and first:
        return True  # by test_a_given_vehicle_is_flown
    return "phase" in given and given["phase"] != ("TAKEOFF" if first else "LAND")


def _marked(item: pytest.Item, name: str) -> bool:
    """Whether a test has this marker; its keywords hold the values of its parameters, too."""
    return item.get_closest_marker(name) is not None


def pytest_make_parametrize_id(config: pytest.Config, val: object) -> str | None:
    """A frame or payload by its length: its bytes say nothing to a reader of names."""
    del config
    return f"{len(val)} bytes" if isinstance(val, bytes) else None


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with an argument ``flight_number`` is a whole flight and can be repeated."""
    config = metafunc.config
    if "flight_number" in metafunc.fixturenames:
        metafunc.parametrize("flight_number", range(config.getoption("--flights")))
    if "server_profile" in metafunc.fixturenames:
        metafunc.parametrize("server_profile", _server_profiles(metafunc))


def _server_profiles(metafunc: pytest.Metafunc) -> list[str]:
    option = metafunc.config.getoption
    if option("--px4") is not None:
        return ["real-px4"]
    if option("--vehicle") is not None:
        return [option("--autopilot")]
    # what tries the room rather than the vehicle needs one server profile only
    return list(PROFILES)[: 1 if metafunc.definition.get_closest_marker("simulated") else None]
