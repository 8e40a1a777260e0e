"""Tests that h counts after an abort or a second take-off until the vehicle is clear of the target."""

import math
from dataclasses import replace

import pytest

from flightstack.common.pacing import EPOCH_NS
from flightstack.core.parameters.flight import Checks, FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Phase
from logs.reader.flight import load_flight
from logs.verdict.verdict import Outcome, judge
from tests.synthetic_flight import DT_S, EDGE, GROUND, ROBOT, TUMBLED, landing, write_log

CLEAR_M = 1.0
ABORT_TICK, CLEAR_TICK = 600, 700
CONFIG = FlightConfig(Barrier(alpha_1_m=1.0, beta_m=1.5), checks=Checks(clearance_m=CLEAR_M))


@pytest.fixture
def judged(tmp_path):
    """Return a function that judges a flight with an abort at tick 600 that is clear from tick 700 on."""

    def judged(low_tick, *, config=CONFIG, declared=True):
        rows = landing()
        stamp = EPOCH_NS + ABORT_TICK * 10_000_000
        if declared:
            rows.steps = [r._replace(phase=Phase.ABORT) if r.stamp_ns >= stamp else r for r in rows.steps]
            rows.events.append((stamp, 40, "APPROACH -> ABORT: target did not come back (fly clear)"))

        def away(r):
            d_m = 0.999 * CLEAR_M if r.tick < CLEAR_TICK else 1.001 * CLEAR_M
            x, y, z = r.pad_position_enu_m
            return (x + d_m, y, z + 1.0)

        rows.truth = [
            r._replace(
                position_enu_m=away(r), contacts=0, motors_running=True,
                h_min_outside_pad_m=-0.2 if r.tick == low_tick else 0.3,
                h_min_m=-0.2 if r.tick == low_tick else 0.3,
            )
            if r.tick >= rows.begin_tick
            else r
            for r in rows.truth
        ]  # fmt: skip
        return judge(replace(load_flight(write_log(tmp_path / "flight.mcap", rows)), config=config))

    return judged


WIDE = replace(CONFIG, checks=Checks(clearance_m=2.0))


# the first state beyond the clearance distance still counts, because it has the smallest h of earlier steps
@pytest.mark.parametrize(
    ("low_tick", "violation", "how"),
    [
        (550, True, {}),
        (650, True, {}),
        (CLEAR_TICK - 1, True, {}),
        (CLEAR_TICK, True, {}),
        (CLEAR_TICK + 1, False, {}),
        (800, False, {}),
        (800, True, {"declared": False}),
        (800, True, {"config": None}),  # the clearance distance is unknown: all states count
        (800, True, {"config": WIDE}),
    ],
)
def test_h_counts_until_it_is_clear(judged, low_tick, violation, how):
    verdict = judged(low_tick, **how)
    assert verdict.outcome is (Outcome.ABORTED if how.get("declared", True) else Outcome.TIMEOUT)
    assert verdict.violation is violation
    assert verdict.h_min_m == (-0.2 if violation else 0.3)


def left_at(rows, tick, contacts=lambda r: 0, down_m_s=0.3):
    """Let the vehicle take off again at this tick, and be clear of the target 50 ticks later."""
    stamp = EPOCH_NS + tick * 10_000_000
    rows.steps = [r._replace(phase=Phase.LEAVE) if r.stamp_ns >= stamp else r for r in rows.steps]
    for r in rows.truth[tick + 1 :]:
        x, y, z = r.pad_position_enu_m
        clear, low = r.tick >= tick + 50, r.tick > tick + 50
        rows.truth[r.tick] = r._replace(
            position_enu_m=(x + (1.5 if clear else 0.05), y, z + 0.5), velocity_enu_m_s=(0.0, 0.0, -down_m_s),
            contacts=contacts(r), motors_running=True, h_min_outside_pad_m=-0.3 if low else math.inf,
        )  # fmt: skip


def rested(rows):
    """Return the tick at which the required time at rest ends, and the last tick."""
    off = max(r.tick for r in rows.truth if r.motors_running) + 1
    return off + round(2.0 / DT_S), len(rows.truth) - 1


def test_who_takes_off_again_after_its_rest_has_landed(verdict_of):
    rows = landing()
    tick, last = rested(rows)
    assert last > tick + 60
    left_at(rows, tick + 1, lambda r: GROUND if r.tick > last - 5 else 0)
    verdict = verdict_of(rows, config=CONFIG)
    assert verdict.outcome is Outcome.LANDED
    assert verdict.violation is False
    assert verdict.touchdown_error_m < 0.1


@pytest.mark.parametrize(
    ("early", "bits", "down_m_s", "outcome", "word"),
    [
        (30, 0, 0.3, Outcome.TIMEOUT, "it took off again"),
        (-1, GROUND, 1.5, Outcome.CRASHED, "fell to the ground"),
        (-1, EDGE, 0.3, Outcome.CRASHED, "pad edge"),
        (-1, ROBOT, 0.3, Outcome.CRASHED, "robot body"),
        (-1, GROUND | TUMBLED, 0.3, Outcome.CRASHED, "tumble"),
    ],
)
def test_a_second_flight_that_begins_too_early_or_ends_badly(
    verdict_of, early, bits, down_m_s, outcome, word
):
    rows = landing()
    tick, last = rested(rows)
    left_at(rows, tick - early, lambda r: bits if r.tick > last - 5 else 0, down_m_s)
    verdict = verdict_of(rows)
    assert verdict.outcome is outcome
    assert word in verdict.reason
