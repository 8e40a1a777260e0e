"""Tests that replay finds a single changed bit in a log, and a controller with other decisions."""

import json
import math
from dataclasses import replace as with_

import pytest
from click.testing import CliRunner

from flightstack.cli.main import main
from flightstack.common.pacing import EPOCH_NS
from flightstack.core.mission.machine import Mission
from flightstack.core.parameters.reserve import Reserve
from flightstack.core.types import OwnState, Power
from logs.compare import messages_of
from logs.reader.reader import LogFile
from logs.replay.replay import ReplayError, replay
from logs.schema import schemas
from logs.schema.controller_rows import pack_controller_input, unpack_controller_input
from logs.schema.rows import ControllerStateRow, LogRow
from logs.schema.schemas import CONTROLLER_STEP
from tests.golden.flights import write_kept
from tests.point_mass import World
from tests.synthetic_flight import landing, write_log
from tests.unit.logs.replay.replay_helpers import CONFIG, INPUT, STATE, STEP, record, short_flight

TICK = 40  # number of the changed tick; the vehicle flies then


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return short_flight(tmp_path_factory.mktemp("replay") / "flight.mcap")


@pytest.fixture(scope="module")
def step(recorded):
    return next(m.data for m in LogFile(recorded).messages({STEP}) if m.sequence == TICK)


def rewritten(recorded, target, *, when=None, change=None):
    return write_kept(recorded, target, wire=False, when=when, change=change)


def at(topic, change, tick=TICK):
    """Return a function that applies ``change`` to the message of one tick on one topic."""
    return lambda m: change(m.data) if (m.topic, m.sequence) == (topic, tick) else m.data


def flipped(data, byte, bit=0):
    changed = bytearray(data)
    changed[byte] ^= 1 << bit
    return bytes(changed)


def test_a_flight_replays_bit_by_bit(recorded):
    result = replay(recorded)
    assert result.equal
    assert result.compared > 100
    assert result.phases_recorded == result.phases_replayed
    assert [c.phase for c in result.phases_recorded][:2] == ["WAIT", "APPROACH"]
    assert result.command_ticks == 0


def offsets(step):
    """Return the first byte of each field of a step, by the field's name."""
    found = {}
    for byte in range(len(step)):
        ((name, _, _),) = messages_of(CONTROLLER_STEP, flipped(step, byte), step)
        found.setdefault(name, byte)
    return found


def test_every_bit_of_a_step_counts_and_every_field_is_named(step):
    for byte in range(len(step)):
        for bit in range(8):
            assert len(list(messages_of(CONTROLLER_STEP, flipped(step, byte, bit), step))) == 1, (byte, bit)
    named = {name.partition(".")[0] for name in offsets(step)} - {"data"}
    assert named == {field.name for field in schemas.fields_of(CONTROLLER_STEP)}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda row: row._replace(msg=row.msg + "!"), "events[0].msg"),
        (lambda row: row._replace(level=row.level ^ 2), "events[0].level"),
        (lambda row: row._replace(stamp_ns=row.stamp_ns ^ 1), "events[0].stamp_ns"),
        (lambda row: row._replace(name="somebody"), "events.length"),
        (lambda row: row._replace(line=1), "events[0].line"),
    ],
)
def test_a_changed_event_is_found(recorded, tmp_path, change, field):
    def first_event(message):
        row = LogRow.unpack(message.data) if message.topic == "/rosout" else None
        return change(row).pack() if row and "-> APPROACH" in row.msg else message.data

    result = replay(rewritten(recorded, tmp_path / "changed.mcap", change=first_event))
    assert [(d.topic, d.field) for d in result.outputs.first] == [("/rosout", field)]


def test_a_controller_that_remembers_otherwise_is_found_before_it_decides_otherwise(recorded, monkeypatch):
    step = Mission.step

    def forgetful(self, *arguments, **named):
        transition = step(self, *arguments, **named)
        if transition is not None:
            self.memory.retries = 7
        return transition

    monkeypatch.setattr(Mission, "step", forgetful)
    result = replay(recorded)
    assert result.outputs.count == 0
    assert {d.field for d in result.states.first} == {"memory.retries"}
    assert (result.states.first[0].topic, result.states.first[0].index) == (STATE, 100)


