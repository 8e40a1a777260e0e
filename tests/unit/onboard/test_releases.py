"""Tests the pre-flight check with a fake vehicle for each autopilot release in its tables."""

import re
from itertools import product

import pytest

from bridge.mavlink.preflight import examine as module
from bridge.mavlink.preflight.table import Level, Table, judge, minor, table
from bridge.mavlink.profiles import PROFILES
from flightstack.common.strict_toml import ConfigError, from_table
from flightstack.onboard.preflight import lines, record, verdict
from tests.fake_autopilot import OnUdp
from tests.unit.onboard.safe_parameters import DEV, SAFE, packed
from tests.unit.onboard.test_preflight import NEEDS, talk

RELEASES = pytest.mark.parametrize(("autopilot", "release"), SAFE, ids=" ".join)


def judged(autopilot, release, values):
    asked = table(autopilot).asked(autopilot, release)
    return {f.name: f for f in judge(asked, values, {}, NEEDS, ())}


def test_the_fakes_are_of_every_release_of_the_tables():
    assert set(SAFE) == {(name, r) for name in ("ardupilot", "px4") for r in table(name).releases}


@RELEASES
def test_a_safe_vehicle_of_any_release_may_arm(autopilot, release):
    report = talk(OnUdp(autopilot, packed(release), SAFE[autopilot, release]))
    assert (verdict(report), report.notes, report.rules) == (None, (), release)
    assert {f.level for f in report.findings} == {Level.OK}
    assert {f.name for f in report.findings} == set(SAFE[autopilot, release])


def sides(rule):
    """Return values on the safe and on the unsafe side of a rule's condition, in the rule's unit."""
    low, high = (getattr(NEEDS, end) if isinstance(end, str) else end for end in (rule.low, rule.high))
    if rule.values:
        allowed = {float(value.split()[0]) for value in rule.values}
        return allowed, {*range(9)} - allowed
    if rule.bits_set is not None:
        return {rule.bits_set}, {rule.bits_set & ~(1 << n) for n in range(16) if rule.bits_set >> n & 1}
    if rule.bits_clear is not None:
        bits = [1 << n for n in range(16) if rule.bits_clear >> n & 1]
        return {0, *(1 << n for n in range(4) if not rule.bits_clear >> n & 1)}, {*bits, sum(bits)}
    good = {end for end in (low, high, rule.off) if end is not None}
    return good, {0.97 * low} if high is None else {1.01 * high, *({0.9 * low} if low else ())}


@RELEASES
def test_each_side_of_every_rule_is_told_apart_in_every_release(autopilot, release):
    """Values on a rule's unsafe side are reported with the rule's level; safe values are not reported."""
    safe = SAFE[autopilot, release]
    asked = table(autopilot).asked(autopilot, release)
    assert len(asked) > 15
    for (name, rule, _), (number, value) in (
        (each, (number, value))
        for each in asked
        for number, side in enumerate(sides(each.rule))
        for value in side
    ):
        found = judged(autopilot, release, safe | {name.name: value / name.scale})
        expected = (
            Level.UNSAFE
            if number and f"{value:g}" in {stop.split()[0] for stop in rule.stops}
            else rule.severity
        )
        wrong = {n: f.level for n, f in found.items() if f.level is not Level.OK}
        assert wrong == ({name.name: expected} if number else {}), (name.name, value)


@RELEASES
def test_what_is_missing_is_as_bad_as_what_is_not_safe_unless_the_rule_says_otherwise(autopilot, release):
    asked = table(autopilot).asked(autopilot, release)
    levels = {each.name.name: each.rule.missing or each.rule.severity for each in asked}
    found = {name: each.level for name, each in judged(autopilot, release, {}).items()}
    assert found == {name: level for name, level in levels.items() if level is not Level.IGNORED}


@pytest.mark.parametrize(("autopilot", "release"), [("ardupilot", "4.7"), ("px4", "1.18")])
def test_the_names_of_the_release_before_are_refused(autopilot, release):
    older = {"4.7": "4.6", "1.18": "1.16"}[release]
    report = talk(OnUdp(autopilot, packed(release), SAFE[autopilot, older], says_unknown=True))
    missing = {f.name for f in report.findings if f.value is None}
    assert missing >= {"4.7": {"WP_SPD", "ARMING_SKIPCHK"}, "1.18": {"MAN_OVERRIDE_SPD"}}[release]
    assert any("refused: DOES_NOT_EXIST" in f.why for f in report.findings)
    assert report.safe is (autopilot == "px4")  # unknown parameter names of PX4 are only notes


