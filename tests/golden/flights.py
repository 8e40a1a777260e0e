"""Flights of the golden logs: their purpose, the function that flies them again, and the stored topics."""

import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from mcap.writer import CompressionType, Writer

from flightstack.common.strict_toml import dumps, parse_toml
from logs.reader.reader import ROSOUT, LogFile
from logs.schema import FLEET
from logs.schema.schemas import schema_text
from sim.scenarios.scenario import load, text

TOPICS = (
    "controller/input", "controller/step", "controller/state", "controller/power", "controller/neighbours",
    "target/odom",
)  # fmt: skip
WIRE = ("mavlink_source", "mavlink_sink")
CHUNK_BYTES = 16 * 2**20  # chunk size; a whole flight fits into one chunk, which compresses better
METADATA = ("onboard", "run")


def write_kept(
    source: Path, target: Path, *, member: str | None = None, wire: bool = True, when=None, change=None
) -> Path:
    """Copy the topics of a log that a replay needs.

    Args:
        source: a complete or broken log.
        target: file to write.
        member: vehicle whose flight is kept; None: the log has one flight.
        wire: also keep MAVLink frames and odometry.
        when: condition for keeping a message; None: all.
        change: function that returns the new data of a message; None: unchanged.
    """
    log = LogFile(source, member).single()
    names = log.names
    space = names.member
    topics = {f"/{space}/{name}" for name in TOPICS if wire or name != "target/odom"}
    topics |= {ROSOUT, *(map(names.frames, WIRE) if wire else ())}
    with target.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start("ros2", "crazyflie-flightstack, kept for replay")
        for each in log.attachments():
            if each.name == "onboard.toml":
                writer.add_attachment(0, 0, names.record(each.name), each.media_type, each.data)
        writer.add_metadata(FLEET, {"members": space})
        for name in METADATA:
            values = dict(log.metadata().get(name, {}))
            if name == "onboard" and not wire:
                values.pop("lockstep", None)  # without frames, the MAVLink data cannot be replayed
            writer.add_metadata(names.record(name), values)
        channels: dict[str, int] = {}
        for message in log.messages(topics):
            if when is not None and not when(message):
                continue
            if message.topic not in channels:
                schema = writer.register_schema(
                    message.schema, "ros2msg", schema_text(message.schema).encode()
                )
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            data = message.data if change is None else change(message)
            writer.add_message(
                channels[message.topic], message.log_time_ns, data, message.publish_time_ns, message.sequence
            )
        writer.finish()
    return target


FOLDER = Path(__file__).parent
BYTES_MAX = 450_000  # maximum size of one log, because the repository stores it
FLIGHT_MAX_S = 300.0  # time-out of a flight, wall time, s


@dataclass(frozen=True)
class Flight:
    """A golden flight: a scenario with changed keys."""

    scenario: str  # name of the flown scenario
    phases: tuple[str, ...]  # phases that the flight must contain
    # changed scenario keys with their values, for example a slower loop for a smaller log
    changes: dict[str, object] = field(default_factory=dict)
    lockstep: bool = True  # whether the flight runs in lockstep; False: in real time, with varying times
    wire: bool = True  # whether MAVLink frames and odometry are stored, which doubles the size
    seed: int = 0  # seed of all random draws
    member: str | None = None  # member of a team whose flight is stored


_SLOW = {"onboard.loop.rate_hz": 40, "odometry.rate_hz": 40.0}
_SLOWER = {"onboard.loop.rate_hz": 25, "odometry.rate_hz": 25.0}  # lower rates make the log smaller
_SLOWEST = {"onboard.loop.rate_hz": 15, "odometry.rate_hz": 15.0}
_LOSSES = {"odometry.dropout_every_s": 2.5, "odometry.dropout_max_s": 4.0, "duration_max_s": 11.0}
FLIGHTS = {
    "paper_static_1": Flight("paper_static_1", ("TAKEOFF", "LANDED"), _SLOW, wire=False),
    "paper_moving_1": Flight("paper_moving_1", ("TAKEOFF", "LANDED"), _SLOW, wire=False),
    "contact": Flight("straight", ("APPROACH", "TOUCHDOWN", "LANDED"), _SLOW),
    "target_lost": Flight("straight", ("APPROACH", "HOLD", "CLIMB"), {**_SLOW, **_LOSSES}),
    "real_time": Flight("straight", ("APPROACH", "LANDED"), _SLOWER, lockstep=False),
    "fleet_3_cf1": Flight("fleet_3", ("APPROACH", "LANDED"), _SLOW, wire=False, member="cf1"),
    "fleet_3_cf3": Flight("fleet_3", ("APPROACH", "LANDED"), _SLOW, wire=False, member="cf3"),
    "turns_4_cf2": Flight("turns_4", ("LANDED", "LEAVE"), _SLOWEST, wire=False, member="cf2"),
}  # fmt: skip


def path_of(name: str) -> Path:
    return FOLDER / f"{name}.mcap"


def fly(flight: Flight, target: Path) -> None:
    """Fly the scenario, and write the golden log to ``target``."""
    table = parse_toml(text(load(flight.scenario)).encode())
    for each in table.get("member", [table]):
        _change(each, flight.changes)
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
        write_kept(log, target, member=flight.member, wire=flight.wire)


def _change(table: dict[str, object], changes: dict[str, object]) -> None:
    for key, value in changes.items():
        *sections, last = key.split(".")
        inner = table
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = value
