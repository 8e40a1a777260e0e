"""Verdict on a run from the verdicts of its members; the ordinary run is a fleet of one.

The judged time starts with the first controller step in phase APPROACH; the verdict uses the simulator's true
states, not the controller's estimate:

* landed: first contact is with the pad within its radius, and 2 s after the motors stop the vehicle rests on
  the pad while the target still drives;
* crashed: contact before touchdown with ground, robot body or pad edge, or a tumble;
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

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flightstack.common.text import labels, named, outline
from logs.reader.flight import load_fleet
from logs.reader.flight_data import Bools, Fleet, Flight, Floats
from logs.schema import FLEET, LOSSES
from logs.schema.events import ContactBit
from logs.schema.rows import FleetPairRow
from logs.verdict.estimate import judge_estimate
from logs.verdict.truth import judge_truth
from logs.verdict.types import GAP_MAX_S, RADIUS_ABOVE_M, RADIUS_BESIDE_M, Outcome, Verdict

__all__ = ["Outcome", "Verdict", "judge", "judge_fleet", "judged", "result"]

_WORST_FIRST = (Outcome.CRASHED, Outcome.TIMEOUT, Outcome.UNKNOWN, Outcome.ABORTED, Outcome.LANDED)


def judge(flight: Flight) -> Verdict:
    """Judge a flight by its true states, or by the estimate if the log has none."""
    found = judge_estimate(flight) if flight.truth is None else judge_truth(flight, flight.truth)
    lost = records_lost(flight)
    if found.outcome is not Outcome.TIMEOUT or not any(lost.values()):
        return found
    told = ", ".join(f"{number} of {who}" for who, number in lost.items() if number)
    reason = f"the recorder lost records ({told}), so that the log does not tell: {found.reason}"
    return replace(found, outcome=Outcome.UNKNOWN, reason=reason)


def records_lost(flight: Flight) -> dict[str, int]:
    """Return the number of records that could not be passed to the recorder, by process."""
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


def flown_by(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of ``--json`` that describe the flight, from the metadata of a log."""
    seed = told.get("seed", "")
    return {
        "scenario": told.get("scenario"),
        "seed": int(seed) if seed.isdigit() else None,
        "filter": told.get("filter"),
    }


@dataclass(frozen=True, slots=True)
class FleetVerdict:
    """Verdict on a fleet from the verdicts of its members."""

    outcome: Outcome  # worst outcome of the members
    reason: str  # reason of the outcome, as text
    violation: bool | None  # whether a member violated the barrier over its pad; None: unknown
    # verdict of each member, by name; a member that collided with another vehicle has the outcome crashed
    members: dict[str, Verdict]
    collisions: int | None  # pairs whose shapes overlapped; None: data are missing
    # number of times that two flying vehicles came inside their ellipsoid; None: data are missing
    ellipsoid_violations: int | None
    # smallest ellipsoid norm between two flying vehicles, below 1: inside; None: never two, or unknown
    ellipsoid_min: float | None
    # smallest distance of two centres of mass; None: unknown, or a single member
    distance_min_m: float | None

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        return tuple(each.outcome for each in self.members.values())


def fleet_verdict(
    members: Mapping[str, Verdict],
    pairs: Collection[FleetPairRow],
    names: Mapping[int, str],
    *,
    complete: bool = True,
) -> FleetVerdict:
    """Judge a fleet by its members' verdicts and by the distances between the members."""
    struck = [pair for pair in pairs if pair.collided_ms >= 0]
    ends = [each for pair in struck for each in ((pair.one, pair.other), (pair.other, pair.one))]
    hits = {names[one]: names[other] for one, other in ends}
    judged = {name: _struck(each, hits.get(name)) for name, each in members.items()}
    outcome = min((each.outcome for each in judged.values()), key=_WORST_FIRST.index)
    inside, complete = sum(pair.violations for pair in pairs), complete and len(pairs) > 0
    return FleetVerdict(
        outcome,
        _reason(outcome, judged, hits),
        _any_known(each.violation for each in judged.values()),
        judged,
        len(struck) if struck or complete else None,
        inside if inside or complete else None,
        _least(pair.ellipsoid_min for pair in pairs) if complete else None,
        _least(pair.distance_min_m for pair in pairs) if complete else None,
    )


def _struck(verdict: Verdict, by: str | None) -> Verdict:
    if by is None:
        return verdict
    reason = f"collision with {by}"
    return replace(verdict, outcome=Outcome.CRASHED, reason=reason, time_to_land_s=None)


def _reason(outcome: Outcome, judged: Mapping[str, Verdict], hits: Collection[str]) -> str:
    if outcome is Outcome.LANDED and len(judged) > 1:
        return f"all {len(judged)} landed"
    shown = dict(zip(judged, labels(list(judged)), strict=True))
    texts = {
        name: "collision" if name in hits else each.reason
        for name, each in judged.items()
        if each.outcome is outcome
    }
    return "; ".join(named(shown[name], text) for name, text in texts.items())


def judge_fleet(fleet: Fleet) -> FleetVerdict:
    """Return the verdict on a log with the flights of a fleet."""
    members = {name: judge(flight) for name, flight in fleet.flights.items()}
    return fleet_verdict(members, fleet.pairs.values(), fleet.ids, complete=pairs_known(fleet))