def test_changed_inputs_change_what_comes_out(recorded, tmp_path):
    def moved(data):
        row = unpack_controller_input(data)
        own = row.inputs.own
        x, y, z = own.position_enu_m
        own = OwnState(own.arrival_s, own.source_time_s, (x + 1e-12, y, z), own.velocity_enu_m_s, own.yaw_rad)
        return pack_controller_input(row._replace(inputs=row.inputs._replace(own=own)))

    result = replay(rewritten(recorded, tmp_path / "changed.mcap", change=at(INPUT, moved)))
    assert not result.equal
    assert result.outputs.first[0].field == "own_position_enu_m.x"


def test_a_log_cut_at_any_byte_is_equal_up_to_there_or_refused(recorded, tmp_path):
    whole, cut = recorded.read_bytes(), tmp_path / "cut.mcap"
    compared, refused = set(), set()
    for share in range(1, 40):
        cut.write_bytes(whole[: len(whole) * share // 40])
        try:
            result = replay(cut)
        except ReplayError:
            refused.add(share)
            continue
        assert result.equal, result.outputs.first
        assert any("breaks off" in note for note in result.notes)
        compared.add(result.compared)
    assert max(refused) < 10  # only logs that end before the first decision are refused
    assert len(compared) > 5  # logs of many lengths were compared
    assert max(compared) <= replay(recorded).compared


def without(topics, ticks):
    gone = frozenset(ticks)
    return lambda m: not (m.topic in topics and round((m.log_time_ns - EPOCH_NS) / 1e7) in gone)


@pytest.mark.parametrize(
    ("topics", "ticks", "words"),
    [
        ((INPUT, STEP, STATE), [50], ["tick 50 are missing, tick 51 follows", "gap"]),
        ((STEP,), [50], ["tick 50 are missing"]),
        ((INPUT,), [50], ["tick 50 are missing"]),
        ((INPUT,), range(10**6), ["tick 0 with both inputs and decisions"]),
        ((STEP,), range(10**6), ["tick 0 are missing"]),
        ((INPUT, STEP, STATE), [0], ["tick 0 are missing, tick 1 follows"]),
        ((INPUT, STEP, STATE, "/rosout"), range(1, 10**6), ["never sent a set-point", "1 ticks"]),
    ],
)
def test_a_log_that_proves_nothing_says_why(recorded, tmp_path, topics, ticks, words):
    broken = rewritten(recorded, tmp_path / "broken.mcap", when=without(topics, ticks))
    with pytest.raises(ReplayError) as error:
        replay(broken)
    for word in words:
        assert word in str(error.value)


def test_a_log_without_inputs_or_configuration_is_refused(tmp_path):
    with pytest.raises(ReplayError, match="no metadata of an onboard process"):
        replay(write_log(tmp_path / "old.mcap", landing()))
    (tmp_path / "text.mcap").write_text("hello, this is not a log")
    with pytest.raises(ReplayError, match="not an MCAP file"):
        replay(tmp_path / "text.mcap")


def test_a_state_of_another_layout_is_not_compared(recorded, tmp_path):
    def renamed(message):
        if message.topic != STATE:
            return message.data
        row = ControllerStateRow.unpack(message.data)
        return row._replace(layout=row.layout + ",new:float").pack()

    whole = replay(rewritten(recorded, tmp_path / "whole.mcap", change=renamed))
    assert whole.equal
    assert any("another layout" in note for note in whole.notes)


def run(*arguments):
    return CliRunner().invoke(main, ["replay", *map(str, arguments)])


def test_the_verb_says_equal_or_names_what_is_not(recorded, tmp_path):
    for arguments in ([recorded], [recorded, "--check"]):
        done = run(*arguments)
        assert (done.exit_code, done.output.splitlines()[-1]) == (0, "cf1: equal"), done.output
    changed = rewritten(recorded, tmp_path / "changed.mcap", change=at(STEP, lambda d: flipped(d, -1, 7)))
    done = run(changed, "--check")
    assert done.exit_code == 1
    assert f"{STEP}[{TICK}] command_yaw_rad: -0.0 != 0.0" in done.output
    assert "decisions and events: 1 differences in 1 ticks" in done.output
    found = json.loads(run(changed, "--json").output)
    assert (found["result"], found["outputs"]["count"]) == ("different", 1)
    assert found["outputs"]["first"][0]["field"] == "command_yaw_rad"
    (tmp_path / "not.mcap").write_text("not a log")
    done = run(tmp_path / "not.mcap", "--json")
    assert done.exit_code == 2
    assert json.loads(done.stdout)["result"] == "unusable"


def test_the_verb_shows_what_another_configuration_would_have_done(recorded):
    done = run(recorded, "--set", "barrier.alpha_1_m=1.2", "--set", "limits.velocity_max_m_s=[0.3, 0.3, 0.5]")
    assert done.exit_code == 0, done.output
    assert "set-point differs in" in done.output
    assert "phases recorded: WAIT from 0, APPROACH from" in done.output
    assert run(recorded, "--set", "barrier.alpha_1_m=1.2", "--check").exit_code == 1
    same = run(recorded, "--set", "barrier.alpha_1_m=1.0", "--check")
    assert (same.exit_code, "every set-point is the same" in same.output) == (0, True)
    word = run(recorded, "--set", "filter=paper", "--json")
    assert json.loads(word.output)["set"] == ["filter=paper"]


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("barrier.alpha_2_m=1", ["barrier.alpha_2_m", "alpha_1_m"]),
        ("loop.rate_s=0.01", ["wrong unit", "rate_hz"]),
        ("barrier.alpha_1_m=wide", ["barrier.alpha_1_m", "wide", "0.05 to 20"]),
        ("barrier.alpha_1_m=99", ["0.05 to 20"]),
        ("barrier.omega_1_s.x=1", ["omega_1_s"]),
        ("barrier.alpha_1_m", ["KEY=VALUE"]),
        ("=1", ["KEY=VALUE"]),
        ("wings.count=2", ["wings", "unknown key"]),
    ],
)
def test_a_wrong_setting_is_refused(recorded, setting, words):
    done = run(recorded, "--set", setting)
    assert done.exit_code == 2
    for word in words:
        assert word in done.output


