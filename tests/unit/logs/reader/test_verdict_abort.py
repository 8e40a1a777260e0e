"""After a declared abort h counts until the vehicle has flown clear, and not a moment less."""

from dataclasses import replace

import pytest

from flightstack.common.pacing import EPOCH_NS
from flightstack.core.parameters.flight import BarrierShape, Checks, FlightConfig
from flightstack.core.types import Phase
from logs.reader.flight import load_flight
from logs.verdict.verdict import Outcome, judge
from tests.synthetic_flight import landing, write_log

CLEAR_M = 1.0
ABORT_TICK, CLEAR_TICK = 600, 700
CONFIG = FlightConfig(BarrierShape(alpha_1_m=1.0, beta_m=1.5), checks=Checks(clearance_m=CLEAR_M))


@pytest.fixture
def judged(tmp_path):
    """Judge an abort at tick 600 that is out of the clearance distance from tick 700 on."""

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


# the state that first shows it clear holds the minimum of the physics steps before it: it still counts
@pytest.mark.parametrize(
    ("low_tick", "violation"),
    [
        (550, True),
        (650, True),
        (CLEAR_TICK - 1, True),
        (CLEAR_TICK, True),
        (CLEAR_TICK + 1, False),
        (800, False),
    ],
)
def test_h_counts_until_it_is_clear(judged, low_tick, violation):
    verdict = judged(low_tick)
    assert verdict.outcome is Outcome.ABORTED
    assert verdict.violation is violation
    assert verdict.h_min_m == (-0.2 if violation else 0.3)


def test_without_a_declared_abort_all_counts(judged):
    verdict = judged(800, declared=False)
    assert verdict.outcome is Outcome.TIMEOUT
    assert verdict.violation is True


def test_with_an_unknown_clearance_distance_all_counts(judged):
    assert judged(800, config=None).violation is True


def test_a_wider_clearance_distance_counts_longer(judged):
    wide = replace(CONFIG, checks=Checks(clearance_m=2.0))
    assert judged(800, config=wide).violation is True
