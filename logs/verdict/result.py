"""The verdict on a log as one dictionary: the keys of ``flightstack sitl --json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from logs.reader.flight_data import Flight
from logs.verdict.types import Verdict


def verdict_result(flight: Flight, verdict: Verdict, report: Path | None = None) -> dict[str, Any]:
    """Return plain values, ready for JSON; what a log does not tell is ``None``.

    Args:
        flight: the log; a real flight's names neither scenario nor seed.
        verdict: on it.
        report: its page, if one was written.
    """
    run = flight.metadata.get("run", {})
    seed = run.get("seed", "")
    flown_by = flight.config.filter if flight.config is not None else None
    return {
        "scenario": run.get("scenario"),
        "seed": int(seed) if seed.isdigit() else None,
        "filter": run.get("filter", flown_by),
        **verdict.to_json_dict(),
        "realtime_factor": None,  # measured by who started the processes
        "log": str(flight.path),
        "report": str(report) if report is not None else None,
    }
