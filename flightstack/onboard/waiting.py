"""Reasons why a flight waits, as texts for the operator, each with the setting that limits the wait."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from operator import attrgetter
from typing import NamedTuple

from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.client.senders import Arrivals, why_silent
from flightstack.core.controller import WARN, Outputs
from flightstack.core.memory import Memory
from flightstack.core.mission.conditions import target_below
from flightstack.core.mission.machine import DRIFT_CAUSES
from flightstack.core.parameters.flight import Checks, FlightConfig
from flightstack.core.types import Landed, Mode, Phase, VehicleStatus
from flightstack.onboard.zenoh_wires import ZenohWires

PERIOD_S = 2.0  # time between two reports, s
_FLYING = frozenset({Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING})
_REASON_SEVERITY = 4  # MAV_SEVERITY_WARNING; texts with a lower severity are not used as reasons
_REASONS = 3  # maximum number of vehicle texts in one report
_REASON_AGE_MAX_S = 15.0  # maximum age of a reason, s; PX4 and ArduPilot repeat their reasons sooner
_CAUSE_AGE_MAX_S = 5.0  # maximum age of a text that explains a disarm, s; two heartbeats (1 Hz) may be lost
_PROBLEMS = 2  # maximum number of sample errors in one report


class VehicleSeen(NamedTuple):
    """Data that the vehicle link has received so far."""

    heartbeat_age_s: float | None  # age of the newest heartbeat; None: no heartbeat received
    silence: str  # reason for a missing heartbeat (``senders.why_silent``)
    own_age_s: float | None  # age of the newest vehicle state; None: no state received
    own_believed: bool  # whether position and velocity agree
    # positions rejected since the last report, by cause (fields of ``StateCounters``)
    refused: Mapping[str, int]
    status: VehicleStatus | None  # newest status of the vehicle
    readiness_told: bool  # whether SYS_STATUS, which reports readiness to arm, was received
    says: tuple[str, ...]  # newest texts of the vehicle that may be reasons
    heartbeat_every_s: float = 0.0  # longest interval between two heartbeats since the last report
    own_every_s: float = 0.0  # longest interval between two vehicle states since the last report


class TargetSeen(NamedTuple):
    """Data that the target's link has received so far."""

    name: str  # key or topic that the user gave
    age_s: float | None  # age of the newest accepted sample; None: no sample
    arrived: int  # samples since the last report, including rejected ones
    problems: tuple[str, ...]  # why samples could not be decoded
    keys: tuple[str, ...]  # other keys that might be a target
    contradicts: bool = False  # whether positions contradict the velocity
    every_s: float = 0.0  # longest interval between two accepted samples since the last report
    below: str = ""  # why the landing spot is implausible; empty: plausible


def missing(vehicle: VehicleSeen, target: TargetSeen, checks: Checks) -> tuple[str, ...]:
    """Return the known causes that delay the start of the flight, one sentence each."""
    return (*_of_vehicle(vehicle, checks), *_of_target(target, checks))


def _seldom(what: str, every_s: float, age_s: float | None, key: str, most_s: float) -> tuple[str, ...]:
    """Return a text if inputs arrive too rarely for their age limit."""
    if every_s <= most_s or age_s is None or age_s > every_s:
        return ()
    return (f"{what}: one every {every_s:.2f} s ({1.0 / every_s:.1f} Hz); checks.{key} allows {most_s:g} s",)


def _of_vehicle(seen: VehicleSeen, checks: Checks) -> tuple[str, ...]:
    age_s, most_s, status = seen.heartbeat_age_s, checks.status_age_max_s, seen.status
    if seldom := _seldom("heartbeats", seen.heartbeat_every_s, age_s, "status_age_max_s", most_s):
        return seldom
    if age_s is None or age_s > most_s or status is None:
        return (seen.silence,)
    return (*_of_position(seen, checks), *_of_status(seen, status))


def _of_position(seen: VehicleSeen, checks: Checks) -> tuple[str, ...]:
    age_s, most_s = seen.own_age_s, checks.own_age_max_s
    if seldom := _seldom("positions", seen.own_every_s, age_s, "own_age_max_s", most_s):
        return seldom
    if age_s is None or age_s > most_s:
        old = "no position: the vehicle sends no LOCAL_POSITION_NED, as long as it has no estimate of it"
        if age_s is not None:
            old = f"position is {age_s:.1f} s old; checks.own_age_max_s allows {most_s:g}"
        return (next((text for name, text in _REFUSED.items() if seen.refused.get(name)), old),)
    if not seen.own_believed:
        return ("position and velocity of the vehicle do not agree (checks.own_drift_max_m)",)
    return ()


_REFUSED = {
    "not_finite": "positions contain numbers that are not finite or out of range",
    "without_yaw": "positions arrive without ATTITUDE, which contains the heading",
    "out_of_order": "positions have a time that does not advance",
    "ahead": "positions have a time in the future",
}


