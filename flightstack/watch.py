"""Observation of a running flight from another process: newest data with their age, and the terminal view.

A sample counts as new only if its tick differs from that of the sample before, so a sender that repeats a
tick counts as silent. Old data is never shown as new.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import IntEnum
from typing import Any

from rich.console import Group
from rich.panel import Panel
from rich.table import Column, Table
from rich.text import Text

from bridge.zenoh import zenoh_link
from flightstack.common.text import one_line
from flightstack.core.types import FilterStatus, Landed, Mode, Phase
from logs.schema.rows import ControllerStepRow, HealthRow, LoopTimingRow

STALE_S = 1.0  # age above which data is stale, s; the slowest key is published every 0.2 s
_TIMINGS = 20  # number of stored loop timings (one second), for the mean period
_ENUMS: Mapping[str, type[IntEnum]] = {
    "phase": Phase, "filter_status": FilterStatus, "mode": Mode, "landed": Landed,
}  # fmt: skip
_RING = 8  # maximum number of samples that are stored for a key between two polls
REFRESH_HZ = 8.0
_STYLE: Mapping[int, str] = {
    Phase.WAIT: "dim",
    Phase.TAKEOFF: "cyan",
    Phase.APPROACH: "blue",
    Phase.LAND: "green",
    Phase.TOUCHDOWN: "bold green",
    Phase.LANDED: "bold green",
    Phase.HOLD: "yellow",
    Phase.CLIMB: "yellow",
    Phase.ABORT: "bold red",
    Phase.LEAVE: "green",
}
_LOUD = "bold white on red"


class Watch:
    """Subscriber to the live keys of one onboard process; it has no effect on the flight."""

    def __init__(
        self,
        session: zenoh_link.Session,
        namespace: str,
        *,
        clock: Callable[[], float] = time.monotonic,
        role: zenoh_link.Role = zenoh_link.Role.PEER,
    ) -> None:
        """Subscribe over a session of this role, which the caller closes; ``clock``: monotonic time, s."""
        self.namespace, self.role, self._session, self._clock = namespace, role, session, clock
        self._steps, self._timings, self._healths = (
            zenoh_link.ring_subscriber(session, f"{namespace}/{name}", _RING)
            for name in ("controller/step", "loop/timing", "health")
        )
        self.step: ControllerStepRow | None = None  # newest controller step; None before the first
        self.health: HealthRow | None = None  # newest health message; None before the first
        self.timings: deque[LoopTimingRow] = deque(maxlen=_TIMINGS)  # loop timings of the last second
        self.new_steps: list[ControllerStepRow] = []  # steps of the last poll
        self.new_timings: list[LoopTimingRow] = []  # loop timings of the last poll
        self.refused = 0  # number of samples with a type that is wrong for their key
        self._step_s, self._health_s = clock(), -math.inf  # arrival times, s; before the first step: now

    def poll(self) -> None:
        """Read the samples that have arrived."""
        self.new_steps = self._new(self._steps, ControllerStepRow.unpack, self.step)
        self.new_timings = self._new(self._timings, LoopTimingRow.unpack, None)
        self.timings.extend(self.new_timings)
        if self.new_steps:
            self.step, self._step_s = self.new_steps[-1], self._clock()
        if healths := self._new(self._healths, HealthRow.unpack, self.health):
            self.health, self._health_s = healths[-1], self._clock()

    def _new(self, subscriber: zenoh_link.Subscriber, unpack: Callable[[bytes], Any], last: Any) -> list[Any]:
        """Return the rows that have arrived, without rows that repeat the tick of the row before."""
        rows = []
        for sample in zenoh_link.drain(subscriber):
            try:
                row = unpack(sample.payload.to_bytes())
            except ValueError:  # the publisher is another program or version: the sample is counted
                self.refused += 1
                continue
            if last is None or row.tick != last.tick:
                rows.append(row)
            last = row
        return rows

    @property
    def age_s(self) -> float:
        """Time since the last new step, or since the subscription, s."""
        return self._clock() - self._step_s

    @property
    def fresh(self) -> bool:
        """Whether a new step arrived within the last ``STALE_S``."""
        return self.step is not None and self.age_s <= STALE_S

    @property
    def health_fresh(self) -> bool:
        """Whether a new health message arrived within the last ``STALE_S``."""
        return self._clock() - self._health_s <= STALE_S

    @property
    def connections(self) -> int:
        """Number of open Zenoh connections; 0: the remote end is unreachable or rejects the connection."""
        return zenoh_link.transports(self._session)

    @property
    def past_router(self) -> bool:
        """Whether this session is a peer of a router, which then does not forward data of its other peers."""
        return self.role is zenoh_link.Role.PEER and zenoh_link.knows_router(self._session)


def snapshot(watch: Watch) -> dict[str, Any]:
    """Return the fields of the newest step and health for scripts; ``fresh``: whether they are recent."""
    values: dict[str, Any] = {
        "namespace": watch.namespace,
        "fresh": watch.fresh,
        "age_s": round(watch.age_s, 3),
        "connections": watch.connections,
        "refused": watch.refused,
    }
    if watch.step is not None:
        values |= {name: _plain(name, value) for name, value in watch.step._asdict().items()}
    if watch.health is not None:
        health = {name: _plain(name, value) for name, value in watch.health._asdict().items()}
        values["health"] = {"fresh": watch.health_fresh, **health}
    return values


def _plain(name: str, value: Any) -> Any:
    """Return a field of a row for JSON: enumerations by name, ``None`` for NaN and infinity."""
    if isinstance(value, tuple | list):
        return [_plain("", each) for each in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return name_of(_ENUMS[name], value) if name in _ENUMS else value


def name_of(kind: type[IntEnum], number: int) -> str:
    """Return the name of an enumeration's value; for an unknown value, return its number as text."""
    return kind(number).name if number in kind._value2member_map_ else str(number)


