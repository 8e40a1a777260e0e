"""Verdict on a run from the verdicts of its members; the ordinary run is a fleet of one.

The judged time starts with the first controller step in phase APPROACH; the verdict uses the simulator's true
states, not the controller's estimate:

* landed: the first contact is with the pad, within its radius, and the vehicle rests on the pad 2 s after the
  motors have stopped, even while the target drives;
* crashed: a tumble, a first contact that is not with the pad within its radius, or a later contact with
  ground, robot body or another vehicle;
* aborted: the phase machine ended the landing by itself and reported it (phase ABORT);
* timeout: all other cases, also a miss without a declared abort and a log that ends too early;
* unknown: as timeout, but the recorder lost records of the vehicle or of its onboard process;
* violation: h < -5 mm while d exceeds the pad's radius, in a run that began with h >= 0.

After a declared abort h counts until the first true state that is farther from the target than the configured
clearance distance (``checks.clearance_m``): landing beside the robot has h < 0 by geometry. A gentle landing
on the ground after a declared abort is no crash. The same holds for a vehicle of a fleet that has landed and
takes off again to free the pad (phase LEAVE): it has landed if it rested on the pad before, and if its later
contacts are only with the ground, and gentle.

Missing data never count as safe: without them a flight has not landed, and an absent violation is "not
known" (``None``) instead of False. A log without true states, such as one of real hardware, is judged by the
vehicle's own estimate; ``judged_from`` names the source.

A fleet has landed when all members have; else it has the outcome of the worst member. A vehicle that collides
with another one has crashed, also after its own landing. If the simulator did not observe a pair to the end,
an absent collision or ellipsoid violation is "not known".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from types import MappingProxyType
from typing import Any

from logs.reader.flight import load_fleet
from logs.reader.flight_data import Fleet, Flight
from logs.schema import FLEET, LOSSES
from logs.schema.rows import FleetPairRow
from logs.verdict.estimate import judge_estimate
from logs.verdict.truth import judge_truth
from logs.verdict.types import GAP_MAX_S, Outcome, Verdict

__all__ = ["Outcome", "Verdict", "judge", "judge_fleet", "judged", "result"]

_WORST_FIRST = (Outcome.CRASHED, Outcome.TIMEOUT, Outcome.UNKNOWN, Outcome.ABORTED, Outcome.LANDED)
_TOUCHDOWN = ("touchdown_error_m", "touchdown_speed_vertical_m_s", "touchdown_speed_horizontal_m_s")
# function that selects the worst of several values, by field
_WORST = {"h_min_m": min, "h_min_outside_pad_m": min, **dict.fromkeys(_TOUCHDOWN, max)}


def judge(flight: Flight) -> Verdict:
    """Judge a flight by its true states, or by the estimate if the log has no true states."""
    found = judge_estimate(flight) if flight.truth is None else judge_truth(flight, flight.truth)
    lost = records_lost(flight)
    if found.outcome is not Outcome.TIMEOUT or not any(lost.values()):
        return found
    told = ", ".join(f"{number} of {who}" for who, number in lost.items() if number)
    reason = f"the recorder lost records ({told}), so that the log does not tell: {found.reason}"
    return replace(found, outcome=Outcome.UNKNOWN, reason=reason)


def records_lost(flight: Flight) -> dict[str, int]:
    """Return the number of records that each process could not pass to the recorder."""
    told = flight.metadata.get(LOSSES, {})
    return {who: int(told.get(who, "0")) for who in ("vehicle", "onboard")}


def outside_envelope(flight: Flight) -> str | None:
    """Return the text that names values outside the proven envelope; None: the log has no such text."""
    return flight.metadata.get("run", {}).get("outside_envelope")


def judged_apart(flight: Flight) -> str:
    """Return a text if the verdict uses another barrier than the filter; else an empty text."""
    apart = ""
    if flight.barrier is not None and flight.config is not None:
        judge, flown = ((shape.alpha_1_m, shape.beta_m) for shape in (flight.barrier, flight.config.barrier))
        apart = two_barriers(judge, flown) if judge != flown else ""
    return "; ".join(filter(None, (apart, flight.metadata.get("run", {}).get("own_boundary"))))


def two_barriers(judge: Sequence[object], flown: Sequence[object]) -> str:
    """Return a text with the barriers of verdict and flight: alpha in 1/m and beta in m."""
    return "judged by alpha {} 1/m, beta {} m; flown with alpha {} 1/m, beta {} m".format(*judge, *flown)


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetVerdict(Verdict):
    """Verdict on a run: the worst value of its vehicles for each field, and the distances between them."""

    # verdict of each member, by name; a member that collided with another vehicle has the outcome crashed
    members: dict[str, Verdict]
    collisions: int | None  # number of pairs that collided; None: data are missing, or no pairs
    # number of times that two flying vehicles came inside their ellipsoid; None as for ``collisions``
    ellipsoid_violations: int | None
    # smallest ellipsoid norm of two flying vehicles; below 1: inside; None: unknown, or no two flew at once
    ellipsoid_min: float | None
    distance_min_m: float | None  # smallest distance of two centres of mass, m; None: unknown, or no pairs

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        return tuple(each.outcome for each in self.members.values())


def fleet_verdict(
    members: Mapping[str, Verdict],
    pairs: Collection[FleetPairRow] = (),
    names: Mapping[int, str] = MappingProxyType({}),
    *,
    complete: bool = True,
) -> FleetVerdict:
    """Judge a run by its members' verdicts and by the distances between the members."""
    struck = [pair for pair in pairs if pair.collided_ms >= 0]
    ends = [each for pair in struck for each in ((pair.one, pair.other), (pair.other, pair.one))]
    hits = {names[one]: names[other] for one, other in ends}
    judged = {name: _struck(each, hits.get(name)) for name, each in members.items()}
    found = list(judged.values())
    outcome = min((each.outcome for each in found), key=_WORST_FIRST.index)
    violations, safe = {each.violation for each in found}, {each.started_safe for each in found}
    inside, known = sum(pair.violations for pair in pairs), pairs if complete else ()
    return FleetVerdict(
        outcome=outcome,
        violation=True if True in violations else None if None in violations else False,
        **{name: _known(worst, (getattr(each, name) for each in found)) for name, worst in _WORST.items()},
        time_to_land_s=_known(max, (e.time_to_land_s for e in found)) if outcome is Outcome.LANDED else None,
        reason=_reason(outcome, judged, hits),
        started_safe=False if False in safe else None if None in safe else True,
        judged_from=", ".join(dict.fromkeys(each.judged_from for each in found)),
        members=judged,
        collisions=len(struck) if struck or known else None,
        ellipsoid_violations=inside if inside or known else None,
        ellipsoid_min=_known(min, (pair.ellipsoid_min for pair in known)),
        distance_min_m=_known(min, (pair.distance_min_m for pair in known)),
    )


