"""Every outcome and every limit of the verdict, on logs made for it."""

import json
import math

import pytest

from flightstack.common.pacing import EPOCH_NS
from flightstack.core.types import Phase
from logs.reader.flight import load_flight
from logs.verdict.verdict import Outcome, judge
from tests.synthetic_flight import DT_S, PAD, landing, write_log

GROUND, ROBOT, EDGE, TUMBLED = 2, 4, 8, 16


@pytest.fixture
def verdict_of(tmp_path):
    def judged(rows, **how):
        return judge(load_flight(write_log(tmp_path / "flight.mcap", rows, **how)))

    return judged


def abort_at(rows, t_s, text="APPROACH -> ABORT: target did not come back (fly clear)"):
    stamp = EPOCH_NS + round(t_s * 1e9)
    rows.steps = [r._replace(phase=Phase.ABORT) if r.stamp_ns >= stamp else r for r in rows.steps]
    rows.events.append((stamp, 40, text))


def no_contact_from(rows, tick):
    rows.change_truth(
        lambda r: r.tick >= tick, contacts=0, motors_running=True, first_touch_time_s=math.nan,
        position_enu_m=(0.0, 0.0, 2.0),
    )  # fmt: skip


def test_landed(verdict_of):
    rows = landing()
    verdict = verdict_of(rows)
    touch = rows.truth[rows.touch]
    assert verdict.outcome is Outcome.LANDED
    assert verdict.violation is False
    assert verdict.started_safe is True
    assert verdict.judged_from == "truth"
    x, y, _ = touch.first_touch_relative_position_enu_m
    vx, vy, vz = touch.first_touch_relative_velocity_enu_m_s
    assert verdict.touchdown_error_m == pytest.approx(math.hypot(x, y))
    assert verdict.touchdown_speed_vertical_m_s == pytest.approx(-vz)
    assert verdict.touchdown_speed_horizontal_m_s == pytest.approx(math.hypot(vx, vy))
    # the touch lies half a tick before the true state that shows it
    assert verdict.time_to_land_s == pytest.approx(
        touch.first_touch_time_s - rows.begin_tick * DT_S, abs=1e-6
    )
    since = [r for r in rows.truth if r.tick > rows.begin_tick]
    assert verdict.h_min_m == min(r.h_min_m for r in since)
    assert verdict.h_min_outside_pad_m == min(r.h_min_outside_pad_m for r in since)


def test_json_holds_plain_values_and_null(verdict_of):
    rows = landing()
    rows.cut(2.0)
    values = verdict_of(rows).to_json_dict()
    assert json.loads(json.dumps(values)) == values
    assert values["outcome"] == "timeout"
    assert values["touchdown_error_m"] is None
    assert values["time_to_land_s"] is None


@pytest.mark.parametrize(
    ("h_m", "violation"), [(-0.0051, True), (-0.005, False), (-0.0049, False), (math.inf, False)]
)
def test_violation_limit(verdict_of, h_m, violation):
    rows = landing()
    rows.change_truth(lambda r: True, h_min_outside_pad_m=math.inf)
    rows.change_truth(lambda r: r.tick == rows.begin_tick + 50, h_min_outside_pad_m=h_m)
    assert verdict_of(rows).violation is violation


def test_h_below_inside_the_pad_is_no_violation(verdict_of):
    rows = landing()
    rows.change_truth(lambda r: r.tick == rows.begin_tick + 50, h_min_m=-0.3)
    verdict = verdict_of(rows)
    assert verdict.violation is False
    assert verdict.h_min_m == -0.3


def test_never_outside_the_pad_has_no_minimum_there(verdict_of):
    rows = landing()
    rows.change_truth(lambda r: True, h_min_outside_pad_m=math.inf)
    assert verdict_of(rows).h_min_outside_pad_m is None


@pytest.mark.parametrize(("h_m", "safe"), [(0.0, True), (-1e-6, False)])
def test_a_run_that_began_unsafe_violates_nothing(verdict_of, h_m, safe):
    rows = landing()
    rows.change_truth(lambda r: r.tick == rows.begin_tick, h_m=h_m)
    rows.change_truth(lambda r: r.tick == rows.begin_tick + 3, h_min_outside_pad_m=-0.1)
    verdict = verdict_of(rows)
    assert verdict.started_safe is safe
    assert verdict.violation is safe


def test_before_the_landing_nothing_is_judged(verdict_of):
    rows = landing()
    rows.change_truth(lambda r: r.tick <= rows.begin_tick, h_min_outside_pad_m=-0.4, h_min_m=-0.4)
    rows.change_truth(lambda r: 120 < r.tick <= rows.begin_tick, contacts=ROBOT)
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.LANDED
    assert verdict.violation is False
    assert verdict.h_min_m > -0.1


