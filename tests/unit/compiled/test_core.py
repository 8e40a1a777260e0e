"""Tests that a controller makes equal decisions with and without compiled functions, to the last bit."""

import math
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.compiled import core, jit
from flightstack.compiled.core import chosen_core, compiled
from flightstack.compiled.jit import OFF, is_off, jitted
from flightstack.compiled.objects import Objects
from flightstack.core.controller import Controller
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import Phase
from sim.runners.landing import Flights
from sim.scenarios.scenario import load
from tests.examples import examples

numbers = st.floats(-3.0, 3.0)
any_numbers = st.one_of(numbers, st.sampled_from((math.nan, math.inf, -math.inf, 0.0)))
PROGRAM = SafetyFilter(0.7)
vectors, sides = st.tuples(any_numbers, any_numbers, any_numbers), st.floats(0.0, 1.0)


@jitted
def answered(one, given):
    return one.solve(*given)


def both(given):
    """Solve a quadratic program in Python and in compiled code; return both results without wall times."""
    if is_off():
        pytest.skip("nothing is compiled")
    return PROGRAM.solve(*given)._replace(solve_s=0.0), answered(Objects(PROGRAM), given)


def flown(scenario, make):
    """Fly a landing; return all decisions and the controller's last state, without wall times."""
    rows = []

    def note(_tick, out):
        barrier = out.barrier
        if barrier is not None:
            barrier = barrier._replace(result=barrier.result._replace(solve_s=0.0))
        setpoint = out.setpoint
        told = (setpoint.velocity_enu_m_s, setpoint.yaw_rad) if setpoint is not None else None
        state = repr(flight.controller.state) if len(rows) % 50 == 0 else ""
        rows.append((repr((out._replace(barrier=barrier, setpoint=None), told)), state))

    controller = make(scenario.onboard)
    flights = Flights(scenario, 3, on_step=note, controller=controller)
    (flight,) = flights.members
    flights.fly()
    return rows, repr(flight.controller.state)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "filter_name"), [("storm", "robust"), ("storm", "paper"), ("room", "robust")]
)
def test_each_step_of_a_landing_is_the_same_to_the_last_bit(name, filter_name):
    scenario = load(name).with_filter(filter_name)
    by_python = flown(scenario, Controller)
    by_machine = flown(scenario, compiled)
    assert len(by_python[0]) > 300
    assert by_machine == by_python


@pytest.mark.slow
def test_ordinary_ticks_of_a_landing_are_compiled_and_all_others_are_pythons(monkeypatch):
    if is_off():
        return
    by_python, step = [], Controller.step

    def counted(controller, inputs, now_s, **keys):
        out = step(controller, inputs, now_s, **keys)
        by_python.append(out.phase)
        return out

    monkeypatch.setattr(Controller, "step", counted)
    rows, _ = flown(load("lab"), compiled)
    landing = [phase for phase in by_python if phase in (Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN)]
    assert len(landing) < 0.1 * len(rows)
    assert type(compiled(load("lab").onboard)).__name__ == "CompiledController"
    assert type(compiled(load("fleet_3").onboard)) is Controller


@given(vectors, any_numbers, vectors, any_numbers, vectors, st.tuples(sides, sides, sides))
@examples(500)
def test_any_program_is_answered_alike(nominal, h_m, gradient, dh_dt_m_s, lower, size):
    upper = tuple(low + each for low, each in zip(lower, size, strict=True))
    by_python, by_machine = both((nominal, h_m, gradient, dh_dt_m_s, lower, upper))
    assert repr(by_machine) == repr(by_python)


def test_which_core_is_flown(monkeypatch):
    monkeypatch.delenv(OFF, raising=False)
    config = load("lab").onboard
    for warm in (False, True):
        monkeypatch.setattr(core, "is_kept", lambda _, warm=warm: warm)
        assert chosen_core("auto", config, lockstep=True) == "plain"
        assert chosen_core("auto", config, lockstep=False) == ("compiled" if warm else "plain")
        for asked in ("plain", "compiled"):
            assert chosen_core(asked, config, lockstep=warm) == asked
    fleet = load("fleet_3").onboard
    assert chosen_core("auto", fleet, lockstep=False) == "plain"
    with pytest.raises(ValueError, match="--core compiled: found filter robust"):
        chosen_core("compiled", fleet, lockstep=False)
    monkeypatch.setenv(OFF, "1")
    assert chosen_core("auto", config, lockstep=False) == "plain"
    with pytest.raises(ValueError, match="--core compiled: numba is not installed, or switched off"):
        chosen_core("compiled", config, lockstep=False)


@pytest.mark.parametrize(
    ("asked", "status", "said"), [("auto", 1, "core plain"), ("compiled", 2, "pip install")]
)
def test_without_numba_and_mujoco_the_onboard_process_misses_nothing(asked, status, said):
    words = ["onboard", "--config", "sitl-1kg", "--vehicle", "udpout:127.0.0.1:9", "--target", "x/odom"]
    words += ["--duration", "0.1", "--no-record", "--core", asked]
    absent = "sys.modules.update(dict.fromkeys(['numba', 'llvmlite', 'mujoco']))"
    code = f"import sys; {absent}; sys.argv[1:] = {words}; from flightstack.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == status, done.stderr
    assert said in done.stdout + done.stderr


def test_the_machine_code_of_other_sources_or_another_filter_is_not_warm(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path)
    monkeypatch.setattr("flightstack.compiled.tick.CompiledController", Controller)  # compile nothing
    robust, paper = (load("lab").with_filter(name).onboard for name in ("robust", "paper"))
    assert chosen_core("auto", robust, lockstep=False) == "plain"
    compiled(robust)
    expected = "plain" if is_off() else "compiled"
    assert chosen_core("auto", robust, lockstep=False) == expected
    assert chosen_core("auto", paper, lockstep=False) == "plain"
