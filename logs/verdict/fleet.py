"""The verdict on a fleet: the worst of its members, and how near they came to each other.

All landed is landed; else the outcome is that of the worst member. Who collides with another vehicle has
crashed, also after its own landing. Data that is missing is never taken for safe: where the simulator did not
follow a pair to the end, no collision and no ellipsoid violation is "not known" (``None``).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from logs.reader.flight import load_fleet
from logs.reader.flight_data import Fleet, Flight
from logs.reader.reader import LogFile
from logs.schema.names import FLEET, LOSSES
from logs.verdict.types import GAP_MAX_S, Outcome, Verdict
from logs.verdict.verdict import flown_by, judge, verdict_result

_WORST_FIRST = (Outcome.CRASHED, Outcome.TIMEOUT, Outcome.UNKNOWN, Outcome.ABORTED, Outcome.LANDED)


class Near(Protocol):
    """How near two vehicles came, as far as a verdict looks at it; ids are those of the vehicles."""

    @property
    def one(self) -> int: ...

    @property
    def other(self) -> int: ...

    @property
    def distance_min_m(self) -> float:
        """Smallest distance of their centres of mass; infinite: none yet."""

    @property
    def ellipsoid_min(self) -> float:
        """Smallest distance in the ellipsoid's measure while both flew; infinite: never both at once."""

    @property
    def violations(self) -> int:
        """Number of times that they came inside."""

    @property
    def collided_ms(self) -> int | None:
        """When their shapes overlapped first; None or negative: never."""


@dataclass(frozen=True, slots=True)
class FleetVerdict:
    """Verdict on a fleet."""

    outcome: Outcome  # worst outcome of the members
    reason: str  # reason, as text
    violation: bool | None  # whether a member violated the barrier over its pad; None: not known
    members: dict[str, Verdict]  # verdicts by member; one that collided with another vehicle has crashed
    collisions: int | None  # pairs whose shapes overlapped; None: data is missing
    # times that two in flight came inside the ellipsoid about each other; None: data is missing
    ellipsoid_violations: int | None
    # smallest distance of two in flight in its measure; None: no two at once, or not known
    ellipsoid_min: float | None
    # smallest distance of two centres of mass; None: not known, or a single member
    distance_min_m: float | None

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        return tuple(each.outcome for each in self.members.values())


def fleet_verdict(
    members: Mapping[str, Verdict],
    pairs: Collection[Near],
    names: Mapping[int, str],
    *,
    complete: bool = True,
) -> FleetVerdict:
    """Judge a fleet by its members' verdicts and by how near they came to each other."""
    struck = [pair for pair in pairs if pair.collided_ms is not None and pair.collided_ms >= 0]
    ends = [each for pair in struck for each in ((pair.one, pair.other), (pair.other, pair.one))]
    hits = {names[one]: names[other] for one, other in ends}
    judged = {name: _struck(each, hits.get(name)) for name, each in members.items()}
    outcome = min((each.outcome for each in judged.values()), key=_WORST_FIRST.index)
    inside = sum(pair.violations for pair in pairs)
    return FleetVerdict(
        outcome,
        _reason(outcome, judged, hits),
        any_known(each.violation for each in judged.values()),
        judged,
        len(struck) if struck or complete else None,
        inside if inside or complete else None,
        least(pair.ellipsoid_min for pair in pairs) if complete else None,
        least(pair.distance_min_m for pair in pairs) if complete else None,
    )


def _struck(verdict: Verdict, by: str | None) -> Verdict:
    if by is None:
        return verdict
    reason = f"collision with {by}"
    return replace(verdict, outcome=Outcome.CRASHED, reason=reason, time_to_land_s=None)


def _reason(outcome: Outcome, judged: Mapping[str, Verdict], hits: Collection[str]) -> str:
    if outcome is Outcome.LANDED:
        return f"all {len(judged)} landed"
    worst = {name: each for name, each in judged.items() if each.outcome is outcome}
    return "; ".join(
        f"{name}: {'collision' if name in hits else each.reason}" for name, each in worst.items()
    )


def judge_fleet(log: Fleet | Path | str) -> FleetVerdict:
    """Judge the log of a fleet."""
    fleet = log if isinstance(log, Fleet) else load_fleet(log)
    members = {name: judge(flight) for name, flight in fleet.flights.items()}
    return fleet_verdict(members, fleet.pairs.values(), fleet.ids, complete=pairs_known(fleet))


def judge_member(log: Path | str, member: str) -> tuple[Flight, Verdict]:
    """Return the flight of a member, and the verdict that it has in its fleet."""
    LogFile(log, member)  # names the members
    fleet = load_fleet(log)
    return fleet.flights[member], judge_fleet(fleet).members[member]


def pairs_known(fleet: Fleet) -> bool:
    """Whether every pair of a fleet was followed up to the end of the true states, in a whole log."""
    number = len(fleet.flights)
    ends_ns = [f.origin_ns + f.truth.t_s[-1] * 1e9 for f in fleet.flights.values() if f.truth is not None]
    if not all(flight.complete for flight in fleet.flights.values()):
        return False
    if len(fleet.pairs) < number * (number - 1) // 2 or len(ends_ns) < number:
        return False
    return all(max(ends_ns) - pair.stamp_ns <= GAP_MAX_S * 1e9 for pair in fleet.pairs.values())


def fleet_result(
    fleet: Fleet,
    verdict: FleetVerdict,
    report: Path | None = None,
    about: Mapping[str, object] | None = None,
    realtime_factor: float | None = None,
    pages: Mapping[str, Path] | None = None,
) -> dict[str, Any]:
    """Return the result of a fleet as plain values for JSON: the keys of ``flightstack sitl --json``."""
    vehicles = {
        name: verdict_result(
            fleet.flights[name], each, (pages or {}).get(name), realtime_factor=realtime_factor
        )
        for name, each in verdict.members.items()
    }
    if about is None:
        filters = dict.fromkeys(str(each["filter"]) for each in vehicles.values())
        about = flown_by({**fleet.metadata.get(FLEET, {}), "filter": ", ".join(filters)})
    return {
        **about,
        "outcome": verdict.outcome.value,
        "violation": verdict.violation,
        "reason": verdict.reason,
        "vehicles": vehicles,
        "records_lost": sum(int(n) for n in fleet.metadata.get(LOSSES, {}).values()),
        "ellipsoid_violations": verdict.ellipsoid_violations,
        "ellipsoid_min": verdict.ellipsoid_min,
        "distance_min_m": verdict.distance_min_m,
        "collisions": verdict.collisions,
        "realtime_factor": realtime_factor,
        "log": str(fleet.path),
        "report": str(report) if report is not None else None,
    }


def any_known(values: Iterable[bool | None]) -> bool | None:
    """Return whether one is true; None if that is not known."""
    found = set(values)
    return True if True in found else None if None in found else False


def least(values: Iterable[float | None]) -> float | None:
    """Return the smallest of what is known and finite; None if nothing is."""
    return min((value for value in values if value is not None and value < float("inf")), default=None)
