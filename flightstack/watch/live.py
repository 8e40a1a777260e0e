"""Live view in the terminal of a local or remote flight; old data is never shown as new."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Column, Table
from rich.text import Text

from flightstack.common.text import one_line
from flightstack.core.types import FilterStatus, Landed, Mode, Phase
from flightstack.watch.state import News, Watch, name_of
from logs.schema.rows import ControllerStepRow, HealthRow, LoopTimingRow

REFRESH_HZ = 8.0
_STYLE = {
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
_BAR = 40  # length of the bar in characters
_H_LOW_M, _H_HIGH_M = -0.2, 1.0  # values of h at both ends of the bar
_LOUD = "bold white on red"


class LiveView:
    """View of the flight of one vehicle, or of several with a line each; no flight depends on it."""

    def __init__(self, watches: Mapping[str, Watch], title: str, console: Console, whom: str = "") -> None:
        self._watches, self._title, self._whom = watches, title, whom
        self.live = Live(self._draw(), console=console, refresh_per_second=REFRESH_HZ, transient=False)

    def poll(self) -> None:
        """Read the new samples and redraw."""
        for watch in self._watches.values():
            watch.poll()
        self.live.update(self._draw())

    def _draw(self) -> Panel:
        if len(self._watches) == 1:
            return draw(next(iter(self._watches.values())), self._title, self._whom)
        return draw_fleet(self._watches, self._title)


def draw_fleet(watches: Mapping[str, Watch], title: str) -> Panel:
    """Return a table with a line for each vehicle."""
    right = (Column(name, justify="right") for name in ("e_z, m", "d, m", "h, m", "overruns"))
    table = Table("vehicle", "phase", *right, "filter", "why", box=None, padding=(0, 2))
    for namespace, watch in watches.items():
        table.add_row(Text(namespace), *_line(watch), style="none" if watch.news is News.FRESH else "dim")
    return Panel(table, title=Text(title), title_align="left")


def _line(watch: Watch) -> tuple[str | Text, ...]:
    """Return phase, relative height, distance, h, overruns, filter and reason of a vehicle, if known."""
    step = watch.step
    if step is None:
        return (watch.news.value,)
    fresh = watch.news is News.FRESH or watch.over
    x, y, z = (p - q for p, q in zip(step.own_position_enu_m, step.target_position_enu_m, strict=True))
    style = _STYLE[Phase(step.phase)] if step.phase in Phase._value2member_map_ else ""
    return (
        Text(name_of(Phase, step.phase), style=style if fresh else "dim"),
        _value(z, "+.3f"),
        _value(math.hypot(x, y), ".3f"),
        Text(_value(step.h_m, "+.3f"), style=_dim("red" if step.h_m < 0.0 else "green", fresh)),
        str(watch.timings[-1].overruns) if watch.timings else "-",
        name_of(FilterStatus, step.filter_status).lower().replace("_", " "),
        Text(one_line(watch.health.reason) if watch.health is not None else ""),
    )


def draw(watch: Watch, title: str, whom: str = "") -> Panel:
    """Return the view of the known values and their ages."""
    style = "none" if watch.news is News.FRESH else "red"
    parts: list[RenderableType] = [banner(watch, whom)]
    if watch.step is not None:
        fresh = watch.news is News.FRESH
        parts += [_head(watch.step, fresh), _h_bar(watch.step.h_m, fresh), _velocities(watch.step, fresh)]
    if watch.health is not None:
        parts.append(_health(watch.health, watch.health_fresh))
    parts.append(_timing(list(watch.timings), watch.news is News.FRESH))
    return Panel(Group(*parts), title=Text(title), title_align="left", border_style=style)


def banner(watch: Watch, whom: str) -> Text:
    """Return the first line, with the age of the data; it is highlighted when the data is old."""
    refused = f"   {watch.refused} samples not readable" if watch.refused else ""
    if watch.news is News.FRESH:
        tick = watch.step.tick if watch.step is not None else 0
        return Text(f"live, tick {tick}{refused}", style="dim")
    if watch.over:
        phase = name_of(Phase, watch.step.phase) if watch.step is not None else ""
        return Text(f"the flight is over: {phase}, {watch.age_s:.0f} s ago{refused}", style="bold")
    lost = f"no data for {watch.age_s:.1f} s"
    if watch.connections == 0:
        why = f"no reply from {whom}: not running, or access denied" if whom else "no connection"
    elif watch.past_router:
        why = f"{whom} is a router, which passes nothing from peer to peer: --zenoh-config with mode client"
    else:
        why = "connected, but no data arrives on these keys"
    old = "; data below is OLD" if watch.step is not None else ""
    return Text(f" {lost}: {why}{old}{refused} ", style=_LOUD)


def _head(step: ControllerStepRow, fresh: bool) -> Table:
    e = [p - q for p, q in zip(step.own_position_enu_m, step.target_position_enu_m, strict=True)]
    unsafe = step.h_m < 0.0
    style = _STYLE[Phase(step.phase)] if step.phase in Phase._value2member_map_ else ""
    head = Table.grid(padding=(0, 3))
    head.add_row(
        Text(f" {name_of(Phase, step.phase)} ", style=f"reverse {style}" if fresh else "reverse dim"),
        Text(f"e_z {_value(e[2], '+.3f')} m"),
        Text(f"d {_value(math.hypot(e[0], e[1]), '.3f')} m"),
        Text(f"h {_value(step.h_m, '+.3f')} m", style=_dim("bold red" if unsafe else "bold green", fresh)),
        style="none" if fresh else "dim",
    )
    return head


def _h_bar(h_m: float, fresh: bool) -> Text:
    """Return a bar of h from -0.2 to 1.0 m; the mark | is h = 0."""
    span = _H_HIGH_M - _H_LOW_M
    zero = round(_BAR * -_H_LOW_M / span)
    at = round(_BAR * (min(max(h_m, _H_LOW_M), _H_HIGH_M) - _H_LOW_M) / span) if h_m == h_m else zero
    cells = ["#" if zero < i <= at or at <= i < zero else "." for i in range(_BAR + 1)]
    cells[zero] = "|"
    bar = f"h {_H_LOW_M} [" + "".join(cells) + f"] {_H_HIGH_M} m"
    return Text(bar, style=_dim("red" if h_m < 0 else "green", fresh))


def _velocities(step: ControllerStepRow, fresh: bool) -> Table:
    axes = (Column(axis, justify="right") for axis in ("east", "north", "up"))
    style = "none" if fresh else "dim"
    table = Table("velocity, m/s", *axes, box=None, padding=(0, 2), header_style="dim", style=style)
    none = (math.nan,) * 3
    for name, values in (
        ("nominal", step.nominal_enu_m_s),
        ("filtered", step.filtered_enu_m_s),
        ("set-point", step.command_enu_m_s if step.setpoint_sent else none),
        ("flown", step.own_velocity_enu_m_s),
    ):
        table.add_row(name, *(_value(v, "+.3f") for v in values))
    status = name_of(FilterStatus, step.filter_status).lower().replace("_", " ")
    acting = "barrier acts" if step.barrier_active else "barrier idle"
    table.add_row("filter", status, acting, "")
    return table


def _health(health: HealthRow, fresh: bool) -> Table:
    """Return ages and states; those that the onboard process counts as lost are red."""
    grid = Table.grid(padding=(0, 3))
    grid.add_row(
        _age("own state", health.own_age_s, health.own_valid, fresh),
        _age("target", health.target_age_s, health.target_valid, fresh),
        _age("heartbeat", health.link_age_s, health.link_valid, fresh),
        Text(f"samples refused {health.target_rejected}"),
        style="none" if fresh else "dim",
    )
    armed = "ARMED" if health.armed else "disarmed"
    battery = f"battery {_value(health.battery_v, '.2f')} V {_value(100.0 * health.battery_share, '.0f')} %"
    grid.add_row(
        Text(f"{armed}, {name_of(Mode, health.mode).lower()}"),
        Text(name_of(Landed, health.landed).lower().replace("_", " ")),
        Text(battery),
        Text(one_line(health.reason)),
        style="none" if fresh else "dim",
    )
    return grid


def _age(name: str, age_s: float, valid: bool, fresh: bool) -> Text:
    age = f"{1e3 * age_s:.0f} ms" if age_s == age_s else "never"
    return Text(f"{name} {age}", style=_dim("green" if valid else "bold red", fresh))


def _timing(timings: Sequence[LoopTimingRow], fresh: bool) -> Text:
    periods = [t.period_s for t in timings if t.period_s > 0.0]
    if not periods:
        return Text("loop: nothing yet", style="dim")
    mean_ms = 1e3 * sum(periods) / len(periods)
    last = timings[-1]
    text = f"loop period {mean_ms:.2f} ms   tick {1e6 * last.exec_s:.0f} us   overruns {last.overruns}"
    dropped = f"   log records dropped {last.feed_dropped}" if last.feed_dropped else ""
    return Text(text + dropped, style="none" if fresh else "dim")


def _value(value: float, how: str) -> str:
    return format(value, how) if math.isfinite(value) else "-"


def _dim(style: str, fresh: bool) -> str:
    return style if fresh else "dim"
