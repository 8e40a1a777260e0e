"""Tables of all numbers of the simulated vehicle, from crazyflie20.toml and the firmware's constants."""

from __future__ import annotations

import ast
import importlib
import re
from importlib import resources
from pathlib import Path

from flightstack.compiled.records import layout, new
from sim.firmware.pid import CascadeRecord, PidLoop, PidRecord
from sim.plant.params import load

UNITS = {  # suffixes of the parameters' names
    "n_m_rpm": "N m/rpm", "n_m_rpm2": "N m/rpm²", "n_rpm2": "N/rpm²", "n_rpm": "N/rpm",
    "1_rpm_s": "1/(rpm s)", "kg_m2": "kg m²", "n_s_m": "N s/m", "rad_s_sqrthz": "rad/s/√Hz",
    "m_s2_sqrthz": "m/s²/√Hz", "rpm": "rpm", "v_rpm": "rpm", "volt_rpm": "rpm/V", "rad_s": "rad/s",
    "m_s2": "m/s²", "a_s": "A s", "1_s": "1/s", "kg": "kg", "hz": "Hz", "ohm": "Ω", "m": "m", "n": "N",
    "s": "s", "v": "V", "a": "A",
}  # fmt: skip
MODULES = (
    "sim.plant.params", "sim.plant.ground_effect", "sim.plant.rotors",
    "sim.firmware.paper_loop",
    "sim.firmware.mellinger", "sim.firmware.pid", "sim.firmware.mixer", "sim.firmware.estimator",
    "sim.firmware.supervisor", "sim.firmware.stack", "sim.robot.target", "sim.world.rest",
)  # fmt: skip
PIDS = {
    "x": "position x to velocity [m/s]", "y": "position y to velocity", "z": "position z to velocity",
    "vx": "velocity x to tilt [deg]", "vy": "velocity y to tilt [deg]", "vz": "velocity z to 1000 counts",
    "roll": "roll [deg] to rate [deg/s]", "pitch": "pitch", "yaw": "yaw", "roll_rate": "roll rate to counts",
    "pitch_rate": "pitch rate", "yaw_rate": "yaw rate",
}  # fmt: skip


def unit_of(key: str) -> str:
    """Return the unit in a parameter's suffix; empty for a number without unit."""
    return next((UNITS[u] for u in sorted(UNITS, key=len, reverse=True) if key.endswith("_" + u)), "")


def parameter_table() -> str:
    """Return the table of crazyflie20.toml."""
    lines = ["| group | parameter | value | unit | source and meaning |", "|---|---|---|---|---|"]
    group = whole = ""
    for line in (resources.files("sim.vehicles") / "crazyflie20.toml").read_text().splitlines():
        if match := re.match(r"\[(\w+)\]\s*(?:# (.*))?$", line):
            group, whole = match[1], match[2] or ""
        elif match := re.match(r"(\w+) = ([^#]+?)\s*(?:# (.*))?$", line):
            lines.append(
                f"| {group} | `{match[1]}` | {match[2]} | {unit_of(match[1])} | {match[3] or whole} |"
            )
    return "\n".join(lines)


def constant_table() -> str:
    """Return the table of constants of firmware and plant in the code, without counters and flags."""
    lines = ["| module | constant | value | unit, meaning or source |", "|---|---|---|---|"]
    for name in MODULES:
        module = importlib.import_module(name)
        source = Path(str(module.__file__)).read_text()
        text = source.splitlines()
        for node in ast.parse(source).body:
            if not isinstance(node, ast.Assign):
                continue
            _, _, comment = text[node.end_lineno - 1].partition("  # ")
            names = [n.id for n in ast.walk(node.targets[0]) if isinstance(n, ast.Name)]
            values = [getattr(module, n) for n in names]
            number = all(type(v) in (int, float) for v in values)
            if number and (comment or any(isinstance(v, float) for v in values)):
                shown = ", ".join(f"{v:.6g}" for v in values)
                lines.append(f"| `{name}` | `{', '.join(names)}` | {shown} | {comment} |")
    return "\n".join(lines)


def pid_table() -> str:
    """Return the table of the gains of the simulated PID cascade."""
    record = PidLoop(load(), new(CascadeRecord)).record
    lines = ["| PID | kp | ki | kd | integral limit | output limit | rate |", "|---|---|---|---|---|---|---|"]
    assert layout(PidRecord).names[:6] == ("kp", "ki", "kd", "i_limit", "dt", "limit")
    for name, what in PIDS.items():
        kp, ki, kd, i_limit, dt, limit, *_ = record[name].tolist()
        most = f"{limit:g}" if limit < 1e9 else "none"
        lines.append(f"| {what} | {kp:g} | {ki:g} | {kd:g} | {i_limit:g} | {most} | {1.0 / dt:.0f} Hz |")
    return "\n".join(lines)
