"""Which target samples are believed."""

import math
from dataclasses import replace

import pytest

from flightstack.core.parameters.flight import Checks
from flightstack.core.target.track import TargetTrack, Verdict
from flightstack.core.types import TargetSample

FIRST = TargetSample(10.0, 1000.0, "map", "target", (1.0, 2.0, 0.2), (0.1, 0.0, 0.0), 0.0, 0.0)


def later(seconds, **changes):
    moved = (1.0 + 0.1 * seconds, 2.0, 0.2)
    base = {"arrival_s": 10.0 + seconds, "source_time_s": 1000.0 + seconds, "position_enu_m": moved}
    return replace(FIRST, **{**base, **changes})


@pytest.fixture
def track():
    track = TargetTrack(Checks())
    assert track.accept(FIRST) is Verdict.ACCEPTED
    return track


@pytest.mark.parametrize(
    ("sample", "verdict"),
    [
        (later(0.01), Verdict.ACCEPTED),
        (later(0.01, position_enu_m=(math.nan, 2.0, 0.2)), Verdict.NOT_FINITE),
        (later(0.01, velocity_enu_m_s=(math.inf, 0.0, 0.0)), Verdict.NOT_FINITE),
        (later(0.01, child_frame_id="other"), Verdict.WRONG_ROBOT),
        (later(0.01, frame_id="odom"), Verdict.WRONG_ROBOT),
        (later(0.01, source_time_s=1000.0), Verdict.REPEATED),
        (later(0.01, source_time_s=999.9), Verdict.OUT_OF_ORDER),
        (later(0.01, velocity_enu_m_s=(1.6, 0.0, 0.0)), Verdict.TOO_FAST),
        (later(0.01, position_enu_m=(2.001, 2.0, 0.2)), Verdict.JUMP),
        (
            later(0.01, position_enu_m=(1.2009, 2.0, 0.2)),
            Verdict.ACCEPTED,
        ),  # 0.2 m from where it was expected
        (later(0.01, position_enu_m=(1.202, 2.0, 0.2)), Verdict.JUMP),
    ],
)
def test_verdicts(track, sample, verdict):
    assert track.accept(sample) is verdict
    assert (track.accepted, track.rejected) == ((2, 0) if verdict is Verdict.ACCEPTED else (1, 1))


def test_a_sample_that_was_long_on_its_way_is_late(track):
    track.accept(later(0.2))
    slow = replace(later(0.21), arrival_s=10.21 + 0.26)
    assert track.accept(slow) is Verdict.LATE


def test_the_age_counts_from_the_measurement_less_the_shortest_delay(track):
    assert track.at(10.1).age_s == pytest.approx(0.1)
    slow = replace(later(0.1), arrival_s=10.1 + 0.05)  # 50 ms longer under way than the first
    track.accept(slow)
    assert track.at(10.15).age_s == pytest.approx(0.05)


def test_the_target_is_moved_on_with_its_velocity(track):
    assert track.at(10.1).position_enu_m == pytest.approx((1.01, 2.0, 0.2))


def test_a_lost_track_takes_a_jump_but_no_older_sample(track):
    assert track.accept(later(0.5, position_enu_m=(3.0, 2.0, 0.2))) is Verdict.ACCEPTED
    track = TargetTrack(Checks())
    track.accept(FIRST)
    assert track.accept(replace(later(0.5), source_time_s=999.0)) is Verdict.OUT_OF_ORDER


def test_a_sender_that_started_anew_is_taken_again(track):
    restarted = replace(later(5.0), source_time_s=3.0)
    assert track.accept(restarted) is Verdict.ACCEPTED
    assert track.at(15.0).age_s == pytest.approx(0.0)


def test_no_sample_no_target():
    assert TargetTrack(Checks()).at(1.0) is None
