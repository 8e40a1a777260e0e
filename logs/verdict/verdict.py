"""The verdict on a flight.

Judging begins with the first controller step in phase APPROACH and looks at the simulator's true states,
not at the controller's estimate:

* landed: first contact is with the pad within its radius, and 2 s after the motors stop the vehicle rests on
  the pad while the target still drives;
* crashed: contact before touchdown with ground, robot body or pad edge, or a tumble;
* aborted: the phase machine gave up by itself and said so (phase ABORT);
* timeout: everything else, also a miss without a declared abort and a log that ends too early;
* unknown: as timeout, but the recorder lost records of the vehicle or of its onboard process;
* violation: h < -5 mm while d exceeds the pad's radius, in a run that began with h >= 0.

A declared abort that has flown clear ends the judging of h: after the first true state behind it that is
farther from the target than the configured clearance distance (``checks.clearance_m``), h no longer counts,
since landing beside the robot has h < 0 by geometry; until then it counts in full. After a declared abort a
gentle landing on the ground is no crash. The same holds for a vehicle of a fleet that has landed and takes
off again to free the pad (phase LEAVE): it has landed if it had rested before that, and if it then touches
nothing but the ground, gently.

Data that is missing is never taken for safe: without it a flight has not landed, and an absent violation is
"not known" (``None``) instead of False. A log without true states, as of real hardware, is judged by the
vehicle's own estimate; ``judged_from`` says which.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from logs.reader.flight_data import Flight
from logs.schema.names import LOSSES
from logs.verdict.estimate import judge_estimate
from logs.verdict.truth import judge_truth
from logs.verdict.types import Outcome, Verdict

__all__ = ["Outcome", "Verdict", "judge", "verdict_result"]


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
    """Records that the vehicle and its onboard process could not hand to the recorder, by process."""
    told = flight.metadata.get(LOSSES, {})
    return {who: int(told.get(who, "0")) for who in ("vehicle", "onboard")}


def flown_by(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was flown, the first keys of ``--json``, by the metadata of a log."""
    seed = told.get("seed", "")
    return {
        "scenario": told.get("scenario"),
        "seed": int(seed) if seed.isdigit() else None,
        "filter": told.get("filter"),
    }


def verdict_result(
    flight: Flight,
    verdict: Verdict,
    report: Path | None = None,
    about: Mapping[str, object] | None = None,
    realtime_factor: float | None = None,
) -> dict[str, Any]:
    """Return the result of a flight as plain values for JSON: the keys of ``flightstack sitl --json``."""
    if about is None:
        filter_flown = flight.config.filter if flight.config is not None else None
        about = flown_by({"filter": filter_flown, **flight.metadata.get("run", {})})
    return {
        **about,
        **verdict.to_json_dict(),
        "records_lost": sum(records_lost(flight).values()),
        "realtime_factor": realtime_factor,
        "log": str(flight.path),
        "report": str(report) if report is not None else None,
    }
