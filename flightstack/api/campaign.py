"""Campaigns: many landings with different seeds on all cores, of one scenario or of a grid of key values."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flightstack.api.frames import frame
from flightstack.api.landing import Changes, FilterLike, scenario, whole
from flightstack.common.processes import may_fork
from flightstack.common.strict_toml import ConfigError
from flightstack.common.terminal import Bar, Terminal
from flightstack.core.parameters.filters import given
from flightstack.verify.certificate import refuse
from logs.report.style import layout
from sim.campaign.rows import Row, failed_rows, row_of
from sim.campaign.summary import kinds, summary
from sim.campaign.workers import fly_here
from sim.runners.landing import land, warm_up
from sim.scenarios.scenario import Scenario, text
from sim.vehicle.declared import judged_apart, not_proven

if TYPE_CHECKING:
    import plotly.graph_objects as go

_RATES = ("landed", "violations")


@dataclass(frozen=True, repr=False)
class Campaign:
    """Results of the seeded landings of one scenario.

    Attributes:
        rows: one row for each seed, in seed order: outcome, violation, lowest h, touchdown error, times.
        scenario: scenario that was flown.
        wall_s: wall time of the campaign without compilation, s.
    """

    rows: tuple[Row, ...]
    scenario: Scenario
    wall_s: float

    @cached_property
    def table(self) -> Any:
        """DataFrame with a row for each seed, see ``frame``; lengths in m, times in s."""
        return frame(list(map(_values, self.rows)))

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Counts of outcomes, rates with 95 % confidence bounds, quantiles of results, worst seeds."""
        flown_s = sum(row.simulated_s or 0.0 for row in self.rows)
        apart = judged_apart(self.scenario)
        return summary(
            self.rows, "fs.land(..., seed={seed})", wall_s=self.wall_s, flown_s=flown_s, judged_apart=apart
        )

    def __len__(self) -> int:
        """Number of landings."""
        return len(self.rows)

    def __repr__(self) -> str:
        landed = sum(row.landed for row in self.rows)
        violations = sum(row.violation is not False for row in self.rows)
        return (
            f"Campaign({self.scenario.name}: {landed} of {len(self)} landed, {violations} with a "
            f"violation or unknown, {self.wall_s:.1f} s)"
        )


@dataclass(frozen=True, repr=False)
class Sweep:
    """Landings on a grid of keys.

    Attributes:
        keys: swept keys.
        points: for each point of the grid, the values of the keys and the landings.
    """

    keys: tuple[str, ...]
    points: tuple[tuple[tuple[Any, ...], Campaign], ...]

    def _named(self) -> list[tuple[dict[str, Any], Campaign]]:
        """Return for each point the values of the swept keys, by key, and the landings."""
        return [(dict(zip(self.keys, values, strict=True)), flown) for values, flown in self.points]

    @cached_property
    def table(self) -> Any:
        """DataFrame with a row for each point and seed: swept keys, then columns of ``Campaign.table``."""
        return frame([at | _values(row) for at, flown in self._named() for row in flown.rows])

    def rates(self) -> list[dict[str, Any]]:
        """Return for each point: values by key, number of runs, fractions of landings and violations."""
        return [
            at
            | {
                "runs": len(flown),
                "landed": sum(row.landed for row in flown.rows) / len(flown),
                "violations": sum(row.violation is not False for row in flown.rows) / len(flown),
            }
            for at, flown in self._named()
        ]

    def __repr__(self) -> str:
        lines = (
            f"  {', '.join(f'{k} {v}' for k, v in at.items())}: {flown!r}" for at, flown in self._named()
        )
        return "\n".join(("Sweep(", *lines, ")"))

    def plot(self) -> go.Figure:
        """Return a figure of the fractions of landings and of violations, against the first key.

        Each combination of values of the other keys has its own lines.

        Raises:
            ModuleNotFoundError: plotly is not installed.
        """
        import plotly.graph_objects as go

        figure, first, others = go.Figure(), self.keys[0], self.keys[1:]
        rates = self.rates()
        for line in dict.fromkeys(tuple(point[key] for key in others) for point in rates):
            part = [point for point in rates if tuple(point[key] for key in others) == line]
            named = ", ".join(f"{key} {value}" for key, value in zip(others, line, strict=True))
            for rate in _RATES:
                x, y = [point[first] for point in part], [100.0 * point[rate] for point in part]
                name = f"{rate}, {named}" if named else rate
                dash = "solid" if rate == "landed" else "dot"
                figure.add_trace(go.Scatter(x=x, y=y, name=name, mode="lines+markers", line_dash=dash))
        layout(figure, 420)
        figure.update_xaxes(title_text=first)
        figure.update_yaxes(title_text="share of the landings [%]", range=[-2, 102])
        return figure