@pytest.mark.parametrize("bits", [GROUND, ROBOT, EDGE, TUMBLED, PAD | EDGE, PAD | ROBOT])
def test_contact_before_touchdown_crashes(verdict_of, bits):
    rows = landing()
    rows.change_truth(lambda r: r.tick == rows.begin_tick + 100, contacts=bits)
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.CRASHED
    assert verdict.time_to_land_s is None
    assert verdict.touchdown_error_m is None


@pytest.mark.parametrize(
    ("d_m", "outcome"), [(0.0999, Outcome.LANDED), (0.1, Outcome.LANDED), (0.1001, Outcome.CRASHED)]
)
def test_radius_of_first_contact(verdict_of, d_m, outcome):
    rows = landing()
    first = rows.touch
    rows.change_truth(
        lambda r: r.tick >= rows.truth[first].tick, first_touch_relative_position_enu_m=(0.0, -d_m, 0.014)
    )
    verdict = verdict_of(rows)
    assert verdict.outcome is outcome
    assert verdict.touchdown_error_m == pytest.approx(d_m)


def test_pad_radius_comes_from_the_log(verdict_of):
    rows = landing()
    rows.run["pad_radius_m"] = "0.01"  # the made-up landing touches further out than this
    assert verdict_of(rows).outcome is Outcome.CRASHED


@pytest.mark.parametrize(("away_m", "outcome"), [(0.099, Outcome.LANDED), (0.101, Outcome.TIMEOUT)])
def test_radius_at_rest(verdict_of, away_m, outcome):
    rows = landing()
    settled = rows.truth[rows.touch].tick + 100

    def at(pad):
        return (pad[0] + away_m, pad[1], pad[2] + 0.0144)

    rows.truth = [
        r._replace(position_enu_m=at(r.pad_position_enu_m)) if r.tick >= settled else r for r in rows.truth
    ]
    verdict = verdict_of(rows)
    assert verdict.outcome is outcome
    assert verdict.touchdown_error_m < 0.1


def test_slides_when_it_should_rest(verdict_of):
    rows = landing()
    settled = rows.truth[rows.touch].tick + 10
    rows.change_truth(lambda r: r.tick > settled, velocity_enu_m_s=(0.0, 0.0, 0.0))  # the pad goes on at 0.1
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.TIMEOUT
    assert "relative speed" in verdict.reason


def test_falls_off_after_touchdown(verdict_of):
    rows = landing()
    rows.change_truth(lambda r: r.tick == rows.truth[rows.touch].tick + 60, contacts=GROUND)
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.CRASHED
    assert "left the pad" in verdict.reason


def test_motors_never_stop(verdict_of):
    rows = landing()
    rows.change_truth(lambda r: True, motors_running=True)
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.TIMEOUT
    assert "motors never stopped" in verdict.reason


@pytest.mark.parametrize(("after_s", "outcome"), [(1.99, Outcome.TIMEOUT), (2.0, Outcome.LANDED)])
def test_two_seconds_of_rest_are_needed(verdict_of, after_s, outcome):
    rows = landing()
    off_s = next(r.tick for r in rows.truth if r.tick > rows.begin_tick and not r.motors_running) * DT_S
    rows.cut(off_s + after_s)
    verdict = verdict_of(rows)
    assert verdict.outcome is outcome
    assert verdict.time_to_land_s is None or outcome is Outcome.LANDED


def test_declared_abort_says_why(verdict_of):
    rows = landing()
    no_contact_from(rows, rows.begin_tick)
    abort_at(rows, 6.0)
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.ABORTED
    assert "target did not come back" in verdict.reason


def test_a_miss_nobody_declared_is_a_timeout(verdict_of):
    rows = landing()
    no_contact_from(rows, rows.begin_tick)
    assert verdict_of(rows).outcome is Outcome.TIMEOUT


@pytest.mark.parametrize(("speed_m_s", "outcome"), [(0.9, Outcome.ABORTED), (1.1, Outcome.CRASHED)])
def test_an_abort_may_land_away_but_not_fall(verdict_of, speed_m_s, outcome):
    rows = landing()
    no_contact_from(rows, rows.begin_tick)
    abort_at(rows, 6.0)
    rows.change_truth(lambda r: r.tick >= 699, velocity_enu_m_s=(0.0, 0.0, -speed_m_s))
    rows.change_truth(lambda r: r.tick >= 700, contacts=GROUND)
    assert verdict_of(rows).outcome is outcome


