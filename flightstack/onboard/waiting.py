"""Reasons why a flight waits, as texts for the operator, each with the setting that limits the wait."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter

from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.client.senders import why_silent
from flightstack.core.controller import WARN, Outputs
from flightstack.core.memory import Memory
from flightstack.core.mission.conditions import target_below
from flightstack.core.mission.machine import DRIFT_CAUSES
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.snapshot import Snapshot
from flightstack.core.types import Landed, Mode, Phase
from flightstack.onboard.zenoh_wires import ZenohWires

PERIOD_S = 2.0  # time between two reports, s
_FLYING = frozenset({Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING})
_REASON_SEVERITY = 4  # MAV_SEVERITY_WARNING; less severe texts are not used as reasons
_REASONS = 3  # maximum number of vehicle texts in one report
_REASON_AGE_MAX_S = 15.0  # maximum age of a reason, s; PX4 and ArduPilot repeat reasons earlier
_CAUSE_AGE_MAX_S = 5.0  # maximum age of a text that explains a disarm, s; two heartbeats (1 Hz) can be lost
_PROBLEMS = 2  # maximum number of texts about rejected samples in one report


class _Pace:
    """Longest interval between arrivals since the last report; after the report, until the next arrival."""

    def __init__(self) -> None:
        self._last_s, self._longest_s, self._reported = math.nan, 0.0, True

    def note(self, arrival_s: float) -> None:
        """Record the newest arrival time; repeated calls with an equal time have no effect."""
        interval_s, self._last_s = arrival_s - self._last_s, arrival_s
        if interval_s > 0.0:  # before the second arrival the interval is NaN
            self._longest_s = interval_s if self._reported else max(interval_s, self._longest_s)
            self._reported = False

    def seldom(self, what: str, age_s: float, key: str, most_s: float) -> str:
        """Return a text if inputs arrive too rarely for their age limit; then reset the longest interval."""
        every_s, self._reported = self._longest_s, True
        if every_s <= most_s or not age_s <= every_s:
            return ""
        return f"{what}: one every {every_s:.2f} s ({1.0 / every_s:.1f} Hz); checks.{key} allows {most_s:g} s"


_REFUSED = {  # texts by the names of ``VehicleState.counters``
    "not_finite": "positions contain numbers that are not finite or out of range",
    "without_yaw": "positions arrive without ATTITUDE, which contains the heading",
    "out_of_order": "positions have a time that does not advance",
    "ahead": "positions have a time in the future",
}
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
    """Reports of a wait: call ``note_text`` with the vehicle's texts, and ``step`` in every tick."""

    def __init__(
        self, config: FlightConfig, system_id: int, link: VehicleLink, wires: ZenohWires, *, searches: bool
    ) -> None:
        """``searches``: whether to search for samples on other keys if none arrives."""
        # texts about missing inputs in the last report; an abort of the wait does not clear them
        self.lacking: tuple[str, ...] = ()
        self._config, self._system_id, self._link, self._wires = config, system_id, link, wires
        self._searches, self._due_s = searches, PERIOD_S
        # counters of endpoint and vehicle state, and refused target samples, at the last report
        self._counted, self._refused, self._refused_samples = Counter[str](), Counter[str](), 0
        self._arrived = self._accepted = 0  # number of target samples: since the last report; in the flight
        self._heartbeats, self._states, self._samples = _Pace(), _Pace(), _Pace()
        # newest texts of the vehicle that can be reasons, and newest texts of any severity, each with its
        # newest arrival time, s
        self._reasons: dict[str, float] = {}
        self._recent: dict[str, float] = {}
        self._refusals: deque[str] = deque(maxlen=_PROBLEMS)

    def note_text(self, now_s: float, severity: int, text: str) -> None:
        """Store a text that the vehicle sent, with its MAV_SEVERITY."""
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

        ``arrived``: number of target samples in this tick; ``problems``: errors of undecodable samples.
        """
        phase, snapshot = out.phase, out.snapshot
        own, status = snapshot.inputs.own, snapshot.inputs.status
        if phase not in (Phase.WAIT, Phase.ABORT):
            self.lacking = ()
        if phase is Phase.WAIT:
            if own is not None:
                self._states.note(own.arrival_s)
            if status is not None:
                self._heartbeats.note(status.arrival_s)
            if out.target_accepted != self._accepted:
                self._accepted = out.target_accepted
                self._samples.note(now_s)
            self._arrived += arrived
            # during the wait, all warnings are about rejected samples
            warnings = [event.text for event in out.events if event.level == WARN]
            self._refusals.extend(text for text in (*problems, *warnings) if text not in self._refusals)
        else:
            self._wires.search.stop()
        if now_s < self._due_s or phase is Phase.LANDED:
            return None
        self._due_s = now_s + PERIOD_S
        left = countdown(self._config, phase, now_s - memory.phase_since_s)
        if phase is Phase.WAIT:
            self.lacking = (*self.of_vehicle(snapshot, now_s), *self.of_target(snapshot))
            self._refusals.clear()
            return f"waiting: {'; '.join(self.lacking)}; {left}" if self.lacking else None
        text = self._silence(now_s - status.arrival_s if status is not None else math.inf)
        if snapshot.link_ok or status is None:
            return None
        return f"{text}; {left}" if left else text

    def _silence(self, heard_s: float) -> str:
        """Return why no heartbeat has arrived for ``heard_s``; infinity: none has ever arrived."""
        counted, self._counted = self._counted, self._link.endpoint.counters.copy()
        time = f" for {heard_s:.0f} s" if math.isfinite(heard_s) else ""
        return why_silent(self._system_id, self._counted - counted, self._link.foreign, time=time)

    def of_vehicle(self, at: Snapshot, now_s: float) -> Iterator[str]:
        """Yield a sentence for each missing input from the vehicle, with counts since the previous call."""
        checks, own, status = self._config.checks, at.inputs.own, at.inputs.status
        heard_s = now_s - status.arrival_s if status is not None else math.inf
        age_s = now_s - own.arrival_s if own is not None else math.inf
        refused = self._link.state.counters - self._refused
        self._refused = self._link.state.counters.copy()
        silence = self._silence(heard_s)
        beats = self._heartbeats.seldom("heartbeats", heard_s, "status_age_max_s", checks.status_age_max_s)
        rare = self._states.seldom("positions", age_s, "own_age_max_s", checks.own_age_max_s)
        if beats or status is None or heard_s > checks.status_age_max_s:
            yield beats or silence
            return
        if rare:
            yield rare
        elif age_s > checks.own_age_max_s:
            old = f"position is {age_s:.1f} s old; checks.own_age_max_s allows {checks.own_age_max_s:g}"
            never = (
                "no position: the vehicle sends no LOCAL_POSITION_NED, as long as it has no estimate of it"
            )
            causes = (text for name, text in _REFUSED.items() if refused[name])
            yield next(causes, never if own is None else old)
        elif not at.own_ok:
            yield "position and velocity of the vehicle do not agree (checks.own_drift_max_m)"
        if status.landed is Landed.UNKNOWN:
            yield "the vehicle does not report whether it stands (EXTENDED_SYS_STATE)"
        if status.landed in _FLYING and status.mode is not Mode.EXTERNAL:
            yield (f"the vehicle is in the air and in mode {status.mode.name}: another client controls it")
        if not (status.armed or status.ready_to_arm):
            says = [text for text, at_s in self._reasons.items() if now_s - at_s <= _REASON_AGE_MAX_S]
            fails = "the vehicle's own pre-arm checks fail (SYS_STATUS)"
            unknown = "the vehicle does not report whether it may be armed (SYS_STATUS)"
            reports = f"; it reports: {' | '.join(says)}" if says else ""
            yield (fails if self._link.state.battery is not None else unknown) + reports

    def of_target(self, at: Snapshot) -> Iterator[str]:
        """Yield at most one sentence, why the target is not usable, with counts since the previous call."""
        wires, checks = self._wires, self._config.checks
        most_s, name = checks.target_age_max_s, f"samples on {wires.target.text}"
        arrived = self._arrived + wires.odometry.refused - self._refused_samples
        self._arrived, self._refused_samples = 0, wires.odometry.refused
        age_s = at.target.age_s if at.target is not None else math.inf
        lost = not age_s <= most_s
        keys: Sequence[str] = ()
        if self._searches and lost and not arrived:
            keys = wires.search.keys()
        else:
            wires.search.stop()
        found = dict.fromkeys((*wires.odometry.told[-_PROBLEMS:], *self._refusals))
        texts = [text.removeprefix(f"{wires.target.text}: ") for text in found][:_PROBLEMS]
        problems = f": {' | '.join(texts)}" if texts else ""
        rare = self._samples.seldom(name, age_s, "target_age_max_s", most_s)
        if at.target_placed:
            causes = f"checks.target_drift_max_m is {checks.target_drift_max_m:g}; {DRIFT_CAUSES}"
            yield f"position and velocity of the target do not agree; {causes}"
        elif rare:
            yield rare
        elif not lost:
            yield from filter(None, [target_below(self._config, at)])
        elif arrived:
            yield f"{arrived} {name}, none accepted{problems}"
        elif math.isfinite(age_s):
            allowed = f"checks.target_age_max_s allows {most_s:g}"
            yield f"the newest sample on {wires.target.text} is {age_s:.1f} s old; {allowed}"
        elif problems:
            yield f"no sample on {wires.target.text} any more; of earlier ones{problems}"
        else:
            there = f"there are {', '.join(keys)}" if keys else "nor on any key like odometry or pose"
            yield f"no sample on {wires.target.text}; {there}"
