"""The causes for which a flight waits, as texts for a person, each with the setting that limits it. Pure.

``missing`` judges what the links have shown; ``countdown`` says what ends a phase, and when.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from flightstack.core.parameters.flight import Checks, FlightConfig
from flightstack.core.types import Landed, Mode, Phase, VehicleStatus

PERIOD_S = 2.0  # s between two reports
_FLYING = frozenset({Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING})


class VehicleSeen(NamedTuple):
    """What the vehicle link has received so far.

    Attributes:
        heartbeat_age_s: of the newest heartbeat; None: there was none.
        silence: sentence for a heartbeat that does not come (``bridge.mavlink.client.silence``).
        own_age_s: of the newest own state; None: there was none.
        own_believed: its position and velocity agree.
        refused: positions refused since the last report, by cause (fields of ``StateCounters``).
        status: newest status.
        readiness_told: SYS_STATUS, which says whether it may be armed, has come.
        says: its newest texts that may be reasons.
    """

    heartbeat_age_s: float | None
    silence: str
    own_age_s: float | None
    own_believed: bool
    refused: Mapping[str, int]
    status: VehicleStatus | None
    readiness_told: bool
    says: tuple[str, ...]


class TargetSeen(NamedTuple):
    """What the target's link has received so far.

    Attributes:
        name: key or topic, as given.
        age_s: of the newest sample that was believed; None: there was none.
        arrived: samples since the last report, believed or not, those that made no odometry included.
        problems: what was found wrong with samples.
        keys: others that a target might be under.
    """

    name: str
    age_s: float | None
    arrived: int
    problems: tuple[str, ...]
    keys: tuple[str, ...]


def missing(vehicle: VehicleSeen, target: TargetSeen, checks: Checks) -> tuple[str, ...]:
    """Return the known causes that keep the flight from beginning, one sentence each.

    Args:
        vehicle: what its link has shown.
        target: what its link has shown.
        checks: limits of the configuration.
    """
    return (*_of_vehicle(vehicle, checks), *_of_target(target, checks))


def _of_vehicle(seen: VehicleSeen, checks: Checks) -> tuple[str, ...]:
    age_s, status = seen.heartbeat_age_s, seen.status
    if age_s is None or age_s > checks.status_age_max_s or status is None:
        return (seen.silence,)
    return (*_of_position(seen, checks), *_of_status(seen, status))


def _of_position(seen: VehicleSeen, checks: Checks) -> tuple[str, ...]:
    age_s = seen.own_age_s
    if age_s is None or age_s > checks.own_age_max_s:
        causes = (
            ("not_finite", "positions come with numbers that are not finite or beyond any sense"),
            ("without_yaw", "positions come without ATTITUDE, which has their heading"),
            ("out_of_order", "positions come with a time that does not advance"),
        )
        for name, text in causes:
            if seen.refused.get(name):
                return (text,)
        if age_s is None:
            return (
                "no position: the vehicle sends no LOCAL_POSITION_NED, as long as it has no estimate of it",
            )
        return (f"position is {age_s:.1f} s old; checks.own_age_max_s allows {checks.own_age_max_s:g}",)
    if not seen.own_believed:
        return ("position and velocity of the vehicle do not agree (checks.own_drift_max_m)",)
    return ()


def _of_status(seen: VehicleSeen, status: VehicleStatus) -> tuple[str, ...]:
    texts: list[str] = []
    if status.landed is Landed.UNKNOWN:
        texts.append("the vehicle does not say whether it stands (EXTENDED_SYS_STATE)")
    if status.landed in _FLYING and status.mode is not Mode.EXTERNAL:
        texts.append(f"the vehicle is in the air and in mode {status.mode.name}: somebody else flies it")
    if not (status.armed or status.ready_to_arm):
        if not seen.readiness_told:
            texts.append("the vehicle does not say whether it may be armed (SYS_STATUS)")
        else:
            texts.append("the vehicle's own pre-arm checks fail (SYS_STATUS)")
        if seen.says:
            texts[-1] += f"; it says: {' | '.join(seen.says)}"
    return tuple(texts)


def _of_target(seen: TargetSeen, checks: Checks) -> tuple[str, ...]:
    if seen.age_s is not None and seen.age_s <= checks.target_age_max_s:
        return ()
    problems = f": {' | '.join(seen.problems)}" if seen.problems else ""
    if seen.arrived:
        return (f"{seen.arrived} samples on {seen.name}, none believed{problems}",)
    if seen.age_s is not None:
        age, most = f"{seen.age_s:.1f} s old", f"{checks.target_age_max_s:g}"
        return (f"the newest sample on {seen.name} is {age}; checks.target_age_max_s allows {most}",)
    if problems:
        return (f"no sample on {seen.name} any more; of earlier ones{problems}",)
    there = f"there are {', '.join(seen.keys)}" if seen.keys else "nor on any key like odometry, pose or tf"
    return (f"no sample on {seen.name}; {there}",)


class _Bound(NamedTuple):
    """Which setting ends a phase, and what happens then."""

    setting: str
    limit_s: Callable[[FlightConfig], float]
    then: str


# Phases in which a silent vehicle is borne; any other is left at once.
_BOUNDS: Mapping[Phase, _Bound] = {
    Phase.WAIT: _Bound("checks.wait_time_max_s", lambda c: c.checks.wait_time_max_s, "gives up"),
    Phase.HOLD: _Bound("checks.hold_time_s", lambda c: c.checks.hold_time_s, "aborts"),
    Phase.TOUCHDOWN: _Bound("touchdown.timeout_s", lambda c: c.touchdown.timeout_s, "aborts"),
    Phase.ABORT: _Bound("retreat.abort_time_max_s", lambda c: c.retreat.abort_time_max_s, "ends"),
}


def countdown(config: FlightConfig, phase: Phase, in_phase_s: float) -> str:
    """Return what ends the phase, the latest time, and the setting; empty for a phase without a limit.

    Args:
        config: of the flight.
        phase: the present one.
        in_phase_s: seconds since it began.
    """
    bound = _BOUNDS.get(phase)
    if bound is None:
        return ""
    left_s = max(0.0, bound.limit_s(config) - in_phase_s)
    return f"{bound.then} within {left_s:.0f} s ({bound.setting})"