def _of_status(seen: VehicleSeen, status: VehicleStatus) -> tuple[str, ...]:
    texts: list[str] = []
    if status.landed is Landed.UNKNOWN:
        texts.append("the vehicle does not report whether it stands (EXTENDED_SYS_STATE)")
    if status.landed in _FLYING and status.mode is not Mode.EXTERNAL:
        texts.append(f"the vehicle is in the air and in mode {status.mode.name}: another client controls it")
    if not (status.armed or status.ready_to_arm):
        says = f"; it reports: {' | '.join(seen.says)}" if seen.says else ""
        fails = "the vehicle's own pre-arm checks fail (SYS_STATUS)"
        unknown = "the vehicle does not report whether it may be armed (SYS_STATUS)"
        texts.append((fails if seen.readiness_told else unknown) + says)
    return tuple(texts)


def _of_target(seen: TargetSeen, checks: Checks) -> tuple[str, ...]:
    if seen.contradicts:
        causes = f"checks.target_drift_max_m is {checks.target_drift_max_m:g}; {DRIFT_CAUSES}"
        return (f"position and velocity of the target do not agree; {causes}",)
    name, most_s = f"samples on {seen.name}", checks.target_age_max_s
    if seldom := _seldom(name, seen.every_s, seen.age_s, "target_age_max_s", most_s):
        return seldom
    if seen.age_s is not None and seen.age_s <= most_s:
        return (seen.below,) if seen.below else ()
    problems = f": {' | '.join(seen.problems)}" if seen.problems else ""
    if seen.arrived:
        return (f"{seen.arrived} samples on {seen.name}, none accepted{problems}",)
    if seen.age_s is not None:
        age, most = f"{seen.age_s:.1f} s old", f"{checks.target_age_max_s:g}"
        return (f"the newest sample on {seen.name} is {age}; checks.target_age_max_s allows {most}",)
    if problems:
        return (f"no sample on {seen.name} any more; of earlier ones{problems}",)
    there = f"there are {', '.join(seen.keys)}" if seen.keys else "nor on any key like odometry or pose"
    return (f"no sample on {seen.name}; {there}",)


class _Pace:
    """Longest interval between arrivals since the last report; after few arrivals, the newest interval."""

    def __init__(self) -> None:
        self._last_s, self._longest_s, self._reported = math.nan, 0.0, True

    def note(self, arrival_s: float) -> None:
        """Record the newest arrival time; repeated calls with an equal time have no effect."""
        interval_s, self._last_s = arrival_s - self._last_s, arrival_s
        if interval_s > 0.0:  # not true for NaN, before the second arrival
            self._longest_s = interval_s if self._reported else max(interval_s, self._longest_s)
            self._reported = False

    def report(self) -> float:
        """Return the longest interval, s; 0 before the second arrival."""
        self._reported = True
        return self._longest_s


# Phases that continue without messages of the vehicle: setting that limits the phase, effect of this limit.
# Without these messages any other phase ends immediately.
_BOUNDS: Mapping[Phase, tuple[str, str]] = {
    Phase.WAIT: ("checks.wait_time_max_s", "gives up"),
    Phase.HOLD: ("checks.hold_time_s", "aborts"),
    Phase.TOUCHDOWN: ("touchdown.timeout_s", "aborts"),
    Phase.ABORT: ("retreat.abort_time_max_s", "ends"),
}


def countdown(config: FlightConfig, phase: Phase, in_phase_s: float) -> str:
    """Return a text with the end of the phase, its latest time and the setting; empty without a limit."""
    if phase not in _BOUNDS:
        return ""
    setting, then = _BOUNDS[phase]
    left_s = max(0.0, attrgetter(setting)(config) - in_phase_s)
    return f"{then} within {left_s:.0f} s ({setting})"