RESERVE = Reserve(hover_throttle=0.78, hover_voltage_v=3.7, lowest_voltage_v=3.2, sag_v=0.4)
POWER = "/cf1/controller/power"


@pytest.fixture(scope="module")
def powered(tmp_path_factory):
    """Return a flight with a thrust reserve and a battery that sags."""

    def told(world, inputs):
        said = None if world.t_s < 0.05 else Power(world.t_s, 3.9 - 0.1 * world.t_s, 0.8, 0.99)
        return inputs._replace(power=said)

    config = with_(CONFIG, reserve=RESERVE)
    world = World(config, position=(-0.6, 0.2, 0.95), fault=told, fault_from_s=0.0)
    path = record(tmp_path_factory.mktemp("powered") / "flight.mcap", world, 3.0, config=config)
    assert not math.isnan(world.outputs[-1].reserve)
    return path


def test_a_flight_with_a_thrust_reserve_replays_bit_by_bit(powered):
    result = replay(powered)
    assert result.equal, result.outputs.first + result.states.first


@pytest.mark.parametrize("byte", [-1, -9, -25])
def test_what_was_told_of_the_battery_counts(powered, tmp_path, byte):
    """A changed bit of the estimated reserve, the tilt or the voltage in the log is found."""
    changed = at(POWER, lambda data: flipped(data, byte), TICK)
    result = replay(rewritten(powered, tmp_path / "changed.mcap", change=changed))
    assert result.outputs.first[0].index == TICK
    assert result.outputs.first[0].topic == POWER


def test_a_flight_without_a_thrust_reserve_records_no_power_and_leaves_its_state_out(recorded):
    topics = {m.topic for m in LogFile(recorded).messages()}
    assert POWER not in topics
    states = [ControllerStateRow.unpack(m.data) for m in LogFile(recorded).messages({STATE})]
    assert all("ReserveMemory(" in each.layout and '"reserve":' not in each.state for each in states)


def test_a_last_tick_without_its_decisions_is_left_out(recorded, tmp_path):
    last = replay(recorded).compared - 1
    cut = rewritten(recorded, tmp_path / "cut.mcap", when=lambda m: (m.topic, m.sequence) != (STEP, last))
    result = replay(cut)
    assert (result.equal, result.compared) == (True, last)
    assert any("not whole" in note for note in result.notes)
