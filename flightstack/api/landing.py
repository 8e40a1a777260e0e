"""Scenarios with changes of single keys, and landings that were flown in this process or read from a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from flightstack.common.pacing import Tick
from flightstack.common.strict_toml import ConfigError, from_table, over, to_table
from flightstack.core.controller import Outputs
from flightstack.core.parameters.filters import give, look_here
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import strategy_class
from logs.reader.flight import columns, load_flight, since
from logs.reader.flight_data import Flight, Steps, Truth
from logs.schema.controller_rows import step_row
from logs.schema.rows import ControllerStepRow
from logs.verdict.types import Verdict
from logs.verdict.verdict import judge
from sim.runners import landing as runner
from sim.scenarios.scenario import Scenario, load, one_pad

if TYPE_CHECKING:
    import plotly.graph_objects as go

Changes: TypeAlias = Mapping[str, Any]
FilterLike: TypeAlias = str | type[Any] | None
_SCENARIO = frozenset(field.name for field in fields(Scenario))
_FLOWN = frozenset(field.name for field in fields(FlightConfig))
_PAD = ("onboard", "touchdown", "pad_radius_m")


def scenario(
    name: str | Path | Scenario = "lab", changes: Changes | None = None, *, filter: FilterLike = None
) -> Scenario:
    """Return a scenario with changes of some keys, made for each of its vehicles.

    Args:
        name: name of a packaged scenario, path of a file, or scenario object.
        changes: values by key, e.g. ``{"wind.mean_m_s": 1.0, "barrier.omega_1_s": 0.7}``; keys of the flown
        configuration need no prefix ``onboard.`` unless the scenario has a table of the same name.
        filter: ``"paper"``, ``"robust"``, ``MODULE:NAME`` or a class; None: the scenario's filter.

    Raises:
        ConfigError: unknown scenario or key, wrong unit or type, value out of range.
    """
    made = name if isinstance(name, Scenario) else load(name)
    if filter is not None:
        changes = {**(changes or {}), "onboard.filter": filter_name(filter)}
    if not changes:
        return made
    if "others" in (_path(key)[0] for key in changes):
        raise ConfigError("others: unknown key; each change is made for all vehicles of the scenario")
    return Scenario.of(_changed(each, changes) for each in made.members)


def single(name: str | Path | Scenario, changes: Changes | None, filter: FilterLike) -> Scenario:
    """Return a scenario as ``scenario`` does. Raises ConfigError also for several vehicles."""
    made = scenario(name, changes, filter=filter)
    made.one(0, None)
    return made


def _changed(member: Scenario, changes: Changes) -> Scenario:
    table = to_table(member)
    for key, value in changes.items():
        part = _plain(value)
        for step in reversed(_path(key)):
            part = {step: part}
        table = over(table, part)
    if _PAD not in map(_path, changes):  # without this key, the robot's pad gives the radius
        del table["onboard"]["touchdown"]["pad_radius_m"]
    return from_table(Scenario, one_pad(table), keys=sorted(_SCENARIO - {"others"}))


def whole(what: str, found: object, low: int = 0) -> int:
    """Return a Python or numpy integer as int. Raises ConfigError: not an integer, or below ``low``."""
    number = None if isinstance(found, bool) or not hasattr(found, "__index__") else index(found)
    if number is None or number < low:
        raise ConfigError(f"{what}: found {found!r:.60}, a whole number from {low} on is needed")
    return number


def filter_name(filter: str | type[Any]) -> str:
    """Return the name of a filter for the configuration. Raises ConfigError: ``filter`` is not a filter."""
    name = filter if isinstance(filter, str) else give(filter)
    look_here(name)
    strategy_class(name)
    return name


def _path(key: str) -> tuple[str, ...]:
    """Return the path of a key from the scenario's root: the names of its tables, then its own name."""
    if not isinstance(key, str):
        raise ConfigError(f"changes: found the key {key!r}, a text such as 'wind.mean_m_s' is needed")
    steps = tuple(key.split("."))
    return steps if steps[0] in _SCENARIO or steps[0] not in _FLOWN else ("onboard", *steps)


def _plain(value: Any) -> Any:
    """Return a value as TOML can store it; numpy arrays become lists."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_plain(each) for each in value] if isinstance(value, tuple | list) else value


@dataclass(frozen=True, repr=False)
class Landing:
    """A judged flight of one vehicle, simulated by ``land`` or read from a log.

    Attributes:
        verdict: outcome (``landed``, ``crashed``, ``aborted``, ``timeout``), reason, lowest h, touchdown;
        from the true states if they are known.
        flight: data of the flight, as arrays.
        seed: seed of all random draws; None for a log.
    """

    verdict: Verdict
    flight: Flight
    seed: int | None = None

    def __repr__(self) -> str:
        found = self.verdict
        name = f"{self.flight.path}" if self.seed is None else f"{self.flight.path}, seed {self.seed}"
        lowest = "" if found.h_min_m is None else f", lowest h {found.h_min_m:.3f} m"
        error = (
            "" if found.touchdown_error_m is None else f", touchdown error {found.touchdown_error_m:.3f} m"
        )
        violation = {True: "violation", False: "no violation", None: "violation unknown"}[found.violation]
        return f"Landing({name}: {found.outcome.value}, {violation}{lowest}{error})"

    @property
    def log(self) -> Steps:
        """Arrays of the n controller steps: ``t_s``, ``h_m`` (n,), ``command_enu_m_s`` (n, 3), and more.

        Raises:
            ValueError: the log contains no steps.
        """
        if self.flight.steps is None:
            raise ValueError(f"{self.flight.path}: the log holds no controller steps")
        return self.flight.steps

    @property
    def truth(self) -> Truth | None:
        """True states of a simulated flight: ``t_s``, ``h_m`` (n,), ``position_enu_m`` (n, 3), and more."""
        return self.flight.truth

    def plot(self) -> go.Figure:
        """Return a figure of the vehicle's path relative to the landing spot, with the barrier's boundary.

        Raises:
            MissingExtraError: plotly is not installed.
            ValueError: no tick has the positions of both vehicle and target.
        """
        from logs.report.page import need_libraries

        need_libraries()
        from logs.report.space import trajectory_3d

        figure = trajectory_3d({"vehicle": self.flight})
        if figure is None:
            raise ValueError("no path: in no tick the positions of both vehicle and target are known")
        return figure


def read_log(path: Path | str, member: str | None = None) -> Landing:
    """Read and judge a flight log.

    Args:
        path: path of the log, ``flight.mcap``.
        member: name of a fleet member; None: the log contains only one vehicle.

    Raises:
        LogError: the file is not a log, or the log has no such member.
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
        filter: ``"paper"``, ``"robust"``, ``MODULE:NAME``, or a class; None: the scenario's filter.
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
    except ConfigError as error:  # the new traceback shows the robot's function and the caller of ``land``
        raise error.with_traceback(None) from error.__cause__
    steps = columns(Steps, rows, since(np.array(times_ns, dtype=np.int64), times_ns[0]))
    seen = done.seen
    flight = Flight(
        path=Path(flown.name),
        origin_ns=times_ns[0],
        duration_s=done.simulated_s,
        steps=steps,
        truth=seen.truth,
        events=seen.events,
        config=flown.onboard,
        barrier=flown.judged_by,
        pad_radius_m=seen.pad_radius_m,
    )
    return Landing(done.verdict, flight, seed)
