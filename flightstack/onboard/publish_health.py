"""What the onboard process tells people who watch: ages of its inputs, the vehicle's state, the battery."""

from __future__ import annotations

import math

from bridge.mavlink.client.vehicle_state import Battery
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from logs.schema.rows import HealthRow
from logs.schema.schemas import HEALTH

HEALTH_HZ = 5.0
BATTERY_AGE_MAX_S = 5.0  # SYS_STATUS comes once a second or more often; an older voltage is none


class LiveHealth:
    """Publishes ``NAMESPACE/health``; nothing depends on it."""

    def __init__(self, session: zenoh_link.Session, namespace: str, rate_hz: int) -> None:
        self._every = max(1, round(rate_hz / HEALTH_HZ))
        self._publisher = zenoh_link.dropping_publisher(
            session, f"{namespace}/health", f"application/cdr;{HEALTH}"
        )

    def show(
        self, tick: Tick, out: Outputs, reason: str, battery: Battery | None, overruns: int, dropped: int
    ) -> bytes | None:
        """Publish now and then, and at the end; returns what was published."""
        if tick.number % self._every != 0 and not out.finished:
            return None
        payload = health_row(tick, out, reason, battery, overruns, dropped).pack()
        self._publisher.put(payload)
        return payload


def health_row(
    tick: Tick, out: Outputs, reason: str, battery: Battery | None, overruns: int, dropped: int
) -> HealthRow:
    """Values that are not there, or too old, are NaN."""
    own, status, target = out.seen.inputs.own, out.seen.inputs.status, out.seen.target
    if battery is not None and tick.now_s - battery.arrival_s > BATTERY_AGE_MAX_S:
        battery = None
    return HealthRow(
        stamp_ns=tick.unix_ns,
        tick=tick.number,
        own_age_s=tick.now_s - own.arrival_s if own is not None else math.nan,
        target_age_s=target.age_s if target is not None else math.nan,
        link_age_s=tick.now_s - status.arrival_s if status is not None else math.nan,
        battery_v=_known(battery.voltage_v if battery is not None else None),
        battery_share=_known(battery.share if battery is not None else None),
        mode=status.mode if status is not None else 0,
        landed=status.landed if status is not None else 0,
        armed=status.armed if status is not None else False,
        ready_to_arm=status.ready_to_arm if status is not None else False,
        own_valid=out.seen.own_ok,
        target_valid=out.seen.target_ok,
        link_valid=out.seen.link_ok,
        finished=out.finished,
        target_accepted=out.target_accepted,
        target_rejected=out.target_rejected,
        overruns=overruns,
        feed_dropped=dropped,
        reason=reason,
    )


def _known(value: float | None) -> float:
    return math.nan if value is None else value
