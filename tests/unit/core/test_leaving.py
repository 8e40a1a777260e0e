"""The onboard process never leaves a vehicle in the air without having asked for its landing."""

from types import SimpleNamespace

import pytest

from flightstack.core import leaving
from flightstack.core.leaving import LAND_SHOWN_MAX_S, Leaving, Patience
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.types import Landed, Mode, Operator, Phase, VehicleStatus


def status(mode=Mode.EXTERNAL, *, armed=True):
    return VehicleStatus(0.0, armed, mode, Landed.IN_AIR, True)


def out(phase=Phase.APPROACH, *, finished=False):
    return SimpleNamespace(phase=phase, finished=finished)


def test_nothing_ends_by_itself():
    flight = Leaving(None)
    assert flight.operator(Operator.ABORT, status(), 1e9) is Operator.ABORT
    assert flight.ended(out(), Memory(), status(), 1e9) is None


def test_a_stop_in_flight_asks_for_the_landing_until_it_shows():
    flight = Leaving(None)
    assert flight.operator(Operator.ABORT, status(), 5.0, stop=True) is Operator.LAND
    assert flight.ended(out(), Memory(), status(), 5.0, stop=True) is None
    assert flight.operator(Operator.NONE, status(), 5.3, stop=True) is Operator.LAND
    ended = flight.ended(out(Phase.ABORT), Memory(), status(Mode.LAND), 5.3, stop=True)
    assert ended == (Phase.ABORT, "ended by the operator; the vehicle lands", 1)


def test_a_landing_that_never_shows_is_waited_for_no_longer_than_a_second():
    flight = Leaving(None)
    flight.operator(Operator.NONE, status(), 5.0, stop=True)
    last_s = 5.0 + LAND_SHOWN_MAX_S
    assert flight.ended(out(), Memory(), status(), last_s - 1e-6, stop=True) is None
    ended = flight.ended(out(), Memory(), status(), last_s, stop=True)
    assert "did not show in 1 s that it lands" in ended.reason
    assert ended.exit_code == 1


@pytest.mark.parametrize("seen", [None, status(armed=False)])
def test_what_does_not_fly_is_left_at_once(seen):
    flight = Leaving(3.0)
    assert flight.operator(Operator.NONE, seen, 1.0, stop=True) is Operator.NONE
    assert flight.ended(out(Phase.WAIT), Memory(), seen, 1.0, stop=True) == (
        Phase.WAIT, "ended by the operator", 1,
    )  # fmt: skip
    assert flight.ended(out(Phase.WAIT), Memory(), seen, 3.0) == (Phase.WAIT, "3 s are over", 1)
    assert flight.ended(out(Phase.WAIT), Memory(), seen, 2.99) is None


def test_what_somebody_else_flies_is_left_to_them():
    flight, theirs = Leaving(3.0), Memory(abort_way=AbortWay.HANDS_OFF)
    flight.operator(Operator.NONE, status(), 1.0, stop=True)
    assert flight.ended(out(), theirs, status(), 1.0, stop=True).reason == "ended by the operator"
    assert flight.ended(out(), theirs, status(), 3.0).reason == "3 s are over"


def test_a_time_that_is_over_in_flight_is_an_abort():
    flight = Leaving(3.0)
    assert flight.operator(Operator.NONE, status(), 2.99) is Operator.NONE
    assert flight.operator(Operator.NONE, status(), 3.0) is Operator.ABORT
    assert flight.ended(out(), Memory(), status(), 3.0) is None
    down = flight.ended(out(Phase.ABORT, finished=True), Memory(reason="abort"), status(armed=False), 9.0)
    assert down == (Phase.ABORT, "abort; 3 s are over", 1)
    in_time = flight.ended(out(Phase.LANDED, finished=True), Memory(reason="motors off"), status(), 2.0)
    assert in_time == (Phase.LANDED, "motors off", 0)


def test_the_emergency_stop_is_above_all():
    flight = Leaving(0.0)
    assert flight.operator(Operator.EMERGENCY_STOP, status(), 1.0, stop=True) is Operator.EMERGENCY_STOP


def test_lockstep_waits_for_others_no_longer_than_a_second(monkeypatch):
    now, stop = SimpleNamespace(s=100.0), SimpleNamespace(asked=False)
    monkeypatch.setattr(leaving, "time", SimpleNamespace(monotonic=lambda: now.s))
    patience = Patience(lambda: stop.asked)
    assert not patience.over()
    stop.asked, now.s = True, 200.0
    assert not patience.over()
    now.s += LAND_SHOWN_MAX_S - 1e-6
    assert not patience.over()
    now.s += 2e-6
    assert patience.over()
