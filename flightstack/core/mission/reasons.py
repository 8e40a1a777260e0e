"""The numbers behind a change of phase: what was found, and the key of the configuration that bounds it.

The phase table says why in fixed words; here they get what a person needs to act on them. Every number has a
fixed format, so that a replay makes the same text.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from flightstack.core.mission.phases import Condition, Rule
from flightstack.core.parameters.flight import Checks
from flightstack.core.snapshot import Snapshot
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.types import Phase


class Known(NamedTuple):
    """What the numbers are taken from.

    Attributes:
        checks: of the configuration.
        seen: this tick's inputs.
        plausibility: of the own state and of following.
        refusal: why the newest sample of the target was refused; empty: it was not.
        now_s: stack clock.
    """

    checks: Checks
    seen: Snapshot
    plausibility: Plausibility
    refusal: str
    now_s: float


def reason(rule: Rule[Phase], flags: int, known: Known) -> str:
    """Reason of a rule that fires, with the numbers of those of its conditions that hold.

    Args:
        rule: of the phase table.
        flags: conditions of this tick.
        known: this tick.
    """
    asked = (rule.when | rule.about) & flags
    told = [say(known) for condition, say in _NUMBERS.items() if asked & condition]
    if not told and rule.about & ~flags & Condition.READY:
        told = ["the vehicle does not say that it is ready to arm"]
    return f"{rule.reason}: {', '.join(told)}" if told else rule.reason


def _own(known: Known) -> str:
    checks, watched, own = known.checks, known.plausibility, known.seen.inputs.own
    if own is None:
        return "no own state has come"
    if watched.memory.distrusted:
        return (
            f"drift, the position went {watched.drift_m:.2f} m where no velocity took it; "
            f"checks.own_drift_max_m is {checks.own_drift_max_m:g}"
        )
    last = watched.memory.last
    limit = f"checks.own_age_max_s is {checks.own_age_max_s:g}"
    if last is not None and last.arrival_s < own.arrival_s:
        return f"its numbers repeat since {known.now_s - last.arrival_s:.2f} s; {limit}"
    return f"the own state is {known.now_s - own.arrival_s:.2f} s old; {limit}"


def _heartbeat(known: Known) -> str:
    status = known.seen.inputs.status
    if status is None:
        return "no heartbeat has come"
    age_s = known.now_s - status.arrival_s
    limit = f"checks.status_age_max_s is {known.checks.status_age_max_s:g}"
    return f"the newest heartbeat is {age_s:.1f} s old; {limit}"


def _target(known: Known) -> str:
    target = known.seen.target
    refused = f", the newest was refused: {known.refusal}" if known.refusal else ""
    if target is None:
        return f"no sample of the target has been accepted{refused}"
    limit = f"checks.target_age_max_s is {known.checks.target_age_max_s:g}"
    return f"the target's newest sample is {target.age_s:.2f} s old; {limit}{refused}"


def _follow(known: Known) -> str:
    checks, watched = known.checks, known.plausibility
    return (
        f"it lags {watched.tracking_lag_m:.2f} m behind its set-points; "
        f"{watched.tracking_lag_max_m:.2f} m are allowed "
        f"by checks.follow_lag_max_s, {checks.follow_lag_max_s:g}"
    )


_NUMBERS: Mapping[Condition, Callable[[Known], str]] = MappingProxyType(
    {
        Condition.OWN_LOST: _own,
        Condition.LINK_LOST: _heartbeat,
        Condition.TARGET_LOST: _target,
        Condition.NOT_FOLLOWING: _follow,
    }
)
