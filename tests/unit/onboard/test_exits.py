"""Tests that after each exit, in each phase, the vehicle has a command to land or another controller.

The table in docs/how_it_works/failures.md lists these exits.
"""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, field
from enum import Enum

import pytest

from flightstack.common.pacing import Tick
from flightstack.core.controller import Controller
from flightstack.core.memory import AbortWay
from flightstack.core.types import Landed, Mode, OwnState, Phase, Request, VehicleStatus
from flightstack.onboard import runner
from flightstack.onboard.leaving import Ended, Leaving, Signals
from flightstack.onboard.runner import NOTHING, ClockStoppedError, Runner, VehicleInputs
from sim.scenarios.scenario import load

CONFIG = load("grid").onboard
PERIOD_S = 1.0 / CONFIG.loop.rate_hz
EXIT_S = 0.05  # time from the start of the flight to the exit, s


class Breaks(Enum):
    """Part whose calls fail from the tick of the exit on."""

    CLOCK = "wait"
    TARGET = "samples"
    VEHICLE = "answer"
    LOG = "write"
    CONTROLLER = "step"


@dataclass
class Flight:
    """Minimal clock, vehicle, target and log in one object; the vehicle executes commands immediately."""

    exits: object  # function that is called once, with this flight, at ``EXIT_S``
    armed: bool = True
    mode: Mode = Mode.EXTERNAL
    landed: Landed = Landed.IN_AIR
    deaf: bool = False
    broken: Breaks | None = None
    error: BaseException = field(default_factory=lambda: RuntimeError("broken"))
    asked: list[Request] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    now_s: float = -PERIOD_S

    def _break(self, part):
        if self.broken is part:
            raise self.error

    def wait(self):
        self.now_s += PERIOD_S
        if self.now_s >= EXIT_S and self.exits is not None:
            exits, self.exits = self.exits, None
            exits(self)
        self._break(Breaks.CLOCK)
        assert self.now_s < 60.0, "nothing ends the flight"
        return Tick(round(self.now_s / PERIOD_S), self.now_s, 0, PERIOD_S, 0.0)

    def samples(self, now_s):
        self._break(Breaks.TARGET)
        return NOTHING

    def statuses(self):
        return ()

    def read(self):
        own = OwnState(self.now_s, self.now_s, (2.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0)
        return VehicleInputs(own, VehicleStatus(self.now_s, self.armed, self.mode, self.landed, True), False)

    def answer(self, out, now_s):
        self._break(Breaks.VEHICLE)
        self.ask(out.request, now_s)

    def ask(self, request, now_s):
        self.asked.append(request)
        if self.deaf:
            return
        if request is Request.LAND:
            self.mode = Mode.LAND
        if request is Request.MOTORS_OFF:
            self.armed = False

    def landing_began(self, tick):
        pass

    def write(self, tick, taken, out, exec_s):
        self._break(Breaks.LOG)


PHASES = {
    "WAIT": (Phase.WAIT, {"armed": False, "landed": Landed.ON_GROUND, "mode": Mode.HOLD}, {}),
    "WAIT, somebody else flies": (Phase.WAIT, {"mode": Mode.HOLD}, {}),
    "TAKEOFF, not armed yet": (Phase.TAKEOFF, {"armed": False, "landed": Landed.ON_GROUND}, {}),
    "TAKEOFF": (Phase.TAKEOFF, {}, {}),
    "APPROACH": (Phase.APPROACH, {}, {}),
    "LAND": (Phase.LAND, {}, {}),
    "TOUCHDOWN": (Phase.TOUCHDOWN, {}, {}),
    "HOLD": (Phase.HOLD, {}, {}),
    "CLIMB": (Phase.CLIMB, {}, {}),
    "LEAVE": (Phase.LEAVE, {}, {}),
    "ABORT, flies clear": (Phase.ABORT, {}, {"abort_way": AbortWay.FLY_CLEAR}),
    "ABORT, lands": (Phase.ABORT, {}, {"abort_way": AbortWay.LAND_HERE}),
    "ABORT, hands off": (Phase.ABORT, {}, {"abort_way": AbortWay.HANDS_OFF}),
    "LANDED": (Phase.LANDED, {"armed": False, "landed": Landed.ON_GROUND}, {}),
    "LANDED, armed by somebody else": (Phase.LANDED, {"mode": Mode.HOLD}, {}),
}
NOT_OURS = {name for name in PHASES if name.startswith(("WAIT", "LANDED"))} | {"ABORT, hands off"}


def raises(part, error):
    def exits(flight):
        flight.broken, flight.error = part, error

    return exits


def signals(*numbers):
    def exits(flight):
        for number in numbers:
            os.kill(os.getpid(), number)

    return exits


ERRORS = [RuntimeError("broken"), OSError(28, "No space left on device"), SystemExit(1), KeyboardInterrupt(),
          MemoryError(), AssertionError(), BrokenPipeError(32, "Broken pipe")]  # fmt: skip
EXITS = {
    "SIGTERM": signals(signal.SIGTERM),
    "Ctrl-C twice": signals(signal.SIGINT, signal.SIGINT),
    "the link ends": raises(Breaks.CLOCK, ClockStoppedError("no further message from the vehicle")),
    "a refusal": lambda flight: flight.refuse("two senders"),
    **{
        f"{type(error).__name__} in {part.value}": raises(part, error)
        for number, part in enumerate(Breaks)
        for error in (ERRORS[number % len(ERRORS)], ERRORS[(number + 3) % len(ERRORS)])
    },
}


def flown(exits, name="APPROACH", duration_s=None, **more):
    """Fly one phase from the start until the exit; return the fakes of vehicle and links, and the result."""
    phase, seen, remembered = PHASES[name]
    flight, controller = Flight(exits, **(seen | more)), Controller(CONFIG)
    memory = controller.memory
    memory.phase, memory.phase_since_s = phase, 0.0
    memory.was_armed = memory.was_external = phase is not Phase.WAIT and "not armed" not in name
    for key, value in remembered.items():
        setattr(memory, key, value)
    step = controller.step

    def guarded(*arguments, **named):
        flight._break(Breaks.CONTROLLER)
        return step(*arguments, **named)

    controller.step = guarded
    leaving = Leaving(duration_s, Signals())
    refusals = []
    flight.refuse = refusals.append
    ended = leaving.ended
    leaving.ended = lambda out, memory, status, now_s: (
        Ended(out.phase, refusals[0], 1) if refusals else ended(out, memory, status, now_s)
    )
    return flight, Runner(controller, flight, leaving, flight.write).fly(flight.said.append)


@pytest.mark.parametrize("name", PHASES)
@pytest.mark.parametrize("exits", EXITS.values(), ids=EXITS)
def test_every_exit_in_every_phase_lands_or_is_not_ours(exits, name):
    flight, ended = flown(exits, name)
    assert ended.exit_code == 1
    if name in NOT_OURS:
        assert Request.LAND not in flight.asked
        assert "lands" not in ended.reason
        return
    assert flight.asked[-1] is Request.LAND
    assert flight.mode is Mode.LAND
    if flight.armed:
        assert ended.reason.endswith("; the vehicle lands")


@pytest.mark.parametrize("exits", EXITS.values(), ids=EXITS)
def test_a_vehicle_that_does_not_show_it_is_waited_for_no_longer_than_allowed(exits, monkeypatch):
    monkeypatch.setattr(runner, "LAND_SHOWN_MAX_S", 0.1)
    flight, ended = flown(exits, deaf=True)
    assert flight.asked[-1] is Request.LAND
    assert ended.reason.endswith("did not report in 0.1 s that it lands")


@pytest.mark.parametrize(
    "name", [name for name in PHASES if name not in NOT_OURS and "not armed" not in name]
)
def test_an_emergency_stop_outweighs_the_landing(name):
    flight, ended = flown(signals(signal.SIGQUIT, signal.SIGTERM), name)
    assert flight.asked[-1] is Request.MOTORS_OFF
    assert not flight.armed
    assert ended.exit_code == 1


@pytest.mark.parametrize("name", ["TAKEOFF", "APPROACH", "LAND", "TOUCHDOWN", "HOLD", "CLIMB", "LEAVE"])
@pytest.mark.parametrize(
    ("exits", "duration_s"), [(signals(signal.SIGINT), None), (signals(signal.SIGHUP), None), (None, EXIT_S)]
)
def test_one_ctrl_c_a_closed_terminal_and_a_time_that_is_over_are_an_abort_by_the_controller(
    name, exits, duration_s
):
    flight, ended = flown(exits, name, duration_s)
    assert ended.phase is Phase.ABORT
    assert Request.LAND in flight.asked


@pytest.mark.parametrize(("exits", "duration_s"), [(signals(signal.SIGINT), None), (None, EXIT_S)])
def test_a_vehicle_that_somebody_else_flies_is_not_landed_by_who_only_waits(exits, duration_s):
    flight, ended = flown(exits, "WAIT, somebody else flies", duration_s)
    assert ended.phase is Phase.WAIT
    assert Request.LAND not in flight.asked


def test_an_abort_that_lasts_too_long_asks_for_the_landing_before_it_ends():
    flight, ended = flown(None, "ABORT, flies clear")
    assert flight.now_s >= CONFIG.retreat.abort_time_max_s
    assert ended.reason.endswith("; the vehicle lands")
