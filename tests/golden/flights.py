"""The flights behind the golden logs: what each is there for, and how it is flown anew."""

import copy
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from flightstack.common.strict_toml import dumps, to_table
from sim.scenarios.scenario import load
from tests.golden.keep import write_kept

FOLDER = Path(__file__).parent
BYTES_MAX = 400_000  # of one log; they live in the repository
FLIGHT_MAX_S = 300.0  # s of wall time


@dataclass(frozen=True)
class Flight:
    """One scenario with changes.

    Attributes:
        scenario: a scenario of the simulator.
        phases: that must be in it, else it is not what it is meant to be.
        changes: keys of the scenario to other values; a slower loop makes a smaller log.
        lockstep: or in real time, with ticks and arrivals where the clock put them.
        wire: keep MAVLink frames and odometry, too; twice as large.
    """

    scenario: str
    phases: tuple[str, ...]
    changes: dict[str, object] = field(default_factory=dict)
    lockstep: bool = True
    wire: bool = True
    seed: int = 0


_SLOW = {"onboard.loop.rate_hz": 40, "odometry.rate_hz": 40.0}
_SLOWER = {"onboard.loop.rate_hz": 25, "odometry.rate_hz": 25.0}  # how long it waits at the start is chance
_LOSSES = {"odometry.dropout_every_s": 2.5, "odometry.dropout_max_s": 4.0, "duration_max_s": 11.0}
FLIGHTS = {
    "paper_static_1": Flight("paper_static_1", ("TAKEOFF", "LANDED"), _SLOW, wire=False),
    "paper_moving_1": Flight("paper_moving_1", ("TAKEOFF", "LANDED"), _SLOW, wire=False),
    "contact": Flight("straight", ("APPROACH", "TOUCHDOWN", "LANDED"), _SLOW),
    "target_lost": Flight("straight", ("APPROACH", "HOLD", "CLIMB"), {**_SLOW, **_LOSSES}),
    "real_time": Flight("straight", ("APPROACH", "LANDED"), _SLOWER, lockstep=False),
}  # fmt: skip


def path_of(name: str) -> Path:
    """Where a golden log is."""
    return FOLDER / f"{name}.mcap"


def fly(flight: Flight, target: Path) -> None:
    """Fly it and keep what a replay needs."""
    table = copy.deepcopy(to_table(load(flight.scenario)))
    for key, value in flight.changes.items():
        *sections, last = key.split(".")
        inner = table
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = value
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.toml"
        file.write_text(dumps(table))
        command = [sys.executable, "-m", "flightstack.cli.main", "sitl", "--scenario", str(file), "--json"]
        command += ["--no-report", "--seed", str(flight.seed), "--out", f"{folder}/run"]
        done = subprocess.run(
            command + ["--lockstep"] * flight.lockstep,
            capture_output=True, text=True, timeout=FLIGHT_MAX_S, check=False,
        )  # fmt: skip
        log = Path(folder) / "run" / "flight.mcap"
        if done.returncode not in (0, 1) or not log.exists():
            raise RuntimeError(f"{flight.scenario} did not fly: {done.stderr}")
        write_kept(log, target, wire=flight.wire)
