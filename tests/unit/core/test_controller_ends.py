"""The controller from the ground up by set-points, down at a bounded speed, and told to land at once."""

import pytest

from flightstack.common.strict_toml import from_table
from flightstack.core.controller import RISE_FREE_S, Controller
from flightstack.core.memory import AbortWay
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import (
    Inputs,
    Landed,
    Mode,
    Operator,
    OwnState,
    Phase,
    Request,
    TargetSample,
    VehicleStatus,
)

CONFIG = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}})
TICK_S = 1.0 / CONFIG.loop.rate_hz


class Bench:
    """Ticks of a controller; own state and status are what the test says."""

    def __init__(self):
        self.controller, self.tick = Controller(CONFIG), 0

    @property
    def memory(self):
        return self.controller.memory

    def step(self, z=0.0, velocity=(0.0, 0.0, 0.0), *, xy=(1.5, 0.0), operator=Operator.NONE, **said):
        self.tick += 1
        now_s = self.tick * TICK_S
        word = {"armed": False, "mode": Mode.HOLD, "landed": Landed.ON_GROUND, **said}
        status = VehicleStatus(now_s, word["armed"], word["mode"], word["landed"], True)
        sway_m = 1e-4 * (self.tick % 2)  # no sensor repeats to the last bit
        own = OwnState(now_s, now_s, (xy[0] + sway_m, xy[1], z), velocity, 0.0)
        sample = TargetSample(
            now_s, now_s, "map", "target", (sway_m, 0.0, 0.2), (0.0, 0.0, 0.0), 0.0, 0.0
        )  # fmt: skip
        return self.controller.step(Inputs(own, status, (sample,), operator), now_s)


FLIES = {"armed": True, "mode": Mode.EXTERNAL, "landed": Landed.IN_AIR}


def test_a_climb_is_sent_from_the_first_tick_and_stands_on_the_ground_without_complaint():
    """PX4 follows only what streams, then spools up and ramps: nothing of that is a vehicle not following."""
    bench = Bench()
    assert bench.step().phase is Phase.TAKEOFF
    waits = bench.step()
    assert waits.request is Request.TAKEOFF
    assert waits.setpoint is not None
    assert not bench.memory.lifting  # not in the mode that follows: nothing of it is in force
    ramps = {"armed": True, "mode": Mode.EXTERNAL}
    sent = [bench.step(**ramps).setpoint.velocity_enu_m_s for _ in range(400)]
    assert bench.memory.lifting
    assert sent[-1] == pytest.approx((0.0, 0.0, CONFIG.limits.velocity_max_m_s[2]))
    assert bench.controller.plausibility.tracking_lag_m == 0.0
    assert bench.controller.state.tracking.disturbance_m_s == (0.0, 0.0, 0.0)
    assert bench.memory.phase is Phase.TAKEOFF


def test_in_the_climb_going_sideways_is_not_following_and_climbing_slowly_is():
    bench = Bench()
    for _ in range(5):
        bench.step(armed=True, mode=Mode.EXTERNAL)
    for tick in range(100):
        assert bench.step(0.05 + 0.0005 * tick, (0.0, 0.0, 0.05), **FLIES).request is Request.EXTERNAL
    assert bench.controller.plausibility.tracking_lag_m == pytest.approx(0.0, abs=1e-6)
    for tick in range(100):
        out = bench.step(0.1, (0.4, 0.0, 0.0), xy=(1.5 + 0.004 * tick, 0.0), **FLIES)
    assert out.phase is Phase.ABORT
    assert bench.memory.reason.startswith("the vehicle does not fly what it is told: it lags 0.")


