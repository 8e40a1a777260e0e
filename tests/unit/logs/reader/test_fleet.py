"""Tests the log of a fleet: each member is read as a single flight, and all members are judged together."""

from dataclasses import replace

import numpy as np
import pytest

from logs.reader.flight import load_fleet, load_flight
from logs.reader.reader import LogError, LogFile
from logs.recorder.recording import McapFile
from logs.schema import schemas
from logs.schema.events import pack_log
from logs.schema.rows import FleetPairRow, LogRow
from logs.verdict.types import TRUTH, Outcome, Verdict
from logs.verdict.verdict import fleet_verdict, judge, judge_fleet, result, unobserved
from tests.synthetic_flight import landing, write_log

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("fleet_log")]
MEMBERS = ("cf1", "cf2", "cf3")


def test_a_member_is_read_as_a_single_flight(fleet):
    whole = LogFile(fleet.log)
    assert whole.members == MEMBERS
    one = LogFile(fleet.log, "cf2")
    assert one.members == ("cf2",)
    assert one.single().member == "cf2"
    topics = {m.topic for m in one.messages()}
    assert "/cf2/controller/step" in topics
    assert {topic.split("/")[1] for topic in topics} <= {"cf2", "uas2", "rosout"}
    assert {"run", "onboard", "made"} <= one.metadata().keys()
    assert "fleet" not in one.metadata()
    assert one.metadata()["onboard"]["namespace"] == "cf2"
    assert {a.name for a in one.attachments()} == {"onboard.toml", "scenario.toml", "scenario_source.toml"}
    assert {LogRow.unpack(m.data).name for m in one.messages({"/rosout"})} == {
        "cf2.controller", "cf2.onboard", "cf2.vehicle",
    }  # fmt: skip
    flight = load_flight(fleet.log, "cf2")
    assert flight.config.fleet.id == 2
    assert judge(flight) == fleet.verdict.members["cf2"]


def test_the_members_together_are_the_fleet(fleet):
    """A message is of one member or shared; a member read with others equals the member read alone."""
    parts = {member: LogFile(fleet.log, member) for member in MEMBERS}
    counts = {member: sum(1 for _ in part.messages()) for member, part in parts.items()}
    shared = ("/tf", "/tf_static", "/fleet/pairs")
    assert sum(counts.values()) == sum(m.topic not in shared for m in LogFile(fleet.log).messages())
    read = fleet.read
    assert read.ids == {1: "cf1", 2: "cf2", 3: "cf3"}
    assert sorted(read.pairs) == [(1, 2), (1, 3), (2, 3)]
    assert read.metadata["fleet"]["scenario"] == "fleet_3"
    for member, flight in read.flights.items():
        alone = load_flight(fleet.log, member)
        assert flight.events == alone.events
        assert flight.metadata == alone.metadata
        assert (flight.origin_ns, flight.duration_s) == (alone.origin_ns, alone.duration_s)
        for name in ("own_position_enu_m", "h_m", "phase"):
            assert np.array_equal(getattr(flight.steps, name), getattr(alone.steps, name), equal_nan=True)


def test_what_needs_one_flight_names_the_members(fleet, tmp_path):
    with pytest.raises(LogError, match=r"fleet of cf1, cf2, cf3; choose a member.*--member cf1"):
        load_flight(fleet.log)
    with pytest.raises(LogError, match=r"no member 'cf4'; it holds cf1, cf2, cf3"):
        load_flight(fleet.log, "cf4")
    single = write_log(tmp_path / "flight.mcap", landing())
    assert LogFile(single).members == ("cf1",)  # the default name, since the log contains none
    with pytest.raises(LogError, match="no member 'cf2'; it holds cf1"):
        LogFile(single, "cf2")


def test_one_member_of_whom_records_are_missing_is_the_fleet_s_outcome(fleet):
    read = fleet.read
    lossy = replace(read.flights["cf2"], truth=None, metadata={"losses": {"vehicle": "0", "onboard": "7"}})
    lossy = replace(lossy, steps=None)
    read = replace(read, flights={**read.flights, "cf2": lossy}, metadata={"losses": {"cf2.onboard": "7"}})
    verdict = judge_fleet(read)
    assert verdict.outcome is Outcome.UNKNOWN
    assert verdict.reason.startswith(
        "cf2: the recorder lost records (7 of onboard), so that the log does not"
    )
    told = result(read, verdict)
    assert (told["outcome"], told["records_lost"]) == ("unknown", 7)
    assert {name: each["records_lost"] for name, each in told["vehicles"].items()} == {
        "cf1": 0, "cf2": 7, "cf3": 0,
    }  # fmt: skip


