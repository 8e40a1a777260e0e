"""One run: starts vehicle, target, onboard process and recorder, watches them, judges what they recorded."""

from __future__ import annotations

import json
import platform
import shutil
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from types import FrameType

from rich.console import Console

from bridge import zenoh_link
from bridge.autopilots import AUTO, OWN_SITL
from bridge.ros2_network import Ros2Network
from flightstack.certificate import problems
from flightstack.config import FilterKind, FlightConfig
from flightstack.live import REFRESH_HZ, LiveView
from flightstack.processes import CLOSE_TIME_MAX_S, END_TIME_MAX_S, Child, Port
from flightstack.strict_toml import ConfigError, dumps, to_table
from logs.feed import Feed
from sim.autopilot.geo import ORIGIN_WGS84
from sim.autopilot.personality import PERSONALITIES, PX4
from sim.scenario import Scenario, path_of
from sim.scenario import load as load_scenario

NAMESPACE = "cf1"
LAND_ALONE_MAX_S = 20.0  # s of wall time for the vehicle's own landing without the onboard process
GRACE_S = 60.0  # s of wall time beyond the scenario's duration before a run is given up
LOCKSTEP_SLOWEST = 0.2  # share of real time below which a lockstep run is given up


@dataclass(frozen=True)
class RunOptions:
    """What ``flightstack sitl`` was asked for."""

    scenario: str
    seed: int = 0
    filter: FilterKind | None = None
    lockstep: bool = False
    duration_s: float | None = None
    out: Path | None = None
    live: bool = True
    signing_key: Path | None = None
    listen: tuple[str, ...] = ()  # where others may watch, besides a free port of loopback
    zenoh_config: Path | None = None  # of the onboard process
    ros2: Ros2Network | None = None  # where target and flight are shown to ROS 2
    personality: str = PX4.name  # of the simulated vehicle
    autopilot: str = AUTO  # of the onboard process


@dataclass(frozen=True)
class Run:
    """What a run left behind."""

    scenario: Scenario
    folder: Path
    log: Path
    wall_s: float  # from the first tick to the end
    interrupted: bool
    problem: str | None  # a process that failed


def onboard_of(scenario: str) -> FlightConfig:
    """The onboard process's part of a scenario, by name or file.

    Raises:
        ConfigError: there is none, or it is wrong.
    """
    return load_scenario(scenario).onboard


def prepare(options: RunOptions) -> Scenario:
    """Load and check the scenario.

    Raises:
        ConfigError: it must not fly.
    """
    scenario = load_scenario(options.scenario)
    if options.filter is not None:
        scenario = scenario.with_filter(options.filter)
    if PERSONALITIES[options.personality].needs_origin and scenario.onboard.vehicle.origin_wgs84 is None:
        there = replace(scenario.onboard.vehicle, origin_wgs84=ORIGIN_WGS84)
        scenario = replace(scenario, onboard=replace(scenario.onboard, vehicle=there))
    if options.duration_s is not None:
        if options.duration_s <= 0.0:
            raise ConfigError(
                f"--duration: found {options.duration_s:g}, a positive number of seconds is needed"
            )
        scenario = replace(scenario, duration_max_s=options.duration_s)
    found = problems(scenario.onboard)
    if found:
        raise ConfigError(f"{options.scenario}: refused before take-off: " + "; ".join(found))
    return scenario


def run(options: RunOptions, console: Console) -> Run:
    """Fly one scenario with processes of its own.

    Raises:
        ConfigError: wrong input.
        LaunchError: a process did not start.
    """
    scenario = prepare(options)
    folder = options.out or _new_folder(scenario, options)
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "flight.mcap"
    if log.exists():
        raise ConfigError(f"--out: {log} exists and is not written over; give another folder")
    scenario_file, config_file = folder / "scenario.toml", folder / "onboard.toml"
    scenario_file.write_text(dumps(to_table(scenario)))
    config_file.write_text(dumps(to_table(scenario.onboard)))
    sockets = Path(
        tempfile.mkdtemp(prefix="flightstack-")
    )  # a short path: socket names are limited to 107 bytes
    launcher = _Launcher(options, scenario, folder, log, sockets / "recorder")
    try:
        return launcher.run(scenario_file, config_file, console)
    finally:
        launcher.end_all()
        shutil.rmtree(sockets, ignore_errors=True)


def _new_folder(scenario: Scenario, options: RunOptions) -> Path:
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    base = f"{stamp}-{scenario.name}-seed{options.seed}-{scenario.onboard.filter.value}"
    for number in range(1000):
        folder = Path("runs") / (f"{base}-{number}" if number else base)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise ConfigError(f"runs/{base}: a thousand runs of this second exist already; give --out")


