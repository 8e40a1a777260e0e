"""Tests configuration keys that no other test changes: each changes a behaviour and the certificate."""

from dataclasses import replace

import pytest

from flightstack.core.memory import AbortWay, Memory
from flightstack.core.mission.conditions import Situation, high_enough_m
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.track import TargetTrack
from flightstack.core.types import ZERO, OwnState, Phase, Request, TargetSample
from flightstack.verify.certificate import checks
from tests.unit.core.core_helpers import config
from tests.unit.core.mission.mission_helpers import NOW_S, names, tick
from tests.unit.core.mission.test_contact import contact_after
from tests.unit.core.mission.test_guidance import PAD, asked


def blind(settings):
    """Whether a vehicle state of age 0.7 s counts as lost during the touchdown."""
    memory = Memory(phase=Phase.TOUCHDOWN, own_ok_s=NOW_S - 0.7)
    return "OWN_LOST" in names(tick(settings, e=(0.0, 0.0, 0.03), own_age_s=0.7, memory=memory))


def lags(settings):
    """Whether the controller detects within 5 s that the vehicle does not follow its set-points."""
    watch = Plausibility(settings)
    for _ in range(500):
        watch.follow((settings.limits.velocity_max_m_s[0], 0.0, 0.0), ZERO)
    return not watch.follows


def drifted_away(settings):
    """Whether a vehicle state is distrusted if its position moves at 0.1 m/s and its velocity is zero."""
    watch = Plausibility(settings)
    for n in range(500):
        watch.take(OwnState(0.01 * n, 0.01 * n, (0.001 * n, 0.0, 0.0), ZERO, 0.0))
    return watch.memory.distrusted


def parted(settings):
    """Whether a target is distrusted if its position moves at 0.1 m/s and its velocity is zero."""
    track = TargetTrack(settings.checks)
    for n in range(500):
        at = TargetSample(0.01 * n, 0.01 * n, "map", "target", (0.001 * n, 0.0, 0.0), ZERO, 0.0, 0.0)
        track.accept(at)
    return track.memory.distrusted


def clearing(**memory):
    return Memory(abort_way=AbortWay.FLY_CLEAR, target_position_enu_m=PAD, **memory)


def cleared(settings):
    found = asked(Phase.ABORT, settings, (0.3, 0.0, 2.0), clearing(phase_since_s=-40.0))
    return found.request is Request.LAND


# fields: section, key, another value, function that tests the behaviour, results with default and other value
CHANGES = [
    ("touchdown", "descent_m_s", 0.5,
     lambda c: asked(Phase.TOUCHDOWN, replace(c, filter="paper"), (0.0, 0.0, 0.03)).velocity[2],
     (-0.18, -0.48)),
    ("touchdown", "blind_time_s", 1.0, blind, (True, False)),
    ("contact", "beyond_m", 0.02,
     lambda c: contact_after(c, Memory(phase=Phase.TOUCHDOWN), 0.2, e=(0.11, 0.0, 0.0144)), (False, True)),
    ("retreat", "clear_time_max_s", 90.0, cleared, (True, False)),
    ("checks", "follow_memory_s", 0.4, lags, (True, False)),
    ("checks", "own_drift_memory_s", 1.0, drifted_away, (True, False)),
    ("checks", "target_drift_memory_s", 0.5, parted, (True, False)),
    ("checks", "target_drift_max_m", 0.3, parted, (True, False)),
]  # fmt: skip


@pytest.mark.parametrize(
    ("section", "key", "other", "does", "expected"), CHANGES, ids=[f"{c[0]}.{c[1]}" for c in CHANGES]
)
def test_a_changed_size_changes_what_it_does(section, key, other, does, expected):
    assert (does(config()), does(config(**{section: {key: other}}))) == pytest.approx(expected)


def test_the_climb_goes_half_the_margin_beyond_and_flies_clear_a_quarter_below():
    for margin_m in (0.2, 0.6):
        settings = config(retreat={"climb_margin_m": margin_m})
        top = high_enough_m(Situation(settings, None, clearing())) - PAD[2]
        rising = asked(Phase.CLIMB, settings, (0.0, 0.0, top), clearing()).velocity[2]
        assert rising == pytest.approx(0.5 * margin_m)
        for lacking, climbs in ((0.26, True), (0.24, False)):
            away = asked(Phase.ABORT, settings, (0.3, 0.0, top - lacking * margin_m), clearing()).velocity
            assert (away[2] > 0.0) is climbs


def one(name, settings):
    (found,) = (check for check in checks(settings) if check.name == name)
    return found


def test_the_certificate_knows_the_gain_after_the_commit():
    slow, hard = ({"robust": {"gain_descent_1_s": gain}} for gain in (0.7, 3.0))
    same = one("drift", config(robust={"gain_over_pad_1_s": 0.7}))
    assert one("drift", config(**slow)).room == same.room != one("drift", config()).room
    assert one("position loop", config(**slow)).room == one("position loop", config()).room
    found = one("position loop", config(**hard))
    assert not found.proven
    assert found.remedy == "lower robust.gain_descent_1_s"


@pytest.mark.parametrize(
    ("name", "filter", "section", "key", "passes", "fails"),
    [
        ("contact.speed_m_s", "paper", "contact", "speed_m_s", 0.2, 0.201),
        ("contact.speed_m_s", "robust", "contact", "speed_m_s", 0.22, 0.221),
        ("touchdown.height_m", "paper", "touchdown", "height_m", 0.0145, 0.0143),
        ("checks.follow_lag_max_s", "paper", "checks", "follow_memory_s", 0.45, 0.449),
        ("checks.follow_lag_max_s", "robust", "checks", "follow_memory_s", 0.45, 0.449),
        ("descent time", "robust", "touchdown", "timeout_s", 1.5, 1.3),
        ("altitude", "robust", "retreat", "climb_margin_m", 1.6, 1.7),
    ],
)
def test_the_certificate_knows_each_size_from_both_sides(name, filter, section, key, passes, fails):
    assert one(name, config(filter, **{section: {key: passes}})).proven
    found = one(name, config(filter, **{section: {key: fails}}))
    assert not found.proven
    assert section in found.remedy or name == "altitude"
