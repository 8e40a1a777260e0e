"""A person's abort and emergency stop, given in every phase of a flight, and what the vehicle does then."""

from __future__ import annotations

import gc
import signal

import numpy as np
import pytest

from flightstack.core.types import Operator, Phase
from logs.reader.flight import load_flight
from sim.scenarios.fault_spec import Fault
from sim.scenarios.fault_table import Kind, What
from sim.scenarios.scenario import path_of
from sim.vehicle.vehicle import warm_up
from tests.fault_grid.flight import Flight
from tests.fault_grid.run import SEED, end_of, impact, scenario
from tests.fault_grid.words import End
from tests.integration.runs import Flying

STOPPED_S = 0.3  # s from the emergency stop until the motors are off
# what leads into the phases that an undisturbed flight does not have
LOST = Fault(What.TARGET_ODOMETRY, Kind.OFF)
AT_ONCE, LATER_S = 0.0, 0.3
# phase and s in it: on the ground, and off it
MOMENTS = [
    (Phase.WAIT, AT_ONCE), (Phase.TAKEOFF, AT_ONCE), (Phase.TAKEOFF, 3.0), (Phase.APPROACH, LATER_S),
    (Phase.LAND, LATER_S), (Phase.TOUCHDOWN, AT_ONCE), (Phase.LANDED, LATER_S), (Phase.HOLD, LATER_S),
    (Phase.CLIMB, LATER_S), (Phase.ABORT, LATER_S),
]  # fmt: skip
SILENT = """
[[fault]]
what = "own_state"
kind = "stuck"
after = "takeoff"
start_s = 4.0
"""
OFF_COURSE = (Phase.HOLD, Phase.CLIMB, Phase.ABORT)


@pytest.fixture(scope="module", autouse=True)
def compiled():
    warm_up(scenario())
    gc.collect()


def fly(asked: Operator, phase: Phase, after_s: float):
    """A flight in which a person asks so long after a phase began."""
    since = []

    def moment(flight: Flight) -> bool:
        memory = flight.controller.memory
        if phase in OFF_COURSE and flight.phase is Phase.APPROACH and not since:
            since.append(flight.now_ns)
            flight.target.fail(LOST, flight.now_ns)
        return flight.phase is phase and flight.now_ns * 1e-9 - memory.phase_since_s >= after_s

    flown = Flight(scenario(), SEED, moment, lambda flight: setattr(flight, "operator", asked)).fly()
    gc.collect()
    return flown


def test_all_phases_are_tried():
    assert {phase for phase, _ in MOMENTS} == set(Phase)


def named(moments):
    return [f"{phase.name.lower()} {after_s:g} s" for phase, after_s in moments]


@pytest.mark.parametrize(("phase", "after_s"), MOMENTS, ids=named(MOMENTS))
def test_the_emergency_stop_stops_the_motors_from_every_phase(phase, after_s):
    flown = fly(Operator.EMERGENCY_STOP, phase, after_s)
    assert flown.phases[-1] is (Phase.LANDED if phase is Phase.LANDED else Phase.ABORT)
    assert not flown.truth.motors_running[-1]
    assert flown.down_s <= STOPPED_S
    off = int(np.searchsorted(flown.truth.t_s, flown.disturbed_at_s + STOPPED_S))
    assert not flown.truth.motors_running[off:].any()  # and nothing starts them again


@pytest.mark.parametrize(("phase", "after_s"), MOMENTS, ids=named(MOMENTS))
def test_an_abort_ends_safely_on_ground_or_pad_from_every_phase(phase, after_s):
    flown = fly(Operator.ABORT, phase, after_s)
    assert flown.phases[-1] is (Phase.LANDED if phase is Phase.LANDED else Phase.ABORT)
    truth = flown.truth
    assert not truth.motors_running[-1]
    assert impact(truth) < 1.0
    on_ground = phase is Phase.WAIT or (phase, after_s) == (Phase.TAKEOFF, AT_ONCE)
    ends = {End.LANDED} if phase in (Phase.LANDED,) else {End.ABORTED}
    assert end_of(flown) in ends
    if on_ground:
        assert truth.position_enu_m[:, 2].max() < 0.05
    elif phase is not Phase.LANDED:
        clear_m = flown.seen.config.checks.clearance_m
        assert truth.d_m[-1] > (clear_m if Phase.APPROACH in flown.phases else 0.5)


def test_ctrl_backslash_stops_the_motors_of_a_run(tmp_path):
    run = Flying(tmp_path, "--scenario", "grid", "--lockstep")
    run.wait_for("-> TAKEOFF")
    run.process.send_signal(signal.SIGQUIT)
    run.wait_for("-> ABORT: emergency stop (motors off)")
    assert run.end() == 1


def test_after_an_abort_the_run_goes_on_until_the_vehicle_stands(tmp_path):
    file = tmp_path / "silent.toml"
    file.write_text(path_of("grid").read_text() + SILENT)
    run = Flying(tmp_path / "out", "--scenario", file, "--lockstep")
    run.wait_for("-> ABORT")
    assert run.end() == 1
    truth = load_flight(tmp_path / "out" / "flight.mcap").truth
    assert truth.position_enu_m[:, 2].max() > 0.5
    assert truth.position_enu_m[-1, 2] < 0.05
    assert not truth.motors_running[-1]
