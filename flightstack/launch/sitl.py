"""The runs of ``sitl``: each starts vehicle, target, onboard process and recorder, and watches them."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Column, Table

from flightstack.common.hangup import CalledOffError
from flightstack.common.processes import LaunchError
from flightstack.common.strict_toml import ConfigError, dumps
from flightstack.config.files import load as load_config
from flightstack.core.parameters.filters import short_name
from flightstack.core.parameters.flight import FlightConfig
from flightstack.launch.launcher import NAMESPACE, Followed, Launcher, Shown
from flightstack.launch.result import Flown, conclude_values, landed
from flightstack.launch.run_options import Flies, RunOptions
from flightstack.launch.vehicles import (
    VEHICLES,
    common_options,
    configuration_for,
    longest_s,
    others_s,
)
from flightstack.onboard.options import OnboardOptions
from flightstack.onboard.recording import describe, log_in, new_folder
from flightstack.verify.certificate import problems
from logs.schema.names import NO_PAD
from sim.chance import name as seed_name
from sim.runners.options import TargetOptions
from sim.scenarios.scenario import Scenario, path_of
from sim.scenarios.scenario import load as load_scenario

Row = Mapping[str, object]
_COLUMNS = (
    ("seed", "seed"),
    ("outcome", "outcome"),
    ("violation", "violation"),
    ("error, m", "touchdown_error_m"),
    ("speed down, m/s", "touchdown_speed_vertical_m_s"),
    ("lowest h outside the pad, m", "h_min_outside_pad_m"),
    ("time, s", "time_to_land_s"),
    ("real-time factor", "realtime_factor"),
)
GRACE_S = 60.0  # s of wall time beyond the scenario's duration before a run is given up
LOCKSTEP_SLOWEST = 0.05  # share of real time below which a lockstep run is given up


def prepare(options: RunOptions) -> Scenario:
    """Load and check the scenario, with the configuration for the chosen autopilot.

    Raises:
        ConfigError: it must not fly.
    """
    if options.members:
        raise ConfigError(f"--member is for a scenario of several vehicles; {options.scenario} has one")
    scenario = adapted(options, load_scenario(options.scenario))
    if scenario.onboard.fleet is not None and options.lockstep:
        raise ConfigError(
            "[fleet]: in lockstep all members are flown by one command: --scenario with a team's (see "
            "`scenarios`), or fly in real time"
        )
    return VEHICLES[options.flies].adapt(scenario)


def adapted(options: RunOptions, scenario: Scenario) -> Scenario:
    """Return a scenario as the options want it.

    Raises:
        ConfigError: it must not fly.
    """
    name = options.config_file or configuration_for(options.flies, scenario)
    if name is not None:
        scenario = replace(scenario, onboard=_begun_as(scenario, load_config(name)))
    if options.filter is not None:
        scenario = scenario.with_filter(options.filter)
    if options.duration_s is not None:
        if options.duration_s <= 0.0:
            raise ConfigError(
                f"--duration: found {options.duration_s:g}, a positive number of seconds is needed"
            )
        scenario = replace(scenario, duration_max_s=options.duration_s)
    found = problems(scenario.onboard)
    if found:
        raise ConfigError(f"{name or options.scenario}: refused before take-off: " + "; ".join(found))
    return scenario


def _begun_as(scenario: Scenario, config: FlightConfig) -> FlightConfig:
    """Begin the landing where the scenario does, in its fleet, unless the configuration says else."""
    if config.fleet is None:  # a member's is its own
        config = replace(config, fleet=scenario.onboard.fleet)
    if config.takeoff.start_offset_m is not None:
        return config
    start_offset_m = scenario.onboard.takeoff.start_offset_m
    return replace(config, takeoff=replace(config.takeoff, start_offset_m=start_offset_m))


def run(options: RunOptions, console: Console) -> Flown:
    """Fly one scenario with processes of its own.

    Raises:
        ConfigError: wrong input.
        LaunchError: a process did not start.
    """
    scenario = prepare(options)
    folder = options.out or new_folder(
        f"{scenario.name}-seed{seed_name(options.seed)}-{short_name(scenario.onboard.filter)}"
    )
    log = log_in(folder)
    scenario_file, config_file = folder / "scenario.toml", folder / "onboard.toml"
    scenario_file.write_text(dumps(scenario))
    config_file.write_text(dumps(scenario.onboard))
    with Launcher(folder, console, tells=options.live) as launcher:
        return _fly(launcher, options, scenario, log)


def _fly(launcher: Launcher, options: RunOptions, scenario: Scenario, log: Path) -> Flown:
    """Start the processes, and watch until the flight ends."""
    folder, duration_s = launcher.folder, scenario.duration_max_s
    target_at, onboard_at = launcher.endpoint(), launcher.endpoint()
    recorder = launcher.record(log)
    if options.view is not None:
        launcher.view(options.view, onboard_at, folder / "onboard.toml")
    _describe(launcher.socket, options, scenario, folder / "scenario.toml")
    vehicle = VEHICLES[options.flies].start(launcher, options, scenario, target_at)
    both: Mapping[str, Any] = {
        **vehicle.clock, "lockstep": options.lockstep, "ros2_where": options.ros2_where,
        "ros_domain": options.ros_domain,
    }  # fmt: skip
    target = launcher.start(
        "target",
        TargetOptions(
            **common_options(launcher, options), **both, rate_hz=scenario.onboard.loop.rate_hz,
            duration_s=others_s(scenario), listen=(target_at,), connect=(onboard_at,),
        ),
    )  # fmt: skip
    onboard = launcher.start(
        "onboard",
        OnboardOptions(
            **vehicle.options, **both, target_key=f"{NAMESPACE}/target/odom", connect=(target_at,),
            listen=(onboard_at, *options.listen), config_file=folder / "onboard.toml", duration_s=duration_s,
            recorder=launcher.socket, zenoh_config=options.zenoh_config,
            accept_release=options.accept_release,
        ),
    )  # fmt: skip
    for child in (*vehicle.pending, target, onboard):  # they load at once
        child.wait_ready()
    if not options.lockstep:
        recorder.yield_to_others(10)
    for endpoint in (onboard_at, *options.listen):
        launcher.console.print(
            f"to watch: flightstack watch --connect {endpoint}", style="dim", soft_wrap=True
        )
    limit_s = (
        longest_s(scenario) / (LOCKSTEP_SLOWEST if options.lockstep else min(1.0, options.speed)) + GRACE_S
    )
    title = f"{scenario.name}  seed {seed_name(options.seed)}  filter {scenario.onboard.filter}"
    live = options.live and launcher.console.is_terminal and not options.lockstep
    started, flight = time.monotonic(), Followed(onboard)
    problem = launcher.watch(
        [flight], [*vehicle.children, target, recorder], limit_s,
        Shown([onboard_at], title) if live else None, vehicle.teller,
    )  # fmt: skip
    wall_s = time.monotonic() - started
    launcher.end_all()
    if problem is None and recorder.process.returncode != 0:  # it may end after the flight
        problem = f"record did not end in order: {recorder.errors() or 'no reason given'}"
    about = {"scenario": scenario.name, "seed": options.seed, "filter": scenario.onboard.filter}
    code, said = onboard.process.returncode, flight.last_line
    return Flown(about, folder, log, wall_s, code, said, problem, launcher.interrupted)


def _describe(recorder: Path, options: RunOptions, scenario: Scenario, scenario_file: Path) -> None:
    describe(
        recorder,
        scenario.onboard,
        run_metadata(options, scenario, options.seed),
        {
            "scenario.toml": scenario_file.read_bytes(),
            "scenario_source.toml": path_of(options.scenario).read_bytes(),
        },
    )


def run_metadata(options: RunOptions, scenario: Scenario, seed: int) -> dict[str, str]:
    """Return what the log says of the run of a scenario."""
    return {
        "scenario": scenario.name,
        "description": scenario.description,
        "seed": str(seed),
        "mode": "lockstep" if options.lockstep else "real-time",
        **options.told,
        "judge_alpha_1_m": repr(scenario.judge.alpha_1_m),
        "judge_beta_m": repr(scenario.judge.beta_m),
        "pad_radius_m": repr(scenario.target.pad_radius_m),
        **({"pad": NO_PAD} if options.flies in (Flies.PX4_SIH, Flies.ARDUPILOT) else {}),
    }


class Flight(NamedTuple):
    """A run that is over.

    Attributes:
        values: those of ``--json``.
        landed: whether all vehicles landed and no process failed.
        problem: a process that failed.
        interrupted: whether the operator ended it.
    """

    values: Row
    landed: bool
    problem: str | None
    interrupted: bool


def fly_one(options: RunOptions, console: Console, *, with_report: bool) -> Flight:
    """Fly a scenario of one vehicle and judge it.

    Raises:
        ConfigError: wrong input.
        LaunchError: a process did not start.
    """
    flown = run(options, console)
    values = conclude_values(flown, with_report=with_report)
    return Flight(values, landed(values, flown), flown.problem, flown.interrupted)


def fly_all(
    options: RunOptions,
    runs: int,
    console: Console,
    fly: Callable[..., Flight],
    *,
    as_json: bool,
    with_report: bool,
) -> int:
    """Fly with the seeds from ``options.seed`` on, each in a folder of its own; print a table and a summary.

    A run that does not start counts as not landed, and the next is flown; Ctrl-C ends after the one it is in.

    Args:
        options: of the first run.
        runs: how many.
        console: for what is told on the way.
        fly: flies one; arguments as of ``fly_one``.
        as_json: print the summary as one JSON object.
        with_report: write the report of each.

    Returns:
        Exit status: 0 all landed, 1 some did not.

    Raises:
        ConfigError: wrong input.
    """
    base = options.out or new_folder(f"{Path(options.scenario).stem}-{runs}-runs")
    rows: list[Row] = []
    for seed in range(options.seed, options.seed + runs):
        one = replace(options, seed=seed, out=base / f"seed{seed}")
        try:
            flown = fly(one, console, with_report=with_report)
        except CalledOffError:
            break
        except LaunchError as error:
            console.print(f"seed {seed}: {error}", style="red", markup=False)
            rows.append({"seed": seed, "outcome": None, "reason": str(error), "problem": str(error)})
            continue
        rows.append({**flown.values, "problem": flown.problem, "landed": flown.landed})
        told = "  ".join(f"{name} {_shown(flown.values.get(key))}" for name, key in _COLUMNS)
        console.print(told, soft_wrap=True, markup=False)
        if flown.interrupted:
            break
    summary = sum_up(rows, runs)
    console.print(_table(rows))
    if as_json:
        print(json.dumps(summary))
    else:
        console.print(
            "  ".join(f"{name} {_shown(value)}" for name, value in summary.items() if name != "rows")
        )
    return 0 if summary["landed"] == runs else 1


def sum_up(rows: Sequence[Row], runs: int) -> dict[str, object]:
    """Return counts and medians of several runs.

    Args:
        rows: the values of each run, with ``landed``.
        runs: how many were asked for.
    """
    counts = Counter(row.get("outcome") for row in rows)
    return {
        "runs": runs,
        "flown": len(rows),
        "landed": sum(row.get("landed") is True for row in rows),
        "crashed": counts["crashed"],
        "aborted": counts["aborted"],
        "violations": sum(row.get("violation") is True for row in rows),
        "touchdown_error_m": _median(rows, "touchdown_error_m"),
        "touchdown_error_max_m": max(_numbers(rows, "touchdown_error_m"), default=None),
        "touchdown_speed_vertical_m_s": _median(rows, "touchdown_speed_vertical_m_s"),
        "time_to_land_s": _median(rows, "time_to_land_s"),
        "realtime_factor": _median(rows, "realtime_factor"),
        "rows": list(rows),
    }


def _numbers(rows: Sequence[Row], key: str) -> list[float]:
    return [value for row in rows if isinstance(value := row.get(key), float)]


def _median(rows: Sequence[Row], key: str) -> float | None:
    found = _numbers(rows, key)
    return median(found) if found else None


def _table(rows: Sequence[Row]) -> Table:
    table = Table(*(Column(name, justify="right") for name, _ in _COLUMNS))
    for row in rows:
        table.add_row(*(_shown(row.get(key)) for _, key in _COLUMNS))
    return table


def _shown(value: object) -> str:
    return "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