class WaitReport:
    """Reporter of waits: call ``note_text`` with the vehicle's texts, and ``step`` in every tick."""

    def __init__(
        self, config: FlightConfig, system_id: int, link: VehicleLink, wires: ZenohWires, *, searches: bool
    ) -> None:
        """``searches``: search other keys if no sample arrives."""
        # missing inputs in the last report; they remain after the end of the wait
        self.lacking: tuple[str, ...] = ()
        self._config, self._system_id, self._link, self._wires = config, system_id, link, wires
        self._searches = searches
        self._due_s = PERIOD_S
        self._arrivals = Arrivals()
        self._refused: dict[str, int] = {}
        self._arrived = self._refused_before = self._accepted = 0  # numbers of target samples
        self._heartbeats, self._states, self._samples = _Pace(), _Pace(), _Pace()
        # newest texts of the vehicle that may be reasons, and newest ones of any severity, with their newest
        # arrival time
        self._reasons: dict[str, float] = {}
        self._recent: dict[str, float] = {}
        self._refusals: deque[str] = deque(maxlen=_PROBLEMS)

    def note_text(self, now_s: float, severity: int, text: str) -> None:
        """Store a text of the vehicle."""
        for texts in (self._recent, *([self._reasons] if severity <= _REASON_SEVERITY else [])):
            texts.pop(text, None)
            texts[text] = now_s
            if len(texts) > _REASONS:
                del texts[next(iter(texts))]

    def cause(self, now_s: float) -> str:
        """Return why the autopilot acted without a command: its newest messages, or that none arrived."""
        says = [text for text, at_s in self._recent.items() if now_s - at_s <= _CAUSE_AGE_MAX_S]
        if says:
            return f"the autopilot reports: {' | '.join(says)}"
        return f"the autopilot sent no reason (no STATUSTEXT or EVENT for {_CAUSE_AGE_MAX_S:g} s)"

    def step(
        self, out: Outputs, memory: Memory, arrived: int, problems: Sequence[str], now_s: float
    ) -> str | None:
        """Return the text for the operator, if one is due.

        ``arrived``: number of target samples in this tick; ``problems``: why some could not be decoded.
        """
        phase = out.phase
        if phase not in (Phase.WAIT, Phase.ABORT):
            self.lacking = ()
        if phase is Phase.WAIT:
            self._note_arrivals(out, now_s)
            self._arrived += arrived
            self._refusals.extend(text for text in problems if text not in self._refusals)
            for event in out.events:  # during the wait, all warnings are about rejected samples
                if event.level == WARN and event.text not in self._refusals:
                    self._refusals.append(event.text)
        else:
            self._wires.search.stop()
        if now_s < self._due_s or phase is Phase.LANDED:
            return None
        self._due_s = now_s + PERIOD_S
        left = countdown(self._config, phase, now_s - memory.phase_since_s)
        if phase is Phase.WAIT:
            self.lacking = missing(self._vehicle(out, now_s), self._target(out), self._config.checks)
            self._refusals.clear()
            return f"waiting: {'; '.join(self.lacking)}; {left}" if self.lacking else None
        status = out.snapshot.inputs.status
        text = self._silence(now_s - status.arrival_s if status is not None else None)
        if out.snapshot.link_ok or status is None:
            return None
        return f"{text}; {left}" if left else text

    def _note_arrivals(self, out: Outputs, now_s: float) -> None:
        own, status = out.snapshot.inputs.own, out.snapshot.inputs.status
        if own is not None:
            self._states.note(own.arrival_s)
        if status is not None:
            self._heartbeats.note(status.arrival_s)
        if out.target_accepted != self._accepted:
            self._accepted = out.target_accepted
            self._samples.note(now_s)

    def _silence(self, heard_s: float | None) -> str:
        """Return why no heartbeat has arrived for this time; None: none has ever arrived."""
        grown = self._arrivals.grown(self._link.endpoint.counters)
        time = f" for {heard_s:.0f} s" if heard_s is not None else ""
        return why_silent(self._system_id, grown, self._link.counters.senders, time=time)

    def _vehicle(self, out: Outputs, now_s: float) -> VehicleSeen:
        link, own, status = self._link, out.snapshot.inputs.own, out.snapshot.inputs.status
        heard_s = now_s - status.arrival_s if status is not None else None
        own_age_s = now_s - own.arrival_s if own is not None else None
        before, self._refused = self._refused, asdict(link.state.counters)
        return VehicleSeen(
            heartbeat_age_s=heard_s,
            silence=self._silence(heard_s),
            own_age_s=own_age_s,
            own_believed=out.snapshot.own_ok
            or own_age_s is None
            or own_age_s > self._config.checks.own_age_max_s,
            refused={name: n - before.get(name, 0) for name, n in self._refused.items()},
            status=status,
            readiness_told=link.state.battery is not None,
            says=tuple(text for text, at_s in self._reasons.items() if now_s - at_s <= _REASON_AGE_MAX_S),
            heartbeat_every_s=self._heartbeats.report(),
            own_every_s=self._states.report(),
        )

    def _target(self, out: Outputs) -> TargetSeen:
        target, wires = out.snapshot.target, self._wires
        refused, self._refused_before = wires.odometry.refused - self._refused_before, wires.odometry.refused
        arrived, self._arrived = self._arrived + refused, 0
        age_s = target.age_s if target is not None else None
        lost = age_s is None or age_s > self._config.checks.target_age_max_s
        search = self._searches and lost and not arrived
        if not search:
            wires.search.stop()
        found = dict.fromkeys((*wires.odometry.told[-_PROBLEMS:], *self._refusals))
        problems = tuple(text.removeprefix(f"{wires.target.text}: ") for text in found)[:_PROBLEMS]
        return TargetSeen(
            name=wires.target.text,
            age_s=age_s if age_s is None or math.isfinite(age_s) else None,
            arrived=arrived,
            problems=problems,
            keys=wires.search.keys() if search else (),
            contradicts=out.snapshot.target_placed,
            every_s=self._samples.report(),
            below=target_below(self._config, out.snapshot),
        )
