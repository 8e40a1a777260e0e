"""Tests the messages during a wait: a message names the cause of the wait, and the key with its limit."""

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import pytest

from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import Role
from flightstack.common.pacing import Tick
from flightstack.config import load
from flightstack.config.options import OnboardOptions
from flightstack.core.memory import Memory
from flightstack.core.parameters.flight import FlightConfig, Retreat
from flightstack.core.safety.barrier import Barrier
from flightstack.core.snapshot import Snapshot
from flightstack.core.target.track import TargetState
from flightstack.core.types import Inputs, Landed, Mode, OwnState, Phase, VehicleStatus
from flightstack.onboard.log import health_row
from flightstack.onboard.waiting import WaitReport, countdown
from flightstack.onboard.zenoh_wires import ZenohWires
from tests.integration.runs import called
from tests.processes.ports import free_endpoint, free_port
from tests.unit.target import ros2_helpers as ros

NOW_S = 20.0
STANDS = VehicleStatus(NOW_S - 0.5, False, Mode.HOLD, Landed.ON_GROUND, True)
NOT_READY = replace(STANDS, ready_to_arm=False)
OWN = OwnState(NOW_S - 0.01, 1.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0)
TARGET = TargetState(0.02, (1.0, 0.0, 0.2), (0.0, 0.0, 0.0), 0.0)


def waiting(counts=(), battery=1, refused=0, told=(), keys=()):
    """Return a wait report with these counters, and with these texts of vehicle and target."""
    state = SimpleNamespace(counters=Counter(dict.fromkeys(counts, 9)), battery=battery)
    endpoint = SimpleNamespace(counters=Counter())
    link = SimpleNamespace(state=state, endpoint=endpoint, foreign=Counter())
    wires = SimpleNamespace(
        target=SimpleNamespace(text="cf1/target/odom"),
        odometry=SimpleNamespace(refused=refused, told=list(told)),
        search=SimpleNamespace(keys=lambda: keys, stop=lambda: None),
    )
    return WaitReport(FlightConfig(Barrier(1.0, 1.5)), 1, link, wires, searches=True)


def at(own=OWN, status=STANDS, target=TARGET, own_ok=True, placed=False):
    return Snapshot(
        Inputs(own, status), target, own_ok=own_ok, target_ok=True, link_ok=True, relative=None,
        target_placed=placed,
    )  # fmt: skip


def test_nothing_is_missing_when_all_is_there():
    assert not [*waiting().of_vehicle(at(), NOW_S), *waiting().of_target(at())]


@pytest.mark.parametrize(
    ("given", "seen", "words"),
    [
        ({}, {"status": None}, "no heartbeat of system 1"),
        ({}, {"status": replace(STANDS, arrival_s=NOW_S - 3.1)}, "no heartbeat of system 1, "),
        ({}, {"own": None}, "no position: the vehicle sends no LOCAL_POSITION_NED"),
        ({"counts": ["without_yaw"]}, {"own": None}, "without ATTITUDE"),
        ({"counts": ["not_finite"]}, {"own": OWN._replace(arrival_s=NOW_S - 5.0)}, "not finite"),
        ({"counts": ["out_of_order"]}, {"own": None}, "a time that does not advance"),
        (
            {}, {"own": OWN._replace(arrival_s=NOW_S - 0.31)},
            "position is 0.3 s old; checks.own_age_max_s allows 0.2",
        ),
        ({}, {"own_ok": False}, "do not agree (checks.own_drift_max_m)"),
        ({}, {"status": replace(STANDS, landed=Landed.UNKNOWN)}, "EXTENDED_SYS_STATE"),
        ({}, {"status": replace(STANDS, landed=Landed.IN_AIR, armed=True)}, "in the air and in mode HOLD"),
        ({"battery": None}, {"status": NOT_READY}, "whether it may be armed (SYS_STATUS)"),
    ],
)  # fmt: skip
def test_each_lack_of_the_vehicle_has_its_sentence(given, seen, words):
    (text,) = waiting(**given).of_vehicle(at(**seen), NOW_S)
    assert words in text


def test_a_vehicle_that_is_not_ready_is_named_with_its_reasons():
    report = waiting()
    for text in ("GPS", "Compass"):
        report.note_text(NOW_S, 4, text)
    (text,) = report.of_vehicle(at(status=NOT_READY), NOW_S)
    assert text.endswith("fail (SYS_STATUS); it reports: GPS | Compass")


@pytest.mark.parametrize(
    ("given", "seen", "words"),
    [
        ({}, {"target": None}, "no sample on cf1/target/odom; nor on any key like odometry"),
        ({"keys": ("a/odom", "b/odom")}, {"target": None}, "there are a/odom, b/odom"),
        ({"told": ["a hash"]}, {"target": None}, "odom any more; of earlier ones: a hash"),
        (
            {"refused": 7, "told": ["cf1/target/odom: a frame"]}, {"target": None},
            "7 samples on cf1/target/odom, none accepted: a frame",
        ),
        ({}, {"placed": True}, "do not agree; checks.target_drift_max_m is 0.1; usual causes: a twist in"),
        ({}, {"target": TARGET._replace(age_s=1.04)}, "is 1.0 s old; checks.target_age_max_s allows 0.25"),
    ],
)  # fmt: skip
def test_each_lack_of_the_target_has_its_sentence(given, seen, words):
    (text,) = waiting(**given).of_target(at(**seen))
    assert words in text