def _known(worst: Callable[..., float | None], values: Iterable[float | None]) -> float | None:
    """Return the smallest or largest of the known, finite values; None: there are none."""
    return worst((value for value in values if value is not None and value < math.inf), default=None)


def _struck(verdict: Verdict, by: str | None) -> Verdict:
    if by is None:
        return verdict
    reason = f"collision with {by}"
    return replace(verdict, outcome=Outcome.CRASHED, reason=reason, time_to_land_s=None)


def _reason(outcome: Outcome, judged: Mapping[str, Verdict], hits: Collection[str]) -> str:
    if len(judged) == 1:
        return next(iter(judged.values())).reason
    if outcome is Outcome.LANDED:
        return f"all {len(judged)} landed"
    return "; ".join(
        f"{name}: {'collision' if name in hits else each.reason}"
        for name, each in judged.items()
        if each.outcome is outcome
    )


def judge_fleet(fleet: Fleet) -> FleetVerdict:
    """Return the verdicts on all members of a fleet, and the verdict on the fleet."""
    members = {name: judge(flight) for name, flight in fleet.flights.items()}
    return fleet_verdict(members, fleet.pairs.values(), fleet.ids, complete=not unobserved(fleet))


def judged(log: Path) -> tuple[Fleet, FleetVerdict]:
    """Read and judge a log."""
    fleet = load_fleet(log)
    return fleet, judge_fleet(fleet)


def unobserved(fleet: Fleet) -> list[tuple[str, str]]:
    """Return the pairs of members that were not observed until the end of the true states, by their names.

    A pair was not observed either if one of its two members has no true states or an incomplete log.
    """
    flights = fleet.flights.values()
    ends_ns = [f.origin_ns + f.truth.t_s[-1] * 1e9 for f in flights if f.truth is not None]
    since_ns = max(ends_ns, default=math.inf) - GAP_MAX_S * 1e9
    whole = {name for name, f in fleet.flights.items() if f.complete and f.truth is not None}
    seen = {ids for ids, pair in fleet.pairs.items() if pair.stamp_ns >= since_ns}
    pairs = {ids: (fleet.ids[ids[0]], fleet.ids[ids[1]]) for ids in combinations(sorted(fleet.ids), 2)}
    return [names for ids, names in pairs.items() if ids not in seen or not whole.issuperset(names)]


def result(
    fleet: Fleet,
    verdict: FleetVerdict,
    page: Path | None = None,
    about: Mapping[str, object] | None = None,
    realtime_factor: float | None = None,
) -> dict[str, Any]:
    """Return the result of a log for JSON, with the keys of ``flightstack sitl --json``.

    ``page``: path of the report; ``about``: additional keys, which come first.
    """
    report = str(page) if page is not None else None
    vehicles = {
        name: {
            **_flown_by(_run(flight)),
            **verdict.members[name].to_json_dict(),
            "outside_envelope": outside_envelope(flight),
            "judged_apart": judged_apart(flight),
            "records_lost": sum(records_lost(flight).values()),
            "report": report,
        }
        for name, flight in fleet.flights.items()
    }
    first, values = next(iter(fleet.flights.values())), verdict.to_json_dict()
    values.pop("members")
    return {
        **(about or {}),
        **_flown_by({**_run(first), **fleet.metadata.get(FLEET, {})}),
        "filter": _joined(", ", sorted(str(each["filter"]) for each in vehicles.values())),
        **values,
        "outside_envelope": _joined("; ", (each["outside_envelope"] for each in vehicles.values())),
        "judged_apart": _joined("; ", (each["judged_apart"] for each in vehicles.values())),
        "records_lost": sum(int(n) for n in fleet.metadata.get(LOSSES, {}).values()),
        "realtime_factor": realtime_factor,
        "log": str(fleet.path),
        "report": report,
        "vehicles": vehicles,
    }


def _run(flight: Flight) -> dict[str, Any]:
    """Return the metadata of a flight's run; a missing filter is that of the configuration."""
    filter_flown = flight.config.filter if flight.config is not None else None
    return {"filter": filter_flown, **flight.metadata.get("run", {})}


def _flown_by(run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of ``--json`` that identify a flight, from the metadata of its run."""
    seed = run.get("seed", "")
    return {
        "scenario": run.get("scenario"),
        "seed": int(seed) if seed.isdigit() else None,
        "filter": run["filter"],
    }


def _joined(between: str, texts: Iterable[str | None]) -> str:
    return between.join(dict.fromkeys(text for text in texts if text))