def draw(watches: Mapping[str, Watch], title: str, endpoints: Sequence[str] = ()) -> Panel:
    """Return a table whose columns are the newest values of each vehicle, below warnings about old data.

    ``endpoints``: Zenoh endpoints to which the session of the watches connects.
    """
    old = {namespace: watch for namespace, watch in watches.items() if not watch.fresh}
    lines = [Text.assemble(f"{namespace} ", _no_news(watch, endpoints)) for namespace, watch in old.items()]
    columns = [_column(watch) for watch in watches.values()]
    table = Table("", *(Column(Text(namespace)) for namespace in watches), box=None, padding=(0, 2))
    for name in dict.fromkeys(name for column in columns for name in column):
        table.add_row(Text(name, style="dim"), *(column.get(name, "-") for column in columns))
    style = "red" if len(old) == len(watches) else "none"
    return Panel(Group(*lines, table), title=Text(title), title_align="left", border_style=style)


def _no_news(watch: Watch, endpoints: Sequence[str]) -> Text:
    """Return the reason why no recent data is shown; it is highlighted unless the flight is over."""
    refused = f"   {watch.refused} samples not readable" if watch.refused else ""
    if watch.step is not None and watch.step.finished:
        phase = name_of(Phase, watch.step.phase)
        return Text(f"the flight is over: {phase}, {watch.age_s:.0f} s ago{refused}", style="bold")
    why = "; ".join(_causes(watch, endpoints)) or "connected, but no data arrives on these keys"
    old = "; data below is OLD" if watch.step is not None else ""
    return Text(f" no data for {watch.age_s:.1f} s: {why}{old}{refused} ", style=_LOUD)