class _Launcher:
    """Holds the children, so that they are ended whatever happens."""

    def __init__(
        self, options: RunOptions, scenario: Scenario, folder: Path, log: Path, socket_path: Path
    ) -> None:
        self.options, self.scenario, self.folder, self.log = options, scenario, folder, log
        self.socket = socket_path
        self.children: list[Child] = []
        self.ports: list[Port] = []
        self.interrupted = False
        self.aborted = False  # the onboard process has given up and left the vehicle to its autopilot

    @property
    def longest_s(self) -> float:
        """Longest that it may take: until the time is over, and then to abort."""
        return self.scenario.duration_max_s + self.scenario.onboard.retreat.abort_time_max_s

    def run(self, scenario_file: Path, config_file: Path, console: Console) -> Run:
        """Start everybody after those he connects to; then watch until the flight ends."""
        previous = {n: signal.signal(n, self._interrupt) for n in (signal.SIGINT, signal.SIGTERM)}
        previous[signal.SIGQUIT] = signal.signal(signal.SIGQUIT, self._emergency)
        try:
            lockstep = ["--lockstep"] if self.options.lockstep else []
            duration_s = self.scenario.duration_max_s
            rate_hz = self.scenario.onboard.loop.rate_hz
            self.ports = [Port(), Port()]
            target_at, onboard_at = (port.endpoint for port in self.ports)
            recorder = self._start("record", "--socket", str(self.socket), "--out", str(self.log))
            recorder.wait_ready()
            self._describe(scenario_file)
            common = ["--scenario", str(scenario_file), "--seed", str(self.options.seed)]
            others_s = self.longest_s + 10.0
            common += ["--rate", str(rate_hz), "--duration", str(others_s), *lockstep]
            feed = ["--recorder", str(self.socket)]
            key = self.options.signing_key
            wire = ["--signing-key", str(key)] if key is not None else []
            ros2, zenoh_config = self.options.ros2, self.options.zenoh_config
            shown = ["--ros2", ros2.where, "--ros-domain", str(ros2.domain)] if ros2 is not None else []
            zenoh = ["--zenoh-config", str(zenoh_config)] if zenoh_config is not None else []
            vehicle = self._start(
                "vehicle", *common, *feed, *wire, "--connect", target_at, "--url", "udpin:127.0.0.1:0",
                "--personality", self.options.personality, *_parameters(self.options.personality),
            )  # fmt: skip
            target = self._start(
                "target", *common, *feed, *shown, "--listen", target_at, "--connect", onboard_at
            )
            url = vehicle.wait_ready().replace("udpin", "udpout")
            onboard = self._start(
                "onboard", "--vehicle", url, "--target", f"{NAMESPACE}/target/odom", "--connect", target_at,
                "--listen", onboard_at, "--config", str(config_file), "--duration", str(duration_s),
                *(word for endpoint in self.options.listen for word in ("--listen", endpoint)),
                *feed, *lockstep, *wire, *shown, *zenoh, "--autopilot", _autopilot(self.options),
            )  # fmt: skip
            target.wait_ready()
            onboard.wait_ready()
            if not self.options.lockstep:
                recorder.yield_to_others(10)
                target.yield_to_others(5)
            for endpoint in (onboard_at, *self.options.listen):
                console.print(
                    f"to watch: flightstack watch --connect {endpoint}", style="dim", soft_wrap=True
                )
            started = time.monotonic()
            problem = self._watch(onboard, [vehicle, target, recorder], onboard_at, console)
            wall_s = time.monotonic() - started
            self.end_all()
            if problem is None and recorder.process.returncode != 0:  # it may be behind the flight
                problem = f"record did not end in order: {recorder.errors() or 'no reason given'}"
            return Run(self.scenario, self.folder, self.log, wall_s, self.interrupted, problem)
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)

    def end_all(self) -> None:
        """End every child, the recorder last, so that it closes the log behind the others."""
        for child in reversed(self.children):
            child.end(CLOSE_TIME_MAX_S if child.name == "record" else END_TIME_MAX_S)
        self.children.clear()
        for port in self.ports:
            port.close()

    def _start(self, verb: str, *arguments: str) -> Child:
        child = Child(verb, [verb, *arguments], self.folder)
        self.children.append(child)
        return child

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.interrupted = True

    def _emergency(self, number: int, frame: FrameType | None) -> None:
        """An emergency stop is the onboard process's to give."""
        del frame
        for child in self.children:
            if child.name == "onboard" and child.alive():
                child.process.send_signal(number)

    def _watch(self, onboard: Child, others: list[Child], onboard_at: str, console: Console) -> str | None:
        limit_s = self.longest_s / (LOCKSTEP_SLOWEST if self.options.lockstep else 1.0)
        until = time.monotonic() + limit_s + GRACE_S
        view = session = None
        problem: str | None = None
        if self.options.live and console.is_terminal and not self.options.lockstep:
            session = zenoh_link.open_session([], [onboard_at])
            title = (
                f"{self.scenario.name}  seed {self.options.seed}  filter {self.scenario.onboard.filter.value}"
            )
            view = LiveView(session, NAMESPACE, title, console)
            view.live.start()
        try:
            while onboard.alive():
                self._say(onboard.lines(1.0 / REFRESH_HZ), console)
                if view is not None:
                    view.poll()
                for child in [c for c in others if not c.alive()]:
                    # nobody else needs it to end safely: the onboard process holds, climbs or lands away
                    others.remove(child)
                    problem = f"{child.name} ended in flight: {child.errors() or 'no reason given'}"
                    console.print(problem, style="red", markup=False)
                if self.interrupted:
                    return "interrupted"
                if time.monotonic() > until:
                    return f"not over after {limit_s + GRACE_S:.0f} s"
            self._say(onboard.lines(0.0), console)
        finally:
            if view is not None:
                view.live.stop()
            if session is not None:
                session.close()
        if onboard.process.returncode not in (0, 1):
            problem = f"onboard ended in flight: {onboard.errors() or 'no reason given'}"
            self.aborted = True
        if self.aborted:
            self._let_it_land(others, until)
        return problem

    def _say(self, lines: list[str], console: Console) -> None:
        for line in lines:
            self.aborted = self.aborted or "-> ABORT" in line
            if self.options.live:
                console.print(line, highlight=False, markup=False)

    def _let_it_land(self, others: list[Child], until: float) -> None:
        """Without the onboard process the vehicle lands by itself: wait until it says so.

        What it has said so far has not been read: one that never armed, or stands already, is known at once.
        """
        vehicle = next((c for c in others if c.name == "vehicle"), None)
        until, armed = min(until, time.monotonic() + LAND_ALONE_MAX_S), False
        while vehicle is not None and vehicle.alive() and not self.interrupted and time.monotonic() < until:
            said = [line for line in vehicle.lines(0.2) if line in ("armed", "disarmed")]
            armed = said[-1] == "armed" if said else armed
            if not armed:
                return

    def _describe(self, scenario_file: Path) -> None:
        """Write into the log what is needed to read it and to fly it again; onboard writes its own part."""
        shape = self.scenario.onboard.barrier.build()
        limits = self.scenario.onboard.limits.velocity_max_m_s
        feed = Feed.connect(str(self.socket), "launcher", lossless=True)
        feed.metadata(
            "run",
            {
                "scenario": self.scenario.name,
                "description": self.scenario.description,
                "seed": str(self.options.seed),
                "filter": self.scenario.onboard.filter.value,
                "mode": "lockstep" if self.options.lockstep else "real-time",
                "rate_hz": str(self.scenario.onboard.loop.rate_hz),
                "barrier_alpha_1_m": repr(shape.alpha_1_m),
                "barrier_beta_m": repr(shape.beta_m),
                "judge_alpha_1_m": repr(self.scenario.judge.alpha_1_m),
                "judge_beta_m": repr(self.scenario.judge.beta_m),
                "velocity_max_x_m_s": repr(limits[0]),
                "velocity_max_y_m_s": repr(limits[1]),
                "velocity_max_z_m_s": repr(limits[2]),
                "pad_radius_m": repr(self.scenario.target.pad_radius_m),
            },
        )
        feed.metadata(
            "made",
            {
                "started": datetime.now(UTC).isoformat(timespec="seconds"),
                "host_system": platform.platform(),
                "python": platform.python_version(),
                "version": metadata.version("crazyflie-flightstack"),
                "git_revision": _revision(),
                **{
                    f"package_{p}": metadata.version(p)
                    for p in ("pymavlink", "osqp", "eclipse-zenoh", "mcap")
                },
            },
        )
        feed.attachment("scenario.toml", "application/toml", scenario_file.read_bytes())
        feed.attachment(
            "scenario_source.toml", "application/toml", path_of(self.options.scenario).read_bytes()
        )
        feed.flush()
        feed.close()


def _autopilot(options: RunOptions) -> str:
    """Profile of the onboard process: a heartbeat does not tell our own vehicle from what it plays."""
    own = options.autopilot == AUTO and options.personality == PX4.name
    return OWN_SITL.name if own else options.autopilot


def _parameters(personality: str) -> list[str]:
    values = PERSONALITIES[personality].set_before_flight
    return [word for name, value in values.items() for word in ("--parameter", f"{name}={value:g}")]


def _revision() -> str:
    """Git revision of the code, "-dirty" with changes; empty where it is not a checkout."""
    try:
        result = subprocess.run(
            ["git", "describe", "--always", "--dirty"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            timeout=5.0,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return result.stdout.strip()


def result_json(
    run_: Run, options: RunOptions, verdict: dict[str, object], simulated_s: float, report: Path
) -> str:
    """The one object that ``--json`` prints."""
    factor = simulated_s / run_.wall_s if run_.wall_s > 0.0 else None
    return json.dumps(
        {
            "scenario": run_.scenario.name,
            "seed": options.seed,
            "filter": run_.scenario.onboard.filter.value,
            **verdict,
            "realtime_factor": factor,
            "log": str(run_.log),
            "report": str(report),
        }
    )