def campaign(
    name: str | Path | Scenario = "lab", seeds: Iterable[int] = range(100), *, filter: FilterLike = None,
    changes: Changes | None = None, workers: int | None = None,
) -> Campaign:  # fmt: skip
    """Fly many seeds of a scenario with one or several vehicles, with a progress bar.

    A filter class that a notebook or function defines reaches the workers by fork. If a fork is not safe
    (other threads, or not Linux), cloudpickle sends the class; without it this process flies the seeds.

    Args:
        name: name, file or object of the scenario.
        seeds: seeds to fly.
        filter: ``"paper"``, ``"robust"``, ``MODULE:NAME``, or a class; None: the scenario's filter.
        changes: keys of the scenario to change for each vehicle, see ``scenario``.
        workers: number of processes; None: one for each core.

    Raises:
        ConfigError: a scenario, key, value or filter is wrong, or the certificate refuses the configuration.
        WorkersError: no worker process could be started.
    """
    return _flown([_checked(name, changes, filter)], seeds, workers)[0]


def sweep(
    name: str | Path | Scenario, grid: Mapping[str, Sequence[Any]], seeds: Iterable[int] = range(100), *,
    filter: FilterLike = None, changes: Changes | None = None, workers: int | None = None,
) -> Sweep:  # fmt: skip
    """Fly a set of seeds at each point of a grid of keys.

    Each landing is judged by the barrier of its own flight, also if the grid changes this barrier. If the
    scenario or the changes contain a table ``judge``, the barrier in this table judges all landings.

    Args:
        name: name, file or object of the scenario.
        grid: values of each key, e.g. ``{"wind.mean_m_s": [0, 1]}``; all combinations are flown.
        seeds: seeds to fly, the same at each point.
        filter: as for ``campaign``.
        changes: keys of the scenario to change at all points, see ``scenario``.
        workers: number of processes; None: one for each core.

    Raises:
        ConfigError: a scenario, key, value or filter is wrong, or the certificate refuses a point.
        WorkersError: no worker process could be started.
    """
    values = grid.values() if isinstance(grid, Mapping) else ()
    usable = values and all(isinstance(each, Iterable) and not isinstance(each, str) for each in values)
    if not usable or not (points := list(product(*values))):
        raise ConfigError(f"sweep: found {grid!r:.60}; a key and values for it are needed")
    made = [_checked(name, {**(changes or {}), **dict(zip(grid, at, strict=True))}, filter) for at in points]
    return Sweep(tuple(grid), tuple(zip(points, _flown(made, seeds, workers), strict=True)))


def _values(row: Row) -> dict[str, Any]:
    """Return a landing's table columns by name: all fields of the row except ``cells``, the map of h."""
    return {name: value for name, value in asdict(row).items() if name != "cells"}


def _checked(name: str | Path | Scenario, changes: Changes | None, filter: FilterLike) -> Scenario:
    """Return a scenario with the changes made for each vehicle, after a check of its configurations."""
    made = scenario(name, changes, filter=filter)
    refuse((each.onboard for each in made.members), made.name)
    return made


def _flown(points: Sequence[Scenario], given: Iterable[int], workers: int | None) -> list[Campaign]:
    """Fly the seeds in each scenario; return one campaign per scenario."""
    if not isinstance(given, Iterable) or not (seeds := [whole("seeds", seed) for seed in given]):
        raise ConfigError(f"seeds: found {given!r:.60}; whole numbers from 0 on are needed, one at least")
    if twice := [seed for seed, times in Counter(seeds).items() if times > 1]:
        raise ConfigError(f"seeds: found {twice[0]} more than once; each seed is flown and counted once")
    number = (os.cpu_count() or 1) if workers is None else whole("workers", workers, 1)
    first, done = points[0], []
    console = Terminal(stderr=True)
    if line := not_proven(first):
        console.print(line, soft_wrap=True)
    with Bar(console, f"{first.name}, filter {first.onboard.filter}", len(points) * len(seeds)) as bar:
        for flown in points:
            warm_up(flown)
            rows, began_s = [], time.monotonic()  # the wall time excludes compilation
            for row in _rows(flown, seeds, number):
                rows.append(row)
                bar.done(*kinds(row))
            by_seed = tuple(sorted(rows, key=lambda row: row.seed))
            if problem := failed_rows(by_seed):
                console.print(problem, soft_wrap=True, markup=False)
            done.append(Campaign(by_seed, flown, time.monotonic() - began_s))
    return done


def _rows(flown: Scenario, seeds: list[int], workers: int) -> Iterable[Row]:
    classes = [] if may_fork() else [given(each.onboard.filter) for each in flown.members]
    here, pickled = [each for each in classes if each is not None], b""
    if here and find_spec("cloudpickle") is None:
        yield from (row_of(land(flown, seed)) for seed in seeds)
        return
    if here:
        pickled = import_module("cloudpickle").dumps(here[0])
    longest_s = sum(each.duration_max_s for each in flown.members)
    yield from fly_here(text(flown), seeds, workers, longest_s, pickled)
