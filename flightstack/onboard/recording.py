"""Folder of a flight, its recorder, and the log's metadata about scenario, code and machine."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib import metadata
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from flightstack.common.processes import CLOSE_TIME_MAX_S, Child, socket_folder
from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import own_boundary
from logs.recorder.feed import Feed
from logs.schema import FLEET, Names

LOG = "flight.mcap"
_PACKAGES = ("pymavlink", "osqp", "eclipse-zenoh", "mcap")
_NO_NAME = re.compile(r"[^\w.=+@-]|\.\.")  # characters that folder names in printed commands must not have


def new_folder(name: str) -> Path:
    """Create a folder in ``runs`` for the files of a flight; separators and control characters become "_"."""
    base = f"{datetime.now().strftime('%Y%m%d-%H%M%S')}-{_NO_NAME.sub('_', name)[:100]}"
    for number in count():
        folder = Path("runs") / (f"{base}-{number}" if number else base)
        with suppress(FileExistsError):
            folder.mkdir(parents=True)
            break
    return folder


def log_in(folder: Path) -> Path:
    """Return the path of a new log in a folder; the folder is created if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / LOG
    if log.exists():
        raise ConfigError(f"--out: {log} exists and is not overwritten; give another folder")
    return log


def start_recorder(socket: Path, log: Path) -> Child:
    """Start a recorder and wait until it listens; it writes its errors to a file beside the log."""
    recorder = Child("record", ["record", "--socket", str(socket), "--out", str(log)], log.parent)
    recorder.wait_ready()
    return recorder


def end_recorder(recorder: Child) -> str | None:
    """End a recorder after its clients, in bounded time; return the problem if the log is incomplete."""
    if recorder.end(CLOSE_TIME_MAX_S) == 0:
        return None
    return f"record did not end in order: {recorder.errors()}"


@contextmanager
def own_recorder(flight: Described) -> Iterator[tuple[Path, Path]]:
    """Record a log in a new folder of ``runs``; yield socket and log, and warn of an incomplete log."""
    sockets, recorder = socket_folder(), None
    try:
        socket, log = sockets / "recorder", log_in(new_folder("onboard"))
        recorder = start_recorder(socket, log)
        recorder.yield_to_others(10)
        describe(socket, flight)
        yield socket, log
    finally:
        if recorder is not None and (problem := end_recorder(recorder)):
            print(f"onboard: WARNING: {problem}", file=sys.stderr)
        shutil.rmtree(sockets, ignore_errors=True)


class Described(NamedTuple):
    """Description of a flight; it is written to the log before the flight starts."""

    config: FlightConfig  # configuration of the onboard process
    run: Mapping[str, str]  # metadata of the run; they replace default entries of the same name
    names: Names  # namespace and MAVLink system id of the vehicle; both form the names of the log's channels


def describe(
    recorder: Path,
    *flights: Described,
    fleet: Mapping[str, str] = MappingProxyType({}),
    attachments: Mapping[str, bytes] = MappingProxyType({}),
) -> None:
    """Write the metadata for reading and replaying the log, except those that the onboard process writes.

    ``fleet``: metadata of all flights; ``attachments``: TOML files by name.
    """
    feed = Feed.connect(str(recorder), "launcher", lossless=True)
    feed.metadata(FLEET, {"members": ",".join(flight.names.member for flight in flights), **fleet})
    for config, run, names in flights:
        own = {"own_boundary": boundary} if (boundary := own_boundary(config.filter)) else {}
        about = {"filter": config.filter, "mode": "real-time", "rate_hz": str(config.loop.rate_hz)}
        feed.metadata(names.record("run"), {**about, **own, **run})
    feed.metadata(
        "made",
        {
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "host_system": platform.platform(),
            "python": platform.python_version(),
            "version": metadata.version("crazyflie-flightstack"),
            "git_revision": _revision(),
            **{f"package_{p}": metadata.version(p) for p in _PACKAGES},
        },
    )
    for name, data in attachments.items():
        feed.attachment(name, "application/toml", data)
    feed.flush()
    feed.close()


def _revision() -> str:
    """Return the code's git revision, with "-dirty" after local changes; empty without a git checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        return subprocess.check_output(command, stderr=subprocess.DEVNULL, text=True, timeout=5.0).strip()
    except (OSError, subprocess.SubprocessError):
        return ""
