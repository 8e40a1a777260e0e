"""Pre-flight check of the vehicle: requirements of the flight, and texts for operator and log."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from bridge.mavlink.line_budget import LineTooSlowError, plan
from bridge.mavlink.preflight.examine import Examination, Report
from bridge.mavlink.preflight.table import Level, Needs
from bridge.mavlink.profiles import OWN_SITL
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import strategy_of
from flightstack.core.target.reserve import too_low

_SHOWN = (Level.UNSAFE, Level.ACCEPTED, Level.NOTE, Level.INFO)


def needs_of(config: FlightConfig, system_id: int = 1) -> Needs:
    """Return what the flight with this configuration requires from the autopilot."""
    vx, vy, vz = config.limits.velocity_max_m_s
    ax, ay, az = strategy_of(config).acceleration_max_m_s2
    return Needs(math.hypot(vx, vy), vz, math.hypot(ax, ay), az, config.limits.altitude_max_m, system_id)


def check(
    vehicle: Examination, config: FlightConfig, *, wait_s: float, accept_release: bool = False
) -> Report:
    """Request the vehicle's parameters and check them; ``wait_s``: time-out for the first heartbeat."""
    endpoint = vehicle.endpoint
    try:
        rate_hz, age_max_s = config.loop.rate_hz, config.checks.own_age_max_s
        line = plan(endpoint.baud, rate_hz, age_max_s, signed=endpoint.signed)
    except LineTooSlowError as error:
        return Report(None, None, (), str(error))
    needs, accepted = needs_of(config, vehicle.target[0]), config.vehicle.accepted_parameters
    report = vehicle.report(needs, accepted, wait_s=wait_s, accept_release=accept_release)
    table = config.reserve  # without a voltage there is no check; the controller waits for a voltage
    if table is not None and report.rest_v is not None and report.problem is None:
        report = replace(report, problem=too_low(table, report.rest_v) or None)
    if endpoint.baud is None:
        return report
    return replace(report, line=f"serial line, {endpoint.baud} baud: {line.text}")


def lines(report: Report, *, every: bool = False) -> Iterator[str]:
    """Yield the lines of the report for the operator; ``every``: also the parameters that are safe."""
    if report.profile is not None:
        own = "imitates PX4 " if report.profile is OWN_SITL else ""
        version = f", {own}release {report.version or 'unknown'}"
        yield f"preflight: {report.profile.title}{version}"
    if report.line is not None:
        yield f"preflight: {report.line}"
    for note in report.notes:
        yield f"preflight: note: {note}"
    if report.problem is not None and not every:
        yield f"preflight: {report.problem}"
    for level in (*_SHOWN, *([Level.OK] if every else [])):
        for finding in report.findings:
            hidden = level is Level.NOTE and report.profile is OWN_SITL and not every
            if finding.level is level and not hidden:
                yield f"preflight: {level.value}: {finding.text}"


def verdict(report: Report) -> str | None:
    """Return why the vehicle must not arm; None: arming is permitted."""
    if report.problem is not None:
        return report.problem
    names = [finding.name for finding in report.blocking]
    if not names:
        return None
    return (
        f"unsafe parameters of the autopilot: {', '.join(names)}; set them, or accept them by name in "
        "vehicle.accepted_parameters"
    )


def record(report: Report) -> dict[str, str]:
    """Return the findings for the log's metadata."""
    found = {
        f.name: f"{'missing' if f.value is None else repr(f.value)} {f.level.value}" for f in report.findings
    }
    line = {"line": report.line} if report.line is not None else {}
    return {
        "profile": report.profile.name if report.profile is not None else "none",
        "version": report.version or "",
        "rules": report.rules or "",
        "notes": "; ".join(report.notes),
        "problem": report.problem or "",
        **line,
        **found,
    }
