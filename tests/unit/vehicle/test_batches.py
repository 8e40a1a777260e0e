"""Tests that landings in compiled batches of ticks equal landings tick by tick, to the last bit."""

from dataclasses import fields, replace

import numpy as np
import pytest

import flightstack as fs
from examples.own_filter import Smooth
from flightstack.compiled.jit import is_off
from flightstack.core.strategies.user_filter import compiled_as
from sim.runners.landing import Flights, warm_up
from sim.scenarios.scenario import load
from sim.scenarios.tables import Start

pytestmark = pytest.mark.slow


def flown(scenario, seed, on_step=None, parameters=()):
    """Fly a landing; return the flight, its recorded data, and the number of ticks flown in batches."""
    flights, in_batches = Flights(scenario, seed, on_step=on_step), 0
    (flight,), batches = flights.members, flights.batches
    for name, value in parameters:
        flight.node.autopilot.parameters.preset(name, value)
    if batches is not None:
        fly = batches.fly

        def counted(tick):
            nonlocal in_batches
            done = fly(tick)
            in_batches += done
            return done

        batches.fly = counted
    flights.fly()
    return flight, flight.seen(), in_batches


def assert_equal(scenario, seed, least, *parameters):
    """Assert that a flight in batches equals a flight tick by tick; return the data of the flight in batches.

    At least the fraction ``least`` of the ticks is flown in batches; without numba no tick is.
    """
    one, seen, in_batches = flown(scenario, seed, None, parameters)
    other, wanted, none = flown(scenario, seed, lambda tick, out: None, parameters)
    assert in_batches == 0 if is_off() else in_batches >= least * len(wanted.steps.t_s)
    assert none == 0
    for part in ("truth", "steps"):
        for field in fields(getattr(wanted, part)):
            a, b = (getattr(getattr(each, part), field.name) for each in (seen, wanted))
            assert a.dtype == b.dtype
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), (part, field.name)
    assert seen.events == wanted.events
    assert repr(one.controller.state) == repr(other.controller.state)
    return seen


@pytest.mark.parametrize(("filter_name", "least"), [("robust", 0.8), ("paper", 0.68)])
@pytest.mark.parametrize(("name", "seed"), [("field", 3), ("lab", 4), ("storm", 5), ("deck", 6), ("room", 7)])
def test_a_landing_in_batches_is_the_same_to_the_last_bit(name, seed, filter_name, least):
    assert_equal(load(name).with_filter(filter_name), seed, least)


@pytest.mark.skipif(is_off(), reason="without numba no tick is compiled")
def test_messages_that_repeat_known_values_end_no_call_of_compiled_code():
    flights, ticks = Flights(load("lab"), 4), []
    call = flights.batches._call

    def counted(*arguments):
        flown, how = call(*arguments)
        ticks.append(flown)
        return flown, how

    flights.batches._call = counted
    flights.fly()
    assert sum(ticks) / len(ticks) > 16  # 14 if each SYS_STATUS and EXTENDED_SYS_STATE ended a call


@pytest.mark.parametrize(
    ("rate_hz", "filter_name"),
    [(10, "robust"), (15, "paper"), (37, "robust"), (144, "paper"), (500, "robust")],
)
def test_at_every_rate_a_landing_in_batches_is_the_same(rate_hz, filter_name):
    """The loop rates include rates below and above those of the telemetry streams."""
    room = load("room")
    config = replace(room.onboard, loop=replace(room.onboard.loop, rate_hz=rate_hz))
    least = 0.3 if rate_hz > 20 else 0.0  # at low rates VFR_HUD, 10 Hz, is due in most ticks
    assert_equal(replace(room, onboard=config).with_filter(filter_name), 5, least)


def test_batches_and_python_alternate_where_the_target_is_lost():
    field = load("field")
    rare = replace(field, odometry=replace(field.odometry, loss=0.3, dropout_every_s=0.5, dropout_max_s=0.6))
    assert_equal(rare, 7, 0.3)


def test_from_the_ground_at_another_rate():
    field = load("field")
    takeoff = replace(field.onboard.takeoff, start_offset_m=(-1.0, 0.0, 1.0))
    config = replace(field.onboard, loop=replace(field.onboard.loop, rate_hz=50), takeoff=takeoff)
    assert_equal(replace(field, start=Start(ground_position_m=(-1.2, 0.3)), onboard=config), 1, 0.3)


def test_a_thrust_reserve_that_ends_in_a_batch_is_seen_at_the_same_tick():
    room = load("room")
    reserve = replace(room.onboard.reserve, lowest_voltage_v=3.12, start_margin_v=0.0)
    vehicle = replace(room.vehicle, battery_charge=(0.1, 0.1), hover_reserve=0.0)
    tired = replace(room, vehicle=vehicle, onboard=replace(room.onboard, reserve=reserve))
    (ends,) = [event for event in assert_equal(tired, 1, 0.05).events if "battery is too low" in event.text]
    assert ends.t_s > 1.0


@pytest.mark.parametrize("name", ["paper_moving_1", "fault_motor_dead"])
def test_what_a_batch_does_not_know_is_flown_tick_by_tick(name):
    assert Flights(load(name), 0).batches is None


def test_it_is_compiled_before_the_first_landing():
    field = load("field")
    warm_up(field)
    batches = Flights(field, 0).batches
    assert (batches is None) == is_off()
    if batches is not None:
        batches.warm_up()
        assert batches.fly(0) == 0  # no tick is flown, because the flight has not received any message


class Slower(fs.Filter):
    def filter(self, nominal, at):
        return 0.5 * nominal


class Restless(fs.Filter):
    """Filter that changes one of its own fields in flight; compiled code must then use the new value."""

    def filter(self, nominal, at):
        if at.d_m < 0.3:
            self.acceleration_max_m_s2 = (0.4, 0.4, 0.4)
        return at.enforced(nominal)


class Curious(fs.Filter):
    def filter(self, nominal, at):
        return nominal * (1.0 if self.tracking else 0.0)


class Otherwise(fs.Filter):
    def filter(self, nominal, at):
        return nominal

    def descent_m_s(self, at):
        return (0.0, 0.0, -0.1)


class Failing(fs.Filter):
    def filter(self, nominal, at):
        return nominal if at.h_m > 0.3 else nominal[:2]


def test_which_filters_of_a_user_are_compiled_but_for_their_method():
    base = {each: compiled_as(each) for each in (Slower, Smooth, Restless, Failing, Curious, Otherwise)}
    assert [each.__name__ for each, found in base.items() if found is fs.Filter] == [
        "Slower", "Smooth", "Restless", "Failing",
    ]  # fmt: skip
    assert base[Curious] is base[Otherwise] is None


@pytest.mark.parametrize(
    ("filter", "least"), [(Slower, 0.7), (Smooth, 0.7), (Restless, 0.05), (Failing, 0.0), (Curious, 0.0)]
)
def test_a_filter_of_ones_own_flies_the_same_in_batches_and_is_called_once_in_a_tick(filter, least):
    """``Smooth`` stores the velocity of its last call, so a second call in a tick would change the flight."""
    assert_equal(fs.scenario("lab", filter=filter), 4, least)