def judged(log: Path) -> tuple[Fleet, FleetVerdict]:
    """Read and judge a log."""
    fleet = load_fleet(log)
    return fleet, judge_fleet(fleet)


def pairs_known(fleet: Fleet) -> bool:
    """Whether every pair of a fleet was observed until the end of the true states, in a complete log."""
    number = len(fleet.flights)
    ends_ns = [f.origin_ns + f.truth.t_s[-1] * 1e9 for f in fleet.flights.values() if f.truth is not None]
    if not all(flight.complete for flight in fleet.flights.values()):
        return False
    if len(fleet.pairs) < number * (number - 1) // 2 or len(ends_ns) < number:
        return False
    return all(max(ends_ns) - pair.stamp_ns <= GAP_MAX_S * 1e9 for pair in fleet.pairs.values())


def result(
    fleet: Fleet,
    verdict: FleetVerdict,
    pages: Mapping[str, Path] | None = None,
    about: Mapping[str, object] | None = None,
    realtime_factor: float | None = None,
) -> dict[str, Any]:
    """Return the result of a log for JSON, with the keys of ``flightstack sitl --json``.

    ``pages``: path of each member's report, and of the main page under the key ""; ``about``: first keys, if
    they are more than those of the log.
    """
    pages = pages or {}
    vehicles = {
        name: _vehicle_result(fleet.flights[name], each, pages.get(name, pages.get("")), realtime_factor)
        for name, each in verdict.members.items()
    }
    filters = ", ".join(sorted({str(each["filter"]) for each in vehicles.values()}))
    shared = {
        **flown_by({**fleet.metadata.get(FLEET, {}), "filter": filters}),
        "outcome": verdict.outcome.value,
        "violation": verdict.violation,
        "reason": verdict.reason,
        "records_lost": sum(int(n) for n in fleet.metadata.get(LOSSES, {}).values()),
        "ellipsoid_violations": verdict.ellipsoid_violations,
        "ellipsoid_min": verdict.ellipsoid_min,
        "distance_min_m": verdict.distance_min_m,
        "collisions": verdict.collisions,
        "realtime_factor": realtime_factor,
        "log": str(fleet.path),
        "report": str(pages[""]) if "" in pages else None,
    }
    return {**(about or {}), **outline(shared, "vehicles", vehicles)}


def _vehicle_result(
    flight: Flight, verdict: Verdict, page: Path | None, realtime_factor: float | None
) -> dict[str, Any]:
    filter_flown = flight.config.filter if flight.config is not None else None
    return {
        **flown_by({"filter": filter_flown, **flight.metadata.get("run", {})}),
        **verdict.to_json_dict(),
        "outside_envelope": outside_envelope(flight),
        "judged_apart": judged_apart(flight),
        "records_lost": sum(records_lost(flight).values()),
        "realtime_factor": realtime_factor,
        "log": str(flight.path),
        "report": str(page) if page is not None else None,
    }


def _any_known(values: Iterable[bool | None]) -> bool | None:
    """Whether any value is True; None if no value is True and one is unknown."""
    found = set(values)
    return True if True in found else None if None in found else False


def _least(values: Iterable[float | None]) -> float | None:
    """Return the smallest known and finite value; None without one."""
    return min((value for value in values if value is not None and value < float("inf")), default=None)


class PairSeries(NamedTuple):
    """Distance of two members over time, from their true states; arrays are (n,)."""

    name: str  # names of both members, for example cf1–cf2
    t_s: Floats  # seconds since the origin of the fleet
    distance_m: Floats  # distance of the centres of mass
    measure: Floats  # distance in units of the ellipsoid around both vehicles: 1 on its surface, less inside
    flying: Bools  # at each time: whether both vehicles were flying (motors on, no contact)


def pair_series(fleet: Fleet) -> list[PairSeries]:
    """Return the distances of all pairs with true states, at the times that both members have."""
    found = []
    for (a, one), (b, other) in combinations(fleet.flights.items(), 2):
        if one.truth is None or other.truth is None:
            continue
        t_s, to_s = one.truth.t_s + fleet.shift_s(one), other.truth.t_s + fleet.shift_s(other)
        both = (t_s >= to_s[0]) & (t_s <= to_s[-1])
        if not both.any():
            continue
        t_s = t_s[both]
        there_m = np.column_stack([np.interp(t_s, to_s, column) for column in other.truth.position_enu_m.T])
        apart_m = one.truth.position_enu_m[both] - there_m
        beside, above = 2.0 * RADIUS_BESIDE_M, 2.0 * RADIUS_ABOVE_M
        measure = np.sqrt(
            (apart_m[:, 0] ** 2 + apart_m[:, 1] ** 2) / beside**2 + (apart_m[:, 2] / above) ** 2
        )
        nearest = np.clip(np.searchsorted(to_s, t_s), 0, len(to_s) - 1)
        flying = _flying(one)[both] & _flying(other)[nearest]
        distance_m = np.linalg.norm(apart_m, axis=1)
        found.append(PairSeries(f"{a}–{b}", t_s, distance_m, measure, flying))
    return found


def _flying(flight: Flight) -> Bools:
    assert flight.truth is not None
    rests = flight.truth.contacts & int(ContactBit.PAD | ContactBit.GROUND)
    return np.asarray(flight.truth.motors_running & (rests == 0))
