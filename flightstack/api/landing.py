"""A landing that was flown in this process or read from a log: verdict, arrays, figure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flightstack.api.scenario import Changes, FilterLike, single, whole
from flightstack.common.pacing import Tick
from flightstack.common.strict_toml import ConfigError
from flightstack.core.controller import Outputs
from logs.reader.flight import columns, load_flight, since
from logs.reader.flight_data import Flight, Steps, Truth
from logs.schema.controller_rows import step_row
from logs.schema.rows import ControllerStepRow
from logs.verdict.types import Verdict
from logs.verdict.verdict import judge
from sim.runners import landing as runner
from sim.scenarios.scenario import Scenario

if TYPE_CHECKING:
    import plotly.graph_objects as go


@dataclass(frozen=True)
class Landing:
    """A judged flight of one vehicle, simulated by ``land`` or read from a log.

    Attributes:
        verdict: outcome (``landed``, ``crashed``, ``aborted``, ``timeout``), reason, lowest h, touchdown;
        from the true states if they are known.
        flight: all data of a log, as arrays.
        seed: seed of all random draws; None for a log.
    """

    verdict: Verdict
    flight: Flight
    seed: int | None = None

    @property
    def log(self) -> Steps:
        """Controller steps, n of them: ``t_s``, ``h_m`` (n,), ``command_enu_m_s`` (n, 3), and more.

        Raises:
            ValueError: the log contains no steps.
        """
        if self.flight.steps is None:
            raise ValueError(f"{self.flight.path}: the log holds no controller steps")
        return self.flight.steps

    @property
    def truth(self) -> Truth | None:
        """True states from the simulator: ``t_s``, ``h_m`` (n,), ``position_enu_m`` (n, 3), and more."""
        return self.flight.truth

    def plot(self) -> go.Figure:
        """Return a figure of the path relative to the landing spot, over the barrier.

        Raises:
            ReportError: plotly is not installed.
            ValueError: no tick has the positions of both vehicle and target.
        """
        from logs.report.page import need_libraries

        need_libraries()
        from logs.report.space import trajectory_3d

        figure = trajectory_3d(self.flight)
        if figure is None:
            raise ValueError("no path: in no tick the positions of both vehicle and target are known")
        return figure


def read_log(path: Path | str, member: str | None = None) -> Landing:
    """Read and judge a flight log.

    Args:
        path: path of the log, ``flight.mcap``.
        member: name of a fleet member; None for the log of one flight.

    Raises:
        LogError: the file is no log, or there is no such member.
    """
    flight = load_flight(path, member)
    return Landing(judge(flight), flight)


def land(
    name: str | Path | Scenario = "lab", seed: int = 0, *, filter: FilterLike = None,
    changes: Changes | None = None,
) -> Landing:  # fmt: skip
    """Fly one landing in simulation, in this process, as ``flightstack sitl --lockstep`` does.

    Args:
        name: name, file or object of the scenario.
        seed: seed of all random draws; the same seed gives the same landing to the last bit.
        filter: ``"paper"``, ``"robust"``, ``MODULE:NAME``, or a class; None: that of the scenario.
        changes: keys of the scenario to change, see ``scenario``.

    Raises:
        ConfigError: a scenario, key, value or filter is wrong, or the robot's function failed.
        RuntimeError: the simulation did not reach its end.
    """
    flown, seed = single(name, changes, filter), whole("seed", seed)
    rows: list[ControllerStepRow] = []
    times_ns: list[int] = []

    def on_step(tick: Tick, out: Outputs) -> None:
        rows.append(step_row(tick, out))
        times_ns.append(tick.unix_ns)

    try:
        done = runner.land(flown, seed, on_step=on_step)
    except ConfigError as error:  # the traceback shows the robot's function, then this call
        raise error.with_traceback(None) from error.__cause__
    steps = columns(Steps, rows, since(np.array(times_ns, dtype=np.int64), times_ns[0]))
    seen, limits = done.seen, flown.onboard.limits
    flight = Flight(
        path=Path(flown.name),
        origin_ns=times_ns[0],
        duration_s=done.simulated_s,
        steps=steps,
        truth=seen.truth,
        events=seen.events,
        config=flown.onboard,
        barrier=flown.judged_by,
        velocity_max_m_s=limits.velocity_max_m_s,
        pad_radius_m=seen.pad_radius_m,
    )
    return Landing(done.verdict, flight, seed)
