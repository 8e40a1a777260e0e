"""Tests each outcome and each limit of the verdict with synthetic logs."""

import math

import pytest

from flightstack.common.pacing import EPOCH_NS
from flightstack.core.types import Phase
from logs.schema.events import CAUSE
from logs.verdict.verdict import Outcome
from tests.synthetic_flight import DT_S, EDGE, GROUND, PAD, ROBOT, TUMBLED, landing


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
    # the contact is between two ticks; the simulator records the exact time
    assert verdict.time_to_land_s == pytest.approx(
        touch.first_touch_time_s - rows.begin_tick * DT_S, abs=1e-6
    )
    since = [r for r in rows.truth if r.tick > rows.begin_tick]
    assert verdict.h_min_m == min(r.h_min_m for r in since)
    assert verdict.h_min_outside_pad_m == min(r.h_min_outside_pad_m for r in since)


@pytest.mark.parametrize(
    ("h_m", "violation"), [(-0.0051, True), (-0.005, False), (-0.0049, False), (math.inf, False)]
)
def test_violation_limit(verdict_of, h_m, violation):
    rows = landing()
    rows.change_truth(lambda r: True, h_min_outside_pad_m=math.inf)
    rows.change_truth(lambda r: r.tick == rows.begin_tick + 50, h_min_outside_pad_m=h_m, h_min_m=-0.3)
    verdict = verdict_of(rows)
    assert verdict.violation is violation
    assert verdict.h_min_m == -0.3  # over the pad, h below 0 is no violation


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


@pytest.mark.parametrize(("after_s", "outcome"), [(1.99, Outcome.TIMEOUT), (2.0, Outcome.LANDED)])
def test_two_seconds_of_rest_are_needed(verdict_of, after_s, outcome):
    rows = landing()
    off_s = next(r.tick for r in rows.truth if r.tick > rows.begin_tick and not r.motors_running) * DT_S
    rows.cut(off_s + after_s)
    verdict = verdict_of(rows)
    assert verdict.outcome is outcome
    assert verdict.time_to_land_s is None or outcome is Outcome.LANDED


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


def test_log_cut_short_never_lands(verdict_of):
    verdict = verdict_of(landing(), complete=False)
    assert verdict.outcome is Outcome.TIMEOUT
    assert verdict.violation is None


def truth(when, **values):
    return lambda rows: rows.change_truth(lambda r: when(rows, r.tick), **values)


def steps(when, **values):
    def change(rows):
        rows.steps = [r._replace(**values) if when(rows, r.tick) else r for r in rows.steps]

    return change


def no_truth(when):
    def change(rows):
        rows.truth = [r for r in rows.truth if not when(rows, r.tick)]

    return change


def since_touch(ticks):
    return lambda rows, tick: tick - rows.truth[rows.touch].tick == ticks


def since_begin(first, last):
    return lambda rows, tick: first <= tick - rows.begin_tick <= last


def losses(rows):
    rows.losses = {"vehicle": "3", "onboard": "0"}


