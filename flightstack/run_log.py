"""What a log says of the run that made it: what was flown, by which code, on which machine."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from flightstack.config import FlightConfig
from logs.feed import Feed

_PACKAGES = ("pymavlink", "osqp", "eclipse-zenoh", "mcap")


def describe(
    recorder: Path, config: FlightConfig, run: Mapping[str, str], attachments: Mapping[str, bytes]
) -> None:
    """Write into the log what is needed to read it and to fly it again; onboard writes its own part.

    Args:
        recorder: socket of the recorder.
        config: of the onboard process.
        run: what else is known of the run; its entries take the place of those made here.
        attachments: files (TOML) by name.

    Raises:
        FeedError: there is no recorder.
    """
    shape, limits = config.barrier.build(), config.limits.velocity_max_m_s
    feed = Feed.connect(str(recorder), "launcher", lossless=True)
    told = {
        "filter": config.filter.value,
        "mode": "real-time",
        "rate_hz": str(config.loop.rate_hz),
        "barrier_alpha_1_m": repr(shape.alpha_1_m),
        "barrier_beta_m": repr(shape.beta_m),
        "velocity_max_x_m_s": repr(limits[0]),
        "velocity_max_y_m_s": repr(limits[1]),
        "velocity_max_z_m_s": repr(limits[2]),
        "pad_radius_m": repr(config.touchdown.pad_radius_m),
    }
    feed.metadata("run", {**told, **run})
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