def test_a_take_off_that_does_not_rise_is_given_up_once_the_ramp_must_be_over():
    """Hops near the ground: told to climb, in the air by its own word, and never gets up."""
    bench = Bench()
    bench.step(armed=True, mode=Mode.EXTERNAL)
    for tick in range(round(RISE_FREE_S / TICK_S)):
        out = bench.step(0.02, (0.0, 0.0, 0.05 * (-1) ** tick), **FLIES)
    assert out.phase is Phase.TAKEOFF
    assert bench.controller.plausibility.tracking_lag_m == pytest.approx(0.0, abs=1e-6)
    for _ in range(round(CONFIG.checks.follow_memory_s / TICK_S)):
        out = bench.step(0.02, **FLIES)
    assert (out.phase, out.request) == (Phase.ABORT, Request.LAND)
    assert bench.memory.abort_way is AbortWay.LAND_HERE
    assert bench.memory.reason.startswith("the vehicle does not fly what it is told: it lags 0.")


def test_a_take_off_that_rises_faster_than_wanted_goes_on():
    bench = Bench()
    for _ in range(round(RISE_FREE_S / TICK_S) + 1):
        bench.step(0.0, armed=True, mode=Mode.EXTERNAL)
    most_m_s = CONFIG.limits.velocity_max_m_s[2]
    for tick in range(20):
        out = bench.step(0.01 * tick, (0.0, 0.0, 2.0 * most_m_s), **FLIES)
        assert out.phase is Phase.TAKEOFF
    assert bench.memory.lifting
    assert bench.controller.plausibility.tracking_lag_m == pytest.approx(0.0, abs=1e-6)


def test_high_enough_it_is_under_control_as_a_whole():
    bench = Bench()
    bench.step(armed=True, mode=Mode.EXTERNAL)
    for tick in range(120):
        out = bench.step(0.005 * tick, (0.0, 0.0, 0.5), **FLIES)
    assert bench.memory.climbed
    assert bench.memory.commanding
    assert not bench.memory.lifting
    assert out.request is Request.EXTERNAL


def test_told_to_end_it_lands_where_it_is():
    bench = Bench()
    for _ in range(3):
        bench.step(1.0, **FLIES)
    assert bench.memory.phase is Phase.APPROACH
    out = bench.step(1.0, operator=Operator.LAND, **FLIES)
    assert (out.phase, out.request) == (Phase.ABORT, Request.LAND)
    assert bench.memory.abort_way is AbortWay.LAND_HERE
    assert bench.step(1.0, operator=Operator.LAND, **FLIES).events == ()


def test_told_to_end_while_it_flies_clear_it_lands_and_the_emergency_stop_is_still_above():
    bench = Bench()
    for _ in range(3):
        bench.step(1.0, xy=(0.5, 0.0), **FLIES)
    bench.step(1.0, xy=(0.5, 0.0), operator=Operator.ABORT, **FLIES)
    assert bench.memory.abort_way is AbortWay.FLY_CLEAR
    assert bench.step(1.0, xy=(0.5, 0.0), operator=Operator.ABORT, **FLIES).events == ()
    out = bench.step(1.0, xy=(0.5, 0.0), operator=Operator.LAND, **FLIES)
    assert out.request is Request.LAND
    assert [event.text for event in out.events] == ["ABORT: ended by the operator (land here)"]
    out = bench.step(1.0, xy=(0.5, 0.0), operator=Operator.EMERGENCY_STOP, **FLIES)
    assert out.request is Request.MOTORS_OFF
    assert bench.step(1.0, operator=Operator.EMERGENCY_STOP, **FLIES).events == ()


def test_the_set_point_of_the_touchdown_leads_to_a_bounded_speed():
    """The lead for the lag alone would ask for more."""
    bench = Bench()
    height_m = 0.2 + CONFIG.robust.commit_height_m - 0.02
    sent = []
    for _ in range(200):
        out = bench.step(height_m, xy=(0.0, 0.0), **FLIES)
        if out.phase is Phase.TOUCHDOWN and out.setpoint is not None:
            learned_m_s = bench.controller.state.tracking.disturbance_m_s[2]
            sent.append(out.setpoint.velocity_enu_m_s[2] + learned_m_s)
    most_m_s = CONFIG.robust.descent_m_s + CONFIG.robust.descent_lead_max_m_s
    assert min(sent) == pytest.approx(-most_m_s, abs=5e-3)  # the pad's velocity is estimated
