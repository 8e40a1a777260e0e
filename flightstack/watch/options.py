"""Options of ``watch``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from flightstack.common.options import Option
from flightstack.config import options as shared

DEFAULT = "tcp/127.0.0.1:7448"  # endpoint of the onboard process in README and docs


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Where a flight is watched, and how it is shown."""

    connect: Annotated[tuple[str, ...], Option(
        "--connect",
        "Zenoh endpoint of the onboard process, as `sitl` prints it; repeatable; default: "
        f"{DEFAULT}, or the endpoint of --zenoh-config.", "ENDPOINT"
    )] = ()  # fmt: skip
    zenoh_config: shared.ZenohConfig = None
    namespace: shared.Namespace = "cf1"
    once: Annotated[
        bool, Option("--once", "Show the state once and end; exit status 1 if no fresh data come.")
    ] = False
    as_json: Annotated[bool, shared.json("Print one JSON object a line, two a second (--once: one).")] = False
    timeout_s: Annotated[float, shared.seconds("--timeout", "Longest wait of --once.", 0.1, 3600.0)] = 5.0
    view: shared.View = None
    config_file: Annotated[
        Path | None, shared.config("Configuration of the flight, for the barrier and the pad in --view")
    ] = None
