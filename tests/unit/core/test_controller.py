"""Tests the controller: start of a flight, take-off by set-points and its failures, landing on command."""

import pytest

from flightstack.core.controller import RISE_FREE_S, Controller
from flightstack.core.memory import AbortWay
from flightstack.core.types import (
    ZERO,
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
from tests.unit.core.core_helpers import config

CONFIG = config()
TICK_S = 1.0 / CONFIG.loop.rate_hz


class Bench:
    """Runs ticks of a controller with vehicle states and status values that the test gives."""

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
        sway_m = 1e-4 * (self.tick % 2)  # a small motion, because a real sensor does not repeat its values
        own = OwnState(now_s, now_s, (xy[0] + sway_m, xy[1], z), velocity, 0.0)
        sample = TargetSample(
            now_s, now_s, "map", "target", (sway_m, 0.0, 0.2), (0.0, 0.0, 0.0), 0.0, 0.0
        )  # fmt: skip
        return self.controller.step(Inputs(own, status, (sample,), operator), now_s)

    def wait(self, **said):
        """Run ticks on the ground until the take-off starts; it must start within twice the required time."""
        while (out := self.step(**said)).phase is Phase.WAIT:
            assert self.tick * TICK_S < 2.0 * CONFIG.checks.recovery_time_s
        return out


FLIES = {"armed": True, "mode": Mode.EXTERNAL, "landed": Landed.IN_AIR}


def test_a_climb_is_sent_from_the_first_tick_and_stands_on_the_ground_without_complaint():
    """A vehicle on the ground need not follow its set-points until the thrust has ramped up."""
    bench = Bench()
    assert bench.wait().phase is Phase.TAKEOFF
    waits = bench.step()
    assert waits.request is Request.TAKEOFF
    assert waits.setpoint is not None
    assert not bench.memory.lifting  # outside external mode, the vehicle is not expected to follow
    ramps = {"armed": True, "mode": Mode.EXTERNAL}
    sent = [bench.step(**ramps).setpoint.velocity_enu_m_s for _ in range(400)]
    assert bench.memory.lifting
    assert sent[-1] == pytest.approx((0.0, 0.0, CONFIG.limits.velocity_max_m_s[2]))
    assert bench.controller.plausibility.tracking_lag_m == 0.0
    assert bench.controller.state.tracking.disturbance_m_s == (0.0, 0.0, 0.0)
    assert bench.memory.phase is Phase.TAKEOFF


def standing(now_s, arrived):
    """Return the newest inputs of a vehicle on the ground at ``now_s``; ``arrived``: arrival times, s."""
    own_s, status_s, target_s = (max((t for t in times if t <= now_s), default=None) for times in arrived)
    own = None if own_s is None else OwnState(own_s, own_s, (1.5, 0.0, 1e-4 * own_s), ZERO, 0.0)
    status = None
    if status_s is not None:
        status = VehicleStatus(status_s, False, Mode.HOLD, Landed.ON_GROUND, True)
    sample = TargetSample(now_s, now_s, "map", "target", (1e-4 * now_s, 0.0, 0.2), ZERO, 0.0, 0.0)
    return Inputs(own, status, (sample,) if target_s == now_s else ())


def every(period_s, until_s=20.0, first_s=0.0):
    return [round(first_s + n * period_s, 2) for n in range(int((until_s - first_s) / period_s))]


WELL = (every(0.02), every(1.0), every(0.02))
CHECKS = CONFIG.checks


@pytest.mark.parametrize(
    ("own", "status", "target", "starts_s"),
    [
        (*WELL, 1.0),  # the take-off starts at the second heartbeat
        (WELL[0], every(0.1), WELL[2], CHECKS.recovery_time_s),
        (WELL[0], every(0.1), every(0.02, first_s=3.0), 3.0 + CHECKS.recovery_time_s),
        (every(CHECKS.own_age_max_s + 0.05), every(0.1), WELL[2], None),  # 4 Hz is too slow
        (WELL[0], every(0.1), every(CHECKS.target_age_max_s + 0.08), None),  # 3 Hz is too slow
        (WELL[0], every(CHECKS.status_age_max_s + 2.0), WELL[2], None),
        (WELL[0], every(0.1), [0.0], None),  # later samples are rejected, as with a constant time stamp
        (WELL[0], every(0.1), [t for t in every(0.02) if t % 0.5 < 0.1], None),  # samples arrive in bursts
    ],
)
def test_it_takes_off_after_inputs_that_were_good_without_a_gap(own, status, target, starts_s):
    controller, began = Controller(CONFIG), []
    for tick in range(2000):
        out = controller.step(
            standing(round(tick * TICK_S, 2), (own, status, target)), round(tick * TICK_S, 2)
        )
        if out.phase is not Phase.WAIT:
            began.append(tick * TICK_S)
            break
    # the tolerance includes the delay of the target samples
    assert began == ([] if starts_s is None else [pytest.approx(starts_s, abs=0.06)])


def test_in_the_climb_going_sideways_is_not_following_and_climbing_slowly_is():
    bench = Bench()
    bench.wait(armed=True, mode=Mode.EXTERNAL)
    for tick in range(100):
        assert bench.step(0.05 + 0.0005 * tick, (0.0, 0.0, 0.05), **FLIES).request is Request.EXTERNAL
    assert bench.controller.plausibility.tracking_lag_m == pytest.approx(0.0, abs=1e-6)
    for tick in range(100):
        out = bench.step(0.1, (0.4, 0.0, 0.0), xy=(1.5 + 0.004 * tick, 0.0), **FLIES)
    assert out.phase is Phase.ABORT
    assert bench.memory.reason.startswith("vehicle does not follow its velocity set-points: it lags 0.")


def test_a_take_off_that_does_not_rise_is_given_up_once_the_ramp_must_be_over():
    """A vehicle that hops near the ground, and reports that it is in the air but does not climb, aborts."""
    bench = Bench()
    bench.wait(armed=True, mode=Mode.EXTERNAL)
    for tick in range(round(RISE_FREE_S / TICK_S) - 1):
        out = bench.step(0.02, (0.0, 0.0, 0.05 * (-1) ** tick), **FLIES)
    assert out.phase is Phase.TAKEOFF
    assert bench.controller.plausibility.tracking_lag_m == pytest.approx(0.0, abs=1e-6)
    for _ in range(round(CONFIG.checks.follow_memory_s / TICK_S)):
        out = bench.step(0.02, **FLIES)
    assert (out.phase, out.request) == (Phase.ABORT, Request.LAND)
    assert bench.memory.abort_way is AbortWay.LAND_HERE
    assert bench.memory.reason.startswith("vehicle does not follow its velocity set-points: it lags 0.")


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