def test_a_broken_log_gives_what_is_before_the_break(fleet, tmp_path):
    broken = tmp_path / "broken.mcap"
    data = fleet.log.read_bytes()
    broken.write_bytes(data[: len(data) // 2])
    read = load_fleet(broken)
    assert all(flight.problems and not flight.complete for flight in read.flights.values())
    verdict = judge_fleet(read)
    assert verdict.outcome is Outcome.TIMEOUT
    assert (verdict.collisions, verdict.ellipsoid_violations, verdict.distance_min_m) == (None,) * 3


LANDED = Verdict(outcome=Outcome.LANDED, reason="well", judged_from=TRUTH)
PAIR = FleetPairRow(0, 1, 2, 0.9, 1.0, 3.0, 0, 0, -1)
NAMES = {1: "cf1", 2: "cf2"}


def test_without_the_end_of_a_pair_nothing_is_safe():
    both = {"cf1": replace(LANDED, violation=False), "cf2": replace(LANDED, violation=None)}
    known = fleet_verdict(both, [PAIR], NAMES)
    assert (known.collisions, known.ellipsoid_violations, known.ellipsoid_min) == (0, 0, 3.0)
    assert known.violation is None
    cut = fleet_verdict(both, [PAIR], NAMES, complete=False)
    assert (cut.collisions, cut.ellipsoid_violations, cut.ellipsoid_min, cut.distance_min_m) == (None,) * 4
    hit = PAIR._replace(collided_ms=0, violations=2)  # these counts are certain, also without later records
    cut = fleet_verdict(both, [hit], NAMES, complete=False)
    assert (cut.collisions, cut.ellipsoid_violations, cut.outcome) == (1, 2, Outcome.CRASHED)
    assert cut.members["cf1"].reason == "collision with cf2"


LATE_NS = 300_000_000  # time without data, ns; longer than the maximum allowed


@pytest.mark.parametrize(
    ("missing", "unknown"),
    [
        ("none", []),
        ("end of the pair", [("cf1", "cf2")]),
        ("pair", [("cf1", "cf2")]),
        ("truth of cf3", [("cf1", "cf3"), ("cf2", "cf3")]),
        ("bytes of cf3", [("cf1", "cf3"), ("cf2", "cf3")]),
        ("end of all pairs", [("cf1", "cf2"), ("cf1", "cf3"), ("cf2", "cf3")]),
    ],
)
def test_pairs_have_to_be_followed_to_the_end(fleet, missing, unknown):
    """The data of a third member do not matter for a pair; the number of collisions needs all pairs."""
    read = fleet.read
    pairs, last = dict(read.pairs), read.flights["cf3"]
    if missing == "end of the pair":
        pairs[1, 2] = pairs[1, 2]._replace(stamp_ns=pairs[1, 2].stamp_ns - LATE_NS)
    elif missing == "pair":
        del pairs[1, 2]
    elif missing == "truth of cf3":
        last = replace(last, truth=None)
    elif missing == "bytes of cf3":
        last = replace(last, complete=False)
    elif missing == "end of all pairs":  # true states of one member end later
        last = replace(last, origin_ns=last.origin_ns + LATE_NS)
    read = replace(read, pairs=pairs, flights={**read.flights, "cf3": last})
    assert unobserved(read) == unknown
    assert judge_fleet(read).collisions == (None if unknown else 0)


def test_what_has_no_members_name_in_front_belongs_to_all(tmp_path):
    file = McapFile(tmp_path / "flight.mcap")
    file.metadata("fleet", {"members": "cf1, big"})
    file.metadata("big/onboard", {"system_id": "9"})
    file.metadata("big/run", {"seed": "1"})
    file.metadata("made", {"version": "1"})
    rosout = file.channel("/rosout", schemas.LOG)
    for name in ("cf1.onboard", "big.onboard", "flight_recorder", "bigger.onboard"):
        file.write(rosout, 1, 1, 0, pack_log(1, 20, name, name))
    file.write(rosout, 1, 1, 0, b"broken")
    for topic in ("/uas9/mavlink_source", "/uas1/mavlink_source", "/bigger/x", "/tf"):
        file.write(file.channel(topic, schemas.MAVLINK), 1, 1, 0, b"")
    file.close()
    big = LogFile(tmp_path / "flight.mcap", "big")
    assert big.metadata() == {"onboard": {"system_id": "9"}, "run": {"seed": "1"}, "made": {"version": "1"}}
    heard = [m.data for m in big.messages({"/rosout"})]
    assert heard.pop() == b"broken"
    assert [LogRow.unpack(data).name for data in heard] == [
        "big.onboard",
        "flight_recorder",
        "bigger.onboard",
    ]
    assert {m.topic for m in big.messages()} == {"/rosout", "/uas9/mavlink_source"}