@pytest.mark.parametrize("bits", [GROUND | TUMBLED, ROBOT, EDGE])
def test_a_crash_after_a_declared_abort_is_a_crash(verdict_of, bits):
    rows = landing()
    no_contact_from(rows, rows.begin_tick)
    abort_at(rows, 6.0)
    rows.change_truth(lambda r: r.tick >= 700, contacts=bits, velocity_enu_m_s=(0.0, 0.0, -0.3))
    assert verdict_of(rows).outcome is Outcome.CRASHED


def test_true_states_that_stop_early_never_land(verdict_of):
    rows = landing()
    rows.truth = rows.truth[: rows.touch - 20]
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.TIMEOUT
    assert verdict.violation is None
    assert "true states end" in verdict.reason


def test_gap_in_the_true_states_hides_a_landing(verdict_of):
    rows = landing()
    rows.truth = [r for r in rows.truth if not rows.begin_tick + 10 < r.tick < rows.begin_tick + 40]
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.TIMEOUT
    assert verdict.violation is None
    assert "gap" in verdict.reason


def test_violation_seen_beside_a_gap_is_a_violation(verdict_of):
    rows = landing()
    rows.truth = [r for r in rows.truth if not rows.begin_tick + 10 < r.tick < rows.begin_tick + 40]
    rows.change_truth(lambda r: r.tick == rows.begin_tick + 50, h_min_outside_pad_m=-0.1)
    assert verdict_of(rows).violation is True


def test_lost_records_leave_the_violation_open(verdict_of):
    rows = landing()
    rows.losses = {"vehicle": "3", "onboard": "0"}
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.LANDED
    assert verdict.violation is None
    assert "3 records" in verdict.reason


def test_missing_h_leaves_the_violation_open(verdict_of):
    rows = landing()
    rows.change_truth(lambda r: r.tick == rows.begin_tick + 9, h_min_m=math.nan, h_min_outside_pad_m=math.nan)
    assert verdict_of(rows).violation is None


def test_log_cut_short_never_lands(verdict_of):
    verdict = verdict_of(landing(), complete=False)
    assert verdict.outcome is Outcome.TIMEOUT
    assert verdict.violation is None


def test_landing_never_began(verdict_of):
    rows = landing()
    rows.cut(3.0)
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.TIMEOUT
    assert "never began" in verdict.reason
    assert verdict.violation is None


def test_hitting_the_robot_before_the_landing_is_a_crash(verdict_of):
    rows = landing()
    rows.cut(3.0)
    rows.change_truth(lambda r: r.tick == 200, contacts=ROBOT)
    assert verdict_of(rows).outcome is Outcome.CRASHED


class TestByEstimate:
    """Logs without true states, as real hardware writes them."""

    @pytest.fixture
    def rows(self):
        rows = landing()
        rows.truth = []
        return rows

    def test_landed(self, verdict_of, rows):
        verdict = verdict_of(rows)
        assert verdict.outcome is Outcome.LANDED
        assert verdict.judged_from == "estimate"
        assert "no contacts" in verdict.reason
        assert verdict.violation is False
        assert verdict.touchdown_error_m < 0.1
        assert 4.0 < verdict.time_to_land_s < 8.0

    def test_violation(self, verdict_of, rows):
        rows.steps = [r._replace(h_m=-0.006) if r.tick == rows.begin_tick + 5 else r for r in rows.steps]
        assert verdict_of(rows).violation is True

    def test_unknown_inputs_leave_the_violation_open(self, verdict_of, rows):
        rows.steps = [
            r._replace(target_valid=False) if r.tick == rows.begin_tick + 5 else r for r in rows.steps
        ]
        assert verdict_of(rows).violation is None

    def test_lost_at_rest_is_not_landed(self, verdict_of, rows):
        last = rows.steps[-1].tick - 150
        rows.steps = [r._replace(own_valid=False) if r.tick > last else r for r in rows.steps]
        assert verdict_of(rows).outcome is Outcome.TIMEOUT

    def test_ends_too_early(self, verdict_of, rows):
        rows.cut(10.5)
        assert verdict_of(rows).outcome is Outcome.TIMEOUT

    def test_abort(self, verdict_of, rows):
        abort_at(rows, 6.0)
        assert verdict_of(rows).outcome is Outcome.ABORTED

    def test_touchdown_outside_the_pad(self, verdict_of, rows):
        rows.run["pad_radius_m"] = "0.005"
        assert verdict_of(rows).outcome is Outcome.TIMEOUT
