"""Summarises the content of a log in one pass, with bounded memory."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from flightstack.common.text import one_line
from logs.reader.reader import LogFile

_NS = 1e9  # nanoseconds per second


def gather(log: LogFile) -> dict[str, Any]:
    """Return the object that ``log info --json`` prints; times in seconds and as text.

    ``problem``: unreadable part, empty for a complete log; ``readable_bytes``: from the start to the first
    damage, the size of a complete file; ``start_ns``, ``end_ns``: log times of the messages, Unix.
    """
    # by (topic, schema): number of messages, first and last log time, ns
    found: dict[tuple[str, str], tuple[int, int, int]] = {}
    for message in log.messages():
        key, now_ns = (message.topic, message.schema), message.log_time_ns
        number, first_ns, last_ns = found.get(key, (0, now_ns, now_ns))
        found[key] = number + 1, min(first_ns, now_ns), max(last_ns, now_ns)
    outline = log.outline
    start_ns = min((first_ns for _, first_ns, _ in found.values()), default=0)
    end_ns = max((last_ns for *_, last_ns in found.values()), default=0)
    return {
        "path": str(log.path),
        "size_bytes": log.path.stat().st_size,
        "complete": log.complete,
        "problem": outline.problem,
        "readable_bytes": outline.broken_at,
        "profile": outline.profile,
        "library": outline.library,
        "start_ns": start_ns,
        "end_ns": end_ns,
        "messages": sum(number for number, *_ in found.values()),
        "topics": [
            {"topic": topic, "schema": schema, "messages": number, "rate_hz": _rate_hz(number, last - first)}
            for (topic, schema), (number, first, last) in sorted(found.items())
        ],
        "metadata": log.metadata(),
        "attachments": [
            {"name": a.name, "media_type": a.media_type, "bytes": len(a.data)} for a in log.attachments()
        ],
        "start": _utc(start_ns),
        "end": _utc(end_ns),
        "duration_s": (end_ns - start_ns) / _NS,
    }


def _rate_hz(number: int, span_ns: int) -> float | None:
    """Return the mean rate between two messages; None: fewer than two, or no time between them."""
    return (number - 1) * _NS / span_ns if span_ns > 0 else None


def lines(info: dict[str, Any]) -> list[str]:
    last = f"last message {info['duration_s']:.3f} s after the first"
    found = [
        f"{one_line(info['path'])}: {info['size_bytes']} bytes, profile {info['profile']!r}, by "
        f"{info['library']!r}",
        f"{info['messages']} messages in {info['duration_s']:.3f} s, {info['start']} to {info['end']} "
        "(log time)",
        "complete" if info["complete"] else f"BROKEN: {info['problem']}; {last}",
        "",
        f"{'topic':32} {'schema':40} {'messages':>9} {'rate':>9}",
    ]
    for t in info["topics"]:
        rate = "" if t["rate_hz"] is None else f"{t['rate_hz']:.1f} Hz"
        found.append(f"{one_line(t['topic']):32} {one_line(t['schema']):40} {t['messages']:9} {rate:>9}")
    for name, values in info["metadata"].items():
        found += ["", f"metadata {one_line(name)}"]
        found += [f"  {one_line(key)} = {one_line(value)}" for key, value in values.items()]
    if info["attachments"]:
        found += ["", "attachments"]
        for each in info["attachments"]:
            found.append(one_line(f"  {each['name']}  {each['media_type']}  {each['bytes']} bytes"))
    return found


def _utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
