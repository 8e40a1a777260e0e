"""One flight of ``fly``: starts recorder, onboard process and live view; vehicle and target run already."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from flightstack.common.strict_toml import dumps
from flightstack.core.parameters.flight import FlightConfig
from flightstack.launch.launcher import NAMESPACE, Followed, Launcher, Shown
from flightstack.launch.result import Flown
from flightstack.onboard.recording import describe, end_recorder, log_in, new_folder


@dataclass(frozen=True)
class FlyOptions:
    """The options of ``flightstack fly``.

    Attributes:
        name: of the configuration.
        vehicle_url: MAVLink URL.
        target_key: key or topic of its motion.
        words: options of ``flightstack onboard``, but for its configuration and recorder.
        record: whether the flight is recorded.
        out: folder; None: a new one in ``runs``.
        live: whether the terminal shows the flight.
        listen: Zenoh endpoints where others may watch, besides a free port of loopback.
        namespace: first part of the Zenoh keys.
        view: where the scene is shown in 3-D; None: nowhere.
    """

    name: str
    vehicle_url: str
    target_key: str
    words: Sequence[str]
    record: bool = True
    out: Path | None = None
    live: bool = True
    listen: tuple[str, ...] = ()
    namespace: str = NAMESPACE
    view: str | None = None


def run(config: FlightConfig, options: FlyOptions, console: Console) -> Flown:
    """Fly until the onboard process has ended; the recorder starts first and ends last.

    Raises:
        ConfigError: wrong input.
        LaunchError: a process did not start.
    """
    folder = options.out or new_folder(f"fly-{options.name}")
    log = log_in(folder) if options.record else None
    folder.mkdir(parents=True, exist_ok=True)
    config_file = folder / "onboard.toml"
    config_file.write_text(dumps(config))
    with Launcher(folder, console, tells=options.live, real=True) as launcher:
        recorder = None
        if log is not None:
            recorder = launcher.record(log)
            recorder.yield_to_others(10)
            known = {"config": options.name, "vehicle": options.vehicle_url, "target": options.target_key}
            describe(launcher.socket, config, known, {})
        at = launcher.endpoint()
        if options.view is not None:
            launcher.view(options.view, at, config_file, options.namespace)
        onboard = launcher.start(
            "onboard", *options.words, config=config_file, listen=at,
            recorder=launcher.socket if recorder is not None else None, no_record=recorder is None,
        )  # fmt: skip
        onboard.wait_ready()
        for endpoint in (at, *options.listen):
            console.print(f"to watch: flightstack watch --connect {endpoint}", style="dim", soft_wrap=True)
        title = f"{options.name}  {options.vehicle_url}  filter {config.filter}"
        shown = Shown([at], title, [options.namespace]) if options.live and console.is_terminal else None
        started, flight = time.monotonic(), Followed(onboard)
        problem = launcher.watch([flight], [recorder] if recorder is not None else [], None, shown)
        wall_s = time.monotonic() - started
        if recorder is not None:
            problem = end_recorder(recorder) or problem
    about = {"scenario": None, "seed": None, "config": options.name, "filter": config.filter}
    return Flown(about, folder, log, wall_s, onboard.process.returncode, flight.last_line, problem)
