"""Replays a flight log as a regression test: the current controller must reproduce the log's outputs exactly.

The replay starts at tick 0 with a new controller. With another configuration the replay shows how the
commands change for the recorded inputs.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from flightstack.common.pacing import Tick
from flightstack.core.controller import Controller, Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Phase
from flightstack.onboard.state_text import state_text
from logs.compare import Tally, messages_of, values_of
from logs.reader.flight_data import phase_name
from logs.reader.reader import ROSOUT
from logs.replay.read import FlightInputs, ReplayError, TickRecord
from logs.replay.wire import WireReplay
from logs.schema.controller_rows import TickInputs, power_row, step_row
from logs.schema.events import CONTROLLER
from logs.schema.rows import ControllerStateRow, ControllerStepRow, LogRow
from logs.schema.schemas import CONTROLLER_POWER, CONTROLLER_STEP

__all__ = ["FlightInputs", "PhaseChange", "ReplayError", "Result", "replay"]

_ACTING = (Phase.APPROACH, Phase.LAND)


@dataclass(frozen=True, slots=True)
class PhaseChange:
    tick: int
    phase: str


@dataclass
class Result:
    """Differences that a replay found, and the range of ticks that it compared."""

    path: Path  # path of the log file
    compared: int = 0  # number of compared ticks, from tick 0 on
    outputs: Tally = field(default_factory=Tally)  # differences of decisions and events
    states: Tally = field(default_factory=Tally)  # differences of the controller's stored states
    # differences of the inputs and frames from the replayed MAVLink link; None if not replayed
    wire: Tally | None = None
    notes: list[str] = field(default_factory=list)  # parts that were not compared, with the reasons
    command_ticks: int = 0  # number of ticks in which the set-point differs
    command_first: int | None = None  # first tick in which the set-point differs; None: no tick
    command_most_m_s: float = 0.0  # largest difference of the set-points of one tick, m/s
    phases_recorded: list[PhaseChange] = field(default_factory=list)
    phases_replayed: list[PhaseChange] = field(default_factory=list)
    wall_s: float = 0.0  # wall time of the replay, s

    @property
    def equal(self) -> bool:
        return not (self.outputs.count or self.states.count or (self.wire is not None and self.wire.count))


def replay(path: Path | str, config: FlightConfig | None = None, member: str | None = None) -> Result:
    """Replay a flight with the logged or another configuration, and compare the outputs with the log."""
    began_s = time.perf_counter()
    flight = FlightInputs(path, member)
    run = _Run(flight, config)
    for record in run.whole(flight.ticks()):
        run.tick(record)
    result = run.result
    if flight.log.problem:
        result.notes.append(f"the log breaks off ({flight.log.problem}); compared up to there")
    if not run.acted:
        raise ReplayError(
            f"{flight.log.path}: the controller never sent a set-point in APPROACH or LAND in "
            f"{result.compared} ticks: equal outputs would prove nothing"
        )
    result.wall_s = time.perf_counter() - began_s
    return result


class _Run:
    """Passes the recorded inputs of each tick to the controller, and compares its outputs with the log."""

    def __init__(self, flight: FlightInputs, config: FlightConfig | None) -> None:
        self.flight, self.changed = flight, config is not None
        self.config = config if config is not None else flight.config()
        self.controller = Controller(self.config)
        self.result = Result(flight.log.path)
        self.text = state_text(self.config)
        self.wire: WireReplay | None = None
        if not self.changed and {"system_id", "lockstep"} <= flight.onboard.keys():
            self.result.wire = Tally()
            self.wire = WireReplay(flight, self.config, self.result.wire)
        elif not self.changed:
            self.result.notes.append("the log does not contain the vehicle's connection: wire not replayed")
        self.acted = False  # whether a set-point was sent in a phase of the landing

    def whole(self, ticks: Iterator[TickRecord]) -> Iterator[TickRecord]:
        """Yield the complete ticks of the log, up to the first gap or damage."""
        wanted, cut = 0, None  # number of the next tick; record of an incomplete tick
        for record in ticks:
            tick = None if record.given is None else record.given.tick
            good = tick == wanted and record.step is not None and cut is None
            if self.flight.log.problem and not good:
                break  # after the damage the state of the controller is unknown
            if tick not in (None, wanted) or (cut is not None and wanted):
                found = "" if tick is None else f", tick {tick} follows"
                raise ReplayError(
                    f"{self.flight.log.path}: inputs or decisions of tick {wanted} are missing{found}; a "
                    "replay over a gap proves nothing"
                )
            if good:
                wanted += 1
                yield record
            cut = record if wanted and not good else None
        if not wanted:
            raise ReplayError(f"{self.flight.log.path}: tick 0 with both inputs and decisions is missing")
        if cut is not None and cut.given is not None:
            self.result.notes.append(f"tick {wanted}, the last one, is not whole and was left out")

    def tick(self, record: TickRecord) -> None:
        given = record.given
        assert given is not None
        missing = ", ".join(map(str, () if record.told else self.config.fleet.others))
        if missing:
            raise ReplayError(
                f"{self.flight.log.path}: the messages of members {missing} at tick {given.tick} are missing "
                f"({self.flight.topic('controller/neighbours')}); without them the replay proves nothing"
            )
        if self.wire is not None:
            self.wire.take(record, given)
        out = self.controller.step(given.inputs, given.now_s, command_failed=given.command_failed)
        if self.wire is not None:
            self.wire.answer(record, given, out)
        self._compare(record, given, out)

    def _compare(self, record: TickRecord, given: TickInputs, out: Outputs) -> None:
        assert record.step is not None
        result, tick, topic, outputs = self.result, given.tick, self.flight.topic, self.result.outputs
        at = Tick(tick, given.now_s, given.stamp_ns, 0.0, 0.0)
        row = step_row(at, out)
        replayed = row.pack()
        outputs.add(topic("controller/step"), tick, messages_of(CONTROLLER_STEP, record.step, replayed))
        if record.power is not None and not self.changed:
            power = power_row(at, given.inputs.power, out.reserve).pack()
            outputs.add(topic("controller/power"), tick, messages_of(CONTROLLER_POWER, record.power, power))
        logger = self.flight.names.logger(CONTROLLER)
        events = [LogRow(given.stamp_ns, e.level, logger, e.text, "", "", 0) for e in out.events]
        outputs.add(ROSOUT, tick, values_of(record.events, events, "events"))
        if record.state is not None and not self.changed:
            self._compare_state(record.state)
        result.compared += 1
        if record.step == replayed:
            recorded = row
        else:
            try:
                recorded = ControllerStepRow.unpack(record.step)
            except ValueError:  # the difference is already counted; no detail is available
                return
            change = math.dist(recorded.command_enu_m_s, row.command_enu_m_s)
            if change != 0.0:  # NaN counts as the largest change
                result.command_ticks += 1
                result.command_first = tick if result.command_first is None else result.command_first
                if not change <= result.command_most_m_s:
                    result.command_most_m_s = change
        self.acted = self.acted or (recorded.setpoint_sent and recorded.phase in _ACTING)
        _note_phase(result.phases_recorded, tick, recorded.phase)
        _note_phase(result.phases_replayed, tick, row.phase)

    def _compare_state(self, recorded: ControllerStateRow) -> None:
        if recorded.layout != self.text.layout:
            note = "the snapshots are of another layout and were not compared"
            if note not in self.result.notes:
                self.result.notes.append(note)
            return
        state = self.text.dumps(self.controller.state)
        if recorded.state != state:
            try:
                found = list(values_of(json.loads(recorded.state), json.loads(state)))
            except ValueError:
                found = []
            found = found or [("state", recorded.state, state)]
            self.result.states.add(self.flight.topic("controller/state"), recorded.tick, found)


def _note_phase(changes: list[PhaseChange], tick: int, number: int) -> None:
    if not changes or changes[-1].phase != phase_name(number):
        changes.append(PhaseChange(tick, phase_name(number)))