def test_inputs_that_arrive_too_rarely_are_named_with_their_rate():
    report = waiting()
    for n in range(3):
        now_s = NOW_S + 5.0 * n
        own, status = OWN._replace(arrival_s=now_s), replace(STANDS, arrival_s=now_s)
        text = report.step(Out(at(own, status), target_accepted=n, phase=Phase.WAIT), Memory(), 1, (), now_s)
    assert "heartbeats: one every 5.00 s (0.2 Hz); checks.status_age_max_s allows 3 s" in text
    assert "samples on cf1/target/odom: one every 5.00 s (0.2 Hz); checks.target_age_max_s" in text
    assert text.endswith("gives up within 30 s (checks.wait_time_max_s)")


TICK = Tick(2000, NOW_S, 1_700_000_000_000_000_000, 0.01, 0.0, overruns=3)


class Out(NamedTuple):
    """The fields of a controller's outputs that the messages use."""

    snapshot: Snapshot
    finished: bool = False
    target_accepted: int = 5
    target_rejected: int = 6
    phase: Phase = Phase.WAIT
    events: tuple = ()


def view(**inputs):
    return Snapshot(Inputs(**inputs), None, own_ok=True, target_ok=False, link_ok=True, relative=None)


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


ROOT = Path(__file__).parents[3]
CONFIG = load("crazyflie")


@pytest.fixture
def wires():
    opened = []

    def open_wires(target="cf1/target/odom", kind="odometry", **given):
        options = OnboardOptions(
            vehicle_url="", config_file=ROOT, target_key=target, target_type=kind, **given
        )
        opened.append(ZenohWires(CONFIG, options, "cf1"))
        return opened[-1]

    yield open_wires
    for one in opened:
        one.close()


def test_a_door_to_the_network_without_rules_is_told_once(wires):
    port = free_port()
    open_door = wires(listen=[f"tcp/0.0.0.0:{port}"])
    [text] = open_door.texts(0.0)
    assert f"listens on tcp/0.0.0.0:{port} without rules" in text
    assert open_door.texts(0.01) == []
    assert wires().texts(0.0) == []


@pytest.mark.parametrize(("target", "kind"), [("ros2:/odom", "odometry"), ("cf1/target/pose", "pose")])
def test_lockstep_is_with_the_simulated_target(wires, target, kind):
    with pytest.raises(ValueError, match="in lockstep"):
        wires(target, kind, lockstep=True)


@pytest.fixture(scope="module")
def router():
    with ros.network(0) as (endpoint, _):
        yield endpoint


ONBOARD = ("onboard", "--vehicle", "udpout:127.0.0.1:9", "--config", "crazyflie")
CLIENT = ("--zenoh-config", "docs/how_to/zenoh/client.json5")


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ((*ONBOARD, "--target", "ros2:odom"), 2, "for example /odom"),
        ((*ONBOARD, "--target", "ros2:/1/odom"), 2, "not by a digit"),
        ((*ONBOARD, "--target", "a//b"), 2, "cf1/target/odom"),
        ((*ONBOARD, "--target", "ros2:/odom", "--lockstep"), 2, "in lockstep"),
        ((*ONBOARD, "--target-type", "twist"), 2, "pose-covariance"),
        ((*ONBOARD, "--ros-domain", "300"), 2, "0<=x<=232"),
        ((*ONBOARD, "--ros2", "localhost"), 2, "tcp/127.0.0.1:7447"),
        ((*ONBOARD, "--zenoh-config", "pyproject.toml"), 2, "Zenoh configuration pyproject.toml"),
        ((*ONBOARD, *CLIENT, "--listen", "tcp/127.0.0.1:0"), 2, "cannot listen"),
        (("target", "--scenario", "straight", "--namespace", "1", "--ros2", "{router}"), 2, "not by a digit"),
        (("watch", "--once", "--zenoh-config", "no.json5"), 2, "does not exist"),
    ],
)  # fmt: skip
def test_wrong_words_are_refused_with_what_is_allowed(router, words, status, said):
    done = called(*(word.replace("{router}", router) for word in words), cwd=ROOT)
    assert done.code == status, done.err
    assert said in done.err


def test_a_router_of_ros_that_is_not_there_is_said_before_the_flight(monkeypatch):
    monkeypatch.setitem(zenoh_link._ROLE_DEFAULTS[Role.CLIENT], "connect/timeout_ms", 100)
    done = called(*ONBOARD, "--ros2", free_endpoint())
    assert done.code == 2
    assert "is the router running, and does it accept us" in done.err


def test_what_the_autopilot_did_by_itself_carries_its_own_reason():
    report = WaitReport(FlightConfig(Barrier(1.0, 1.5)), 1, None, None, searches=False)
    assert "the autopilot sent no reason (no STATUSTEXT or EVENT for 5 s)" in report.cause(1.0)
    report.note_text(1.0, 6, "Takeoff detected")
    for severity, text in ((2, "Crash: Disarming: AngErr=70>30"), (6, "Disarmed by crash detection")) * 2:
        report.note_text(8.0, severity, text)
    assert report.cause(9.0) == (
        "the autopilot reports: Crash: Disarming: AngErr=70>30 | Disarmed by crash detection"
    )
    assert "no reason" in report.cause(20.0)


def test_what_ends_a_wait_is_counted_down_with_its_setting():
    config = FlightConfig(barrier=Barrier(alpha_1_m=1.0, beta_m=1.5), retreat=Retreat(abort_time_max_s=40.0))
    assert countdown(config, Phase.WAIT, 12.0) == "gives up within 48 s (checks.wait_time_max_s)"
    assert countdown(config, Phase.ABORT, 12.0) == "ends within 28 s (retreat.abort_time_max_s)"
    assert countdown(config, Phase.HOLD, 3.0) == "aborts within 0 s (checks.hold_time_s)"
    assert countdown(config, Phase.APPROACH, 3.0) == ""  # without inputs, this phase ends immediately