def _causes(watch: Watch, endpoints: Sequence[str]) -> Iterator[str]:
    """Yield the problems of the connections; which of several endpoints is the vehicle's is not known."""
    connected, number = watch.connections, len(endpoints)
    named = endpoints[0] if number == 1 else "one endpoint"
    if number > 1 and connected < (number if watch.role is zenoh_link.Role.PEER else 1):
        yield f"{connected} of {number} endpoints connected; the rest: not running, or access denied"
    elif connected == 0:
        yield f"no reply from {named}: not running, or access denied" if endpoints else "no connection"
    if watch.past_router:
        yield f"{named} is a router, which passes nothing from peer to peer: --zenoh-config with mode client"


def _column(watch: Watch) -> dict[str, Text]:
    """Return the texts of a vehicle's values by name; old values are dim, values outside limits red."""
    rows: dict[str, tuple[str, str]] = {}
    if (step := watch.step) is not None:
        x, y, z = (p - q for p, q in zip(step.own_position_enu_m, step.target_position_enu_m, strict=True))
        status = name_of(FilterStatus, step.filter_status).lower().replace("_", " ")
        rows |= {
            "tick": (f"{step.tick}, {watch.refused} samples not readable", ""),
            "phase": (name_of(Phase, step.phase), _STYLE.get(step.phase, "")),
            "e_z, d": (f"{_value(z, '+.3f')} m, {_value(math.hypot(x, y), '.3f')} m", ""),
            "h": (f"{_value(step.h_m, '+.3f')} m", "bold red" if step.h_m < 0.0 else "bold green"),
            "nominal, ENU": _velocity(step.nominal_enu_m_s),
            "filtered, ENU": _velocity(step.filtered_enu_m_s),
            "set-point, ENU": _velocity(step.command_enu_m_s if step.setpoint_sent else (math.nan,) * 3),
            "flown, ENU": _velocity(step.own_velocity_enu_m_s),
            "filter": (f"{status}, barrier {'acts' if step.barrier_active else 'idle'}", ""),
        }
    fresh = dict.fromkeys(rows, watch.fresh)
    if (health := watch.health) is not None:
        armed, share = "ARMED" if health.armed else "disarmed", _value(100.0 * health.battery_share, ".0f")
        landed = name_of(Landed, health.landed).lower().replace("_", " ")
        rows |= {
            "vehicle state": _age(health.own_age_s, health.own_valid),
            "target": _age(health.target_age_s, health.target_valid),
            "heartbeat": _age(health.link_age_s, health.link_valid),
            "samples refused": (str(health.target_rejected), ""),
            "vehicle": (f"{armed}, {name_of(Mode, health.mode).lower()}, {landed}", ""),
            "battery": (f"{_value(health.battery_v, '.2f')} V {share} %", ""),
            "reason": (one_line(health.reason), ""),
        }
    periods = [t.period_s for t in watch.timings if t.period_s > 0.0]
    if periods:
        last, mean_ms = watch.timings[-1], 1e3 * sum(periods) / len(periods)
        dropped = f", {last.feed_dropped} log records dropped" if last.feed_dropped else ""
        loop = f"{mean_ms:.2f} ms, tick {1e6 * last.exec_s:.0f} us, {last.overruns} overruns{dropped}"
        rows["loop"], fresh["loop"] = (loop, ""), watch.fresh
    return {
        name: Text(text, style=style if fresh.get(name, watch.health_fresh) else "dim")
        for name, (text, style) in rows.items()
    }


def _velocity(values_m_s: Sequence[float]) -> tuple[str, str]:
    """Return text and style of a velocity (east, north, up)."""
    return " ".join(_value(value, "+.3f") for value in values_m_s) + " m/s", ""


def _age(age_s: float, valid: bool) -> tuple[str, str]:
    """Return text and style of an age, red if the onboard process counts the data as lost."""
    return f"{1e3 * age_s:.0f} ms" if age_s == age_s else "never", "green" if valid else "bold red"


def _value(value: float, how: str) -> str:
    return format(value, how) if math.isfinite(value) else "-"