ALL, GAP, ANY = since_begin(-(10**6), 10**6), since_begin(11, 39), object()
MISSED = [lambda rows: no_contact_from(rows, rows.begin_tick)]
NAN, STILL = math.nan, (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "outcome", "violation", "word"),
    [
        # with this pad radius, the contact is outside the pad
        ([lambda rows: rows.run.update(pad_radius_m="0.01")], Outcome.CRASHED, ANY, ""),
        (
            # the vehicle stands still while the pad continues at 0.1 m/s
            [truth(lambda rows, tick: tick > rows.truth[rows.touch].tick + 10, velocity_enu_m_s=STILL)],
            Outcome.TIMEOUT, ANY, "relative speed",
        ),
        ([truth(since_touch(60), contacts=GROUND)], Outcome.CRASHED, ANY, "contact after touchdown"),
        ([truth(ALL, motors_running=True)], Outcome.TIMEOUT, ANY, "motors never stopped"),
        ([*MISSED, lambda rows: abort_at(rows, 6.0)], Outcome.ABORTED, ANY, "target did not come back"),
        (MISSED, Outcome.TIMEOUT, ANY, ""),
        (
            [no_truth(lambda rows, tick: tick > rows.truth[rows.touch].tick - 20)],
            Outcome.TIMEOUT, None, "true states end",
        ),
        ([no_truth(GAP)], Outcome.TIMEOUT, None, "gap"),
        ([no_truth(GAP), truth(since_begin(50, 50), h_min_outside_pad_m=-0.1)], Outcome.TIMEOUT, True, "gap"),
        ([losses], Outcome.LANDED, None, "3 records"),
        ([losses, no_truth(GAP)], Outcome.UNKNOWN, None, "lost records (3 of vehicle), so that the log"),
        ([losses, *MISSED], Outcome.UNKNOWN, None, "no contact and no declared abort"),
        ([losses, truth(since_touch(60), contacts=GROUND)], Outcome.CRASHED, ANY, "contact after touchdown"),
        ([truth(since_begin(9, 9), h_min_m=NAN, h_min_outside_pad_m=NAN)], ANY, None, ""),
        ([lambda rows: rows.cut(3.0)], Outcome.TIMEOUT, None, "never began"),
        (
            [lambda rows: rows.cut(3.0), truth(lambda _, tick: tick == 200, contacts=ROBOT)],
            Outcome.CRASHED, ANY, "before the landing began",
        ),
    ],
)  # fmt: skip
def test_outcome_of_a_changed_landing(verdict_of, changes, outcome, violation, word):
    rows = landing()
    for change in changes:
        change(rows)
    verdict = verdict_of(rows)
    assert outcome is ANY or verdict.outcome is outcome
    assert violation is ANY or verdict.violation is violation
    assert word in verdict.reason


def test_a_declared_abort_carries_what_the_autopilot_said_of_it(verdict_of):
    rows = landing()
    for change in MISSED:
        change(rows)
    abort_at(rows, 6.0, "LAND -> ABORT: vehicle disarmed without a command from this stack (done)")
    at_ns, level, _ = rows.events[-1]
    rows.events.append((at_ns, level, f"{CAUSE}the autopilot reports: Crash: Disarming"))
    reason = verdict_of(rows).reason
    assert reason.count("without a command from this stack") == 1
    assert reason.endswith("; the autopilot reports: Crash: Disarming")


def test_landed_by_estimate(verdict_of):
    """Without true states, as in the log of a real vehicle, the estimate determines the verdict."""
    rows = landing()
    rows.truth = []
    verdict = verdict_of(rows)
    assert verdict.outcome is Outcome.LANDED
    assert verdict.judged_from == "estimate"
    assert "no contacts" in verdict.reason
    assert verdict.violation is False
    assert verdict.touchdown_error_m < 0.1
    assert 4.0 < verdict.time_to_land_s < 8.0


@pytest.mark.parametrize(
    ("change", "outcome", "violation"),
    [
        (steps(since_begin(5, 5), h_m=-0.006), ANY, True),
        (steps(since_begin(5, 5), target_valid=False), ANY, None),  # the target state is invalid
        (
            steps(lambda rows, tick: tick > rows.steps[-1].tick - 150, own_valid=False),  # lost while at rest
            Outcome.TIMEOUT, ANY,
        ),
        (lambda rows: rows.cut(10.5), Outcome.TIMEOUT, ANY),
        (lambda rows: abort_at(rows, 6.0), Outcome.ABORTED, ANY),
        (lambda rows: rows.run.update(pad_radius_m="0.005"), Outcome.TIMEOUT, ANY),
    ],
)  # fmt: skip
def test_outcome_of_a_changed_landing_by_estimate(verdict_of, change, outcome, violation):
    rows = landing()
    rows.truth = []
    change(rows)
    verdict = verdict_of(rows)
    assert outcome is ANY or verdict.outcome is outcome
    assert violation is ANY or verdict.violation is violation