def test_a_name_of_any_release_may_be_accepted():
    asked = table("ardupilot").asked("ardupilot", "4.7")
    values = SAFE["ardupilot", "4.7"] | {"WP_SPD": 0.1}
    for name, level in (
        ("WPNAV_SPEED", Level.ACCEPTED),
        ("WP_SPD", Level.ACCEPTED),
        ("WP_ACC", Level.UNSAFE),
    ):
        found = {f.name: f.level for f in judge(asked, values, {}, NEEDS, (name,))}
        assert found["WP_SPD"] is level


UNKNOWN = [
    ("ardupilot", packed("4.9"), "4.8", "the parameters of ArduCopter 4.9.0 are not known"),
    ("ardupilot", packed("4.4"), "4.5", "the parameters of ArduCopter 4.4.0 are not known"),
    ("px4", packed("2.0"), "1.18", "the parameters of PX4 2.0.0 are not known"),
    ("px4", packed("1.19", 64), "1.18", "the parameters of PX4 1.19.0 alpha are not known"),
    ("px4", packed("0.0", DEV), "1.18", "PX4 0.0.0 dev is a version without a number"),
    (
        "px4",
        None,
        "1.18",
        "the release of this PX4 is not known: no AUTOPILOT_VERSION in reply to 2 requests",
    ),
]


@pytest.mark.parametrize(("autopilot", "version", "nearest", "why"), UNKNOWN)
def test_a_release_that_is_not_known_is_refused_by_name_or_flown_by_the_nearest_rules(
    autopilot, version, nearest, why, monkeypatch
):
    monkeypatch.setattr(module, "_VERSION_TRIES", 2)
    safe = SAFE[autopilot, nearest]
    refused = talk(OnUdp(autopilot, version, safe))
    assert not refused.safe
    assert verdict(refused).startswith(why)
    assert f"--accept-release flies it by the rules of {nearest}" in verdict(refused)
    flown = talk(OnUdp(autopilot, version, safe), accept_release=True)
    assert (verdict(flown), flown.rules) == (None, nearest)
    assert any(f"judged by the rules of {nearest} (--accept-release)" in line for line in lines(flown))
    assert why in record(flown)["notes"]
    bad = talk(OnUdp(autopilot, version, safe | {next(iter(safe)): 60.0}), accept_release=True)
    assert not bad.safe


def test_a_build_of_a_known_release_that_is_none_is_noted():
    report = talk(OnUdp("ardupilot", packed("4.8", DEV), SAFE["ardupilot", "4.8"]))
    assert report.safe
    assert report.notes == ("ArduCopter 4.8.0 dev is not a release: judged by the rules of 4.8",)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_every_rule_has_one_condition_and_every_release_one_rule_for_a_name(autopilot):
    rules = table(autopilot)
    assert list(rules.releases) == sorted(rules.releases, key=minor)
    for rule in rules.rule:
        ranged = rule.low is not None or rule.high is not None
        others = (rule.values, rule.bits_set is not None, rule.bits_clear is not None)
        assert [ranged, *map(bool, others)].count(True) == 1, rule.means
        assert all(re.match(r"-?\d+ \(.+\)$", value) for value in (*rule.values, *rule.stops)), rule.means
        assert all(0 < len(name.name) <= 16 for name in rule.names), rule.means
        assert {end for name in rule.names for end in (name.since, name.before)} <= {"", *rules.releases}
    for profile, release in product(("sitl", autopilot), rules.releases):
        names = [each.name.name for each in rules.asked(profile, release)]
        assert len(names) == len(set(names)), (profile, release)


RULE = {"means": "m", "names": [{"name": "A"}], "text": "t", "low": 1.0}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"severity": "bad"}, "severity: found 'bad', allowed: ok, info, note, UNSAFE, accepted, ignored"),
        ({"low": "speed"}, "low: found 'speed', allowed: .*horizontal_m_s"),
        ({"scales": 2.0}, "scales: unknown key"),
    ],
)
def test_a_broken_table_says_where(wrong, words):
    with pytest.raises(ConfigError, match=words):
        from_table(Table, {"title": "X", "releases": ["1.0", "1.1"], "rule": [RULE | wrong]})


def test_every_profile_says_whether_its_vehicle_has_parameters():
    """Only the profile of the Crazyflie has no table of parameter rules."""
    assert {name for name in PROFILES if table(name) is None} == {"crazyflie"}
