"""The live view in the terminal: phase, error, distance, h, loop period, nominal and filtered velocity."""

from __future__ import annotations

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from bridge import zenoh_link
from flightstack.safety_filter import FilterStatus
from flightstack.types import Phase
from logs.codec import ControllerStepRow, LoopTimingRow, unpack_controller_step, unpack_loop_timing

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
}
_BAR = 40  # characters


class LiveView:
    """Subscribes to the onboard process and draws; nothing depends on it."""

    def __init__(self, session: zenoh_link.Session, namespace: str, title: str, console: Console) -> None:
        self._step = zenoh_link.ring_subscriber(session, f"{namespace}/controller/step", 4)
        self._timing = zenoh_link.ring_subscriber(session, f"{namespace}/loop/timing", 4)
        self._title = title
        self._steps: list[ControllerStepRow] = []
        self._timings: list[LoopTimingRow] = []
        self.live = Live(self._draw(), console=console, refresh_per_second=REFRESH_HZ, transient=False)

    def poll(self) -> None:
        """Take what has come and redraw."""
        for sample in zenoh_link.drain(self._step):
            self._steps = [*self._steps[-1:], unpack_controller_step(sample.payload.to_bytes())]
        for sample in zenoh_link.drain(self._timing):
            self._timings = [*self._timings[-19:], unpack_loop_timing(sample.payload.to_bytes())]
        self.live.update(self._draw())

    def _draw(self) -> Panel:
        if not self._steps:
            return Panel(Text("waiting for the onboard process", style="dim"), title=self._title)
        return draw(self._steps[-1], self._timings, self._title)


def draw(step: ControllerStepRow, timings: list[LoopTimingRow], title: str) -> Panel:
    """One picture of the present state."""
    phase = Phase(step.phase)
    e = [p - q for p, q in zip(step.own_position_enu_m, step.target_position_enu_m, strict=True)]
    d = (e[0] ** 2 + e[1] ** 2) ** 0.5
    head = Table.grid(padding=(0, 3))
    head.add_row(
        Text(f" {phase.name} ", style=f"reverse {_STYLE[phase]}"),
        f"e_z [b]{e[2]:+.3f}[/b] m",
        f"d [b]{d:.3f}[/b] m",
        Text(f"h {step.h_m:+.3f} m", style="red bold" if step.h_m < 0 else "green bold"),
        _timing_text(timings),
    )
    return Panel(Group(head, _h_bar(step.h_m), _velocities(step)), title=title, title_align="left")


def _timing_text(timings: list[LoopTimingRow]) -> str:
    periods = [t.period_s for t in timings if t.period_s > 0.0]
    if not periods:
        return "period -"
    mean_ms = 1e3 * sum(periods) / len(periods)
    return (
        f"period {mean_ms:.2f} ms   step {1e6 * timings[-1].exec_s:.0f} us   overruns {timings[-1].overruns}"
    )


def _h_bar(h_m: float) -> Text:
    """H from -0.2 to 1.0 m; the mark | is h = 0."""
    zero = round(_BAR * 0.2 / 1.2)
    at = round(_BAR * (min(max(h_m, -0.2), 1.0) + 0.2) / 1.2) if h_m == h_m else zero
    cells = ["#" if zero < i <= at or at <= i < zero else "." for i in range(_BAR + 1)]
    cells[zero] = "|"
    return Text("h -0.2 [" + "".join(cells) + "] 1.0 m", style="red" if h_m < 0 else "green")


def _velocities(step: ControllerStepRow) -> Table:
    table = Table(box=None, padding=(0, 2), header_style="dim")
    for column in ("set-point, m/s", "east", "north", "up"):
        table.add_column(column, justify="left" if "set" in column else "right")
    for name, values in (
        ("nominal", step.nominal_enu_m_s),
        ("filtered", step.filtered_enu_m_s),
        ("sent", step.command_enu_m_s if step.setpoint_sent else (float("nan"),) * 3),
    ):
        table.add_row(name, *(f"{v:+.3f}" if v == v else "-" for v in values))
    status = FilterStatus(step.filter_status).name.lower().replace("_", " ")
    acting = "barrier acts" if step.barrier_active else "barrier idle"
    table.add_row("filter", status, acting, f"refused {step.target_rejected}")
    return table
