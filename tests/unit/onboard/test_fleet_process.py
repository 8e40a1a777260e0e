"""Tests that the onboard process of a fleet member logs the messages that it receives and sends."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.mavlink.preflight.examine import Report
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import open_session
from flightstack.common.strict_toml import ConfigError
from flightstack.config import load, path_of
from flightstack.config.options import OnboardOptions
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.types import Intent, MemberStatus, Operator, Phase
from flightstack.onboard import process
from flightstack.onboard.fleet_wire import DRIFT_PPM, LiveStatuses, Offset, OtherClock
from flightstack.onboard.process import Onboard
from flightstack.onboard.runner import Runner
from logs.schema import schemas
from logs.schema.controller_rows import unpack_neighbours
from logs.schema.rows import MemberStatusRow
from tests.processes.bounded import wait_for
from tests.processes.ports import free_endpoint

LONE = load(path_of("crazyflie"))
CONFIG = replace(LONE, fleet=Fleet(3, (3, 7)))
WHERE = {
    "vehicle_url": "udpin:127.0.0.1:0", "target_key": "cf3/target/odom", "config_file": path_of("crazyflie"),
}  # fmt: skip


class Feed:
    def __init__(self):
        self.topics, self.rows = {}, []

    def channel(self, topic, schema):
        self.topics[topic] = schema
        return topic

    def write(self, channel, log_time_ns, publish_time_ns, sequence, payload):
        self.rows.append((channel, sequence, payload))

    def of(self, topic):
        return [payload for channel, _, payload in self.rows if channel == topic]

    def __getattr__(self, name):
        return lambda *_: None

    dropped = 0


@pytest.fixture
def feed(monkeypatch):
    made = Feed()
    monkeypatch.setattr(process.Feed, "connect", lambda *_, **__: made)
    return made


@pytest.fixture
def endpoint():
    return free_endpoint()


@pytest.fixture
def onboard(feed, endpoint):
    made = Onboard(CONFIG, OnboardOptions(**WHERE, listen=(endpoint,), namespace="cf3"), lambda _: None)
    yield made
    made.close()


@pytest.fixture
def other(onboard, endpoint):
    """Yield the fleet connection of another vehicle, with id 7."""
    session = open_session(connect=[endpoint])
    wait_for(lambda: zenoh_link.transports(session) == 1)
    wire = LiveStatuses(session, "cf7", Fleet(7, (3, 7)))
    yield wire
    wire.close()
    session.close()


def running(onboard):
    return Runner(onboard.controller, process._wires(onboard), onboard, onboard.write)


def word(id_, now_s):
    return MemberStatus(id_, now_s, now_s, (1.0, 2.0, 3.0), *[(0.0, 0.0, 0.0)] * 2, intent=Intent.WAITING)


def test_both_hear_each_other_and_the_log_has_it(onboard, other, feed):
    runner = running(onboard)
    clock = onboard.fleet._now_s
    other.begin(onboard.fleet._epoch_ns, clock)
    step, heard = onboard.controller.step, []

    def placed(inputs, now_s, **named):
        """Run a step, and add a status message, because the vehicle of this test sends no position."""
        heard.extend(inputs.neighbours)
        return step(inputs, now_s, **named)._replace(member_status=word(3, now_s))

    onboard.controller.step = placed
    theirs = []

    def go_on():
        runner.tick()
        theirs.extend(other.statuses())
        other.say(word(7, clock()))
        return heard and theirs

    wait_for(go_on)
    assert {each.id for each in heard} == {7}
    assert {each.id for each in theirs} == {3}
    assert 0.0 < heard[-1].clock_bound_s < 0.1
    topics = ("/cf3/controller/neighbours", "/cf3/fleet/status")
    assert [feed.topics[topic] for topic in topics] == [schemas.CONTROLLER_NEIGHBOURS, schemas.MEMBER_STATUS]
    logged = [each for payload in feed.of(topics[0]) for each in unpack_neighbours(payload)]
    assert repr(logged) == repr(heard)  # repr, because NaN marks a missing claim
    said = [MemberStatusRow.unpack(payload) for payload in feed.of(topics[1])]
    assert len(said) == len(feed.of("/cf3/controller/input"))
    assert {row.id for row in said} == {3}


def test_the_start_is_refused_while_another_process_is_the_same_vehicle(onboard, other, monkeypatch):
    wait_for(lambda: zenoh_link.is_matched(other._publisher))
    other.say(word(3, 0.0))
    wait_for(onboard.fleet.namesake)
    monkeypatch.setattr(process.preflight, "check", lambda *_, **__: Report(None, None, (), None))
    ended = process._preflight(onboard)
    assert (ended.phase, ended.exit_code) == (Phase.WAIT, 1)
    assert "another process has the vehicle id 3" in ended.reason
    onboard.person.operator = Operator.EMERGENCY_STOP
    assert process._preflight(onboard) is None


def test_before_its_take_off_a_vehicle_ends_when_another_one_has_its_id(onboard, other):
    runner = running(onboard)
    assert runner.tick() is None
    found = []

    def go_on():
        other.say(word(3, 0.0))
        found.append(runner.tick())
        return found[-1] is not None

    wait_for(go_on)
    assert "another process has the vehicle id 3" in found[-1].reason
    out = SimpleNamespace(phase=Phase.APPROACH, finished=False)
    assert onboard.ended(out, onboard.controller.memory, None, 1.0) is None  # a vehicle in flight continues


def test_a_lone_vehicle_has_no_wire(feed):
    onboard = Onboard(LONE, OnboardOptions(**WHERE), lambda _: None)
    try:
        assert not onboard.fleet.namesake()
        assert running(onboard).tick() is None
        assert not [topic for topic in feed.topics if "neighbours" in topic or "fleet" in topic]
    finally:
        onboard.close()


def test_a_fleet_is_refused_where_it_cannot_work():
    with pytest.raises(ConfigError, match="no other process can reach this one; --connect, --listen or"):
        process.run(CONFIG, OnboardOptions(**WHERE))


MS = 1_000_000  # nanoseconds per millisecond
delays = st.integers(0, 300 * MS)
rounds = st.lists(st.tuples(delays, delays, st.integers(1, 2000 * MS)), min_size=1, max_size=30)


@given(st.integers(-(10**18), 10**18), st.floats(-0.9, 0.9), rounds)
def test_the_bound_holds_for_all_delays_and_drifts(off_ns, drift, rounds):
    """The computed offset of two clocks is within its bound; ``off_ns``: offset at the start."""
    here, there, now = OtherClock(), OtherClock(), 0

    def there_ns(t_ns):
        return t_ns - off_ns - round(drift * 1e-6 * DRIFT_PPM * t_ns)

    for go, back, pause in rounds:
        stamp = there_ns(now)
        assert here.heard(stamp, now + go, there.ahead_ns(stamp))
        now += go
        assert there.heard(now, there_ns(now + back), here.ahead_ns(now))
        now += back + pause
        found = here.offset(now)
        if found is not None:
            slack_ns = (
                3 + 1e-6 * DRIFT_PPM * 2 * 300 * MS
            )  # rounding, and clock drift during the age of an echo
            assert abs(found.ns - (now - there_ns(now))) <= found.bound_ns + slack_ns


def test_a_clock_that_jumps_is_told_and_learned_anew():
    clock = OtherClock()
    assert clock.heard(0, 10 * MS, 10 * MS)
    assert clock.offset(10 * MS) == Offset(0, 10 * MS)
    assert not clock.heard(100 * MS, 60 * MS, 10 * MS)
    assert clock.offset(60 * MS) is None
    assert clock.heard(110 * MS, 70 * MS, 60 * MS)
    assert clock.offset(70 * MS) == Offset(-50 * MS, 10 * MS)
