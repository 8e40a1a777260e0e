"""Landings on driving pads with the shipped Crazyflie configuration, through bridge and cflib, in real time.

A model of firmware 2026.08 flies the simulated vehicle, with poses of ``bridge crazyflie --mocap``;
``onboard --config crazyflie`` lands it on a robot that drives at up to 0.3 m/s, also before the take-off.
``python -m tests.benchmarks crazyflie_landings [SEED ...] [--in-a-row N] [--faults [WORD ...]]``

``--faults`` flies with one fault each; each flight must end on pad or floor.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bridge.zenoh import zenoh_link
from flightstack import config
from flightstack.common.processes import ended
from sim.chance import stream
from sim.scenarios.scenario import Scenario, load, text
from sim.scenarios.tables import PathKind, Start, StartKind
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.server import Server
from tests.crazyflie_firmware.sim_plant import SimPlant
from tests.crazyflie_firmware.supervisor import State
from tests.integration.runs import COMMAND
from tests.integration.sim_processes import ROOT
from tests.integration.wires.bridge_processes import KEY, Mocap, verb
from tests.processes.ports import free_endpoint

FLIGHT_MAX_S = 120.0
REST_S = 2.5  # time from the end of the flight to the verdict, s
DOWN_MAX_S = 30.0  # longest time from the end of the onboard process to motors off, s
FAULT_AFTER_S, FAULT_ABOVE_M = 3.0, 0.5  # a fault starts this time after the vehicle has reached this height
SPEED_MAX_M_S = 0.3
PATHS = (PathKind.STRAIGHT, PathKind.CIRCLE, PathKind.STOP_AND_GO, PathKind.REVERSING)


@dataclass(frozen=True)
class Landing:
    """Result of one flight, from true states."""

    error_m: float  # horizontal distance from the pad's centre at rest on the pad; NaN if not on it
    place: str  # where the vehicle ended: "pad", "floor" or "air"
    motors_off: bool
    locked: bool
    reason: str  # last line that the onboard process printed
    seconds: float

    @property
    def good(self) -> bool:
        return self.place == "pad" and self.motors_off and not self.locked


def scenario(seed: int) -> Scenario:
    """Return a scenario with the sensors, parameter spreads and gusts of ``lab``.

    The robot starts to drive at time zero.
    """
    lab, chance = load("lab"), stream(seed, "crazyflie_landings")
    target = replace(
        lab.target, path=PATHS[seed % len(PATHS)], speed_m_s=SPEED_MAX_M_S, speed_max_m_s=SPEED_MAX_M_S,
        random_speed=True, random_heading=False, heading_rad=float(chance.uniform(-2.0, 2.0)),
        acceleration_max_m_s2=0.5, turn_rate_rad_s=0.3, wait_for_landing=False,
    )  # fmt: skip
    start = Start(StartKind.GROUND, ground_position_m=(-1.2, 0.3))
    onboard = config.load("crazyflie")
    return replace(
        lab,
        name="crazyflie_landings",
        onboard=onboard,
        target=target,
        start=start,
        duration_max_s=FLIGHT_MAX_S,
    )


class Flying(NamedTuple):
    """Parts of a running flight that a fault can change."""

    server: Server
    mocap: Mocap
    onboard: subprocess.Popen[str]


def fly(
    one: Scenario, seed: int, *options: str, flights: int = 1, loss: float = 0.0, tilt_rad: float = 0.0,
    fault: Callable[[Flying], None] | None = None, **firmware: Any,
) -> list[Landing]:  # fmt: skip
    """Fly consecutive flights with the same firmware and bridge.

    ``options``: options of ``bridge crazyflie``; ``loss``: fraction of lost packets in each direction;
    ``tilt_rad``: rotation of the markers relative to the body, about body y; ``fault``: called once a flight.
    """
    here, there = free_endpoint(), free_endpoint()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.toml"
        file.write_text(text(one))
        robot = subprocess.Popen(
            [*COMMAND, "target", "--scenario", str(file), "--seed", str(seed), "--listen", here,
             "--connect", there],
            cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        session = zenoh_link.open_session([], [here])

        def pose() -> tuple:
            (w, x, y, z), half = plant.true_quaternion, 0.5 * tilt_rad
            return plant.position, (w - half * y, x - half * z, y + half * w, z + half * x)

        try:
            plant = SimPlant(one, seed, session, by_poses=True)
            made = Firmware(plant, needs_poses=True, **firmware)
            with Server(made, loss=loss, seed=seed) as server, Mocap(KEY, pose) as mocap:
                words = ("--uri", server.uri, "--url", "udpin:127.0.0.1:0")
                posed = ("--mocap", KEY, "--connect", mocap.endpoint)
                with verb("crazyflie", *words, *posed, *options) as bridge:
                    vehicle = bridge.url.replace("udpin", "udpout")
                    words = ("--vehicle", vehicle, "--connect", here, "--listen", there)
                    return [_land(plant, server, mocap, words, fault) for _ in range(flights)]
        finally:
            session.close()
            ended(robot)


def _land(
    plant: SimPlant, server: Server, mocap: Mocap, words: tuple[str, ...],
    fault: Callable[[Flying], None] | None,
) -> Landing:  # fmt: skip
    began_s, high_s = time.monotonic(), math.inf
    with tempfile.TemporaryFile("w+") as out:
        onboard = subprocess.Popen(
            [*COMMAND, "onboard", *words, "--config", "crazyflie", "--no-record", "--duration",
             f"{FLIGHT_MAX_S:g}"],
            cwd=ROOT, stdout=out, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        try:
            while onboard.poll() is None and time.monotonic() - began_s < FLIGHT_MAX_S + DOWN_MAX_S:
                time.sleep(0.02)
                high_s = min(high_s, time.monotonic()) if plant.position[2] > FAULT_ABOVE_M else math.inf
                if fault is not None and time.monotonic() - high_s > FAULT_AFTER_S:
                    fault(Flying(server, mocap, onboard))
                    fault = None
        finally:
            ended(onboard)
        out.seek(0)
        said = [line.strip() for line in out]
    seconds, ended_s = time.monotonic() - began_s, server.now_s
    while server.now_s < ended_s + DOWN_MAX_S and not (plant.on_surface and not plant.motors):
        time.sleep(0.02)
    rest_s = server.now_s + REST_S
    while server.now_s < rest_s:
        time.sleep(0.05)
    vehicle = plant.vehicle
    truth = vehicle.truth()
    dx, dy = (truth.position_enu_m[i] - truth.pad_position_enu_m[i] for i in (0, 1))
    place = "pad" if vehicle.on_pad else "floor" if vehicle.on_ground else "air"
    told = [line for line in said if "->" in line or line.startswith(("ABORT", "LANDED"))] or said or [""]
    error_m = math.hypot(dx, dy) if place == "pad" else math.nan
    locked = server.firmware.supervisor.state in (State.LOCKED, State.CRASHED) or vehicle.crashed
    reason = told[-1] if told[-1].startswith("LANDED") else " | ".join(told)[-300:]
    return Landing(error_m, place, not plant.motors, locked, reason, seconds)


def _silent(flying: Flying) -> None:
    flying.server.mute = flying.server.deaf = True
    time.sleep(1.3)
    flying.server.mute = flying.server.deaf = False


FAULTS: dict[str, tuple[dict[str, Any], Callable[[Flying], None] | None]] = {
    "drag not known": ({"options": ("--airframe", "none")}, None),
    "markers tilted by 1 degree": ({"tilt_rad": 0.0175}, None),
    "motion capture ends": ({}, lambda flying: flying.mocap.stop()),
    "radio silent for 1.3 s": ({}, _silent),
    "firmware restarts in the air": ({}, lambda flying: flying.server.firmware.restart()),
    "set-points end": ({}, lambda flying: flying.onboard.kill()),
    "simulator stalls for 0.2 s": ({}, lambda flying: flying.server.firmware.stall(0.2)),
    "clock at 0.97": ({"clock_rate": 0.97}, None),
    "10 % of the packets lost": ({"loss": 0.1}, None),
    "tables of 901 entries": ({"tables": (567, 334)}, None),
}


def down(landing: Landing) -> str:
    return "down" if landing.place in ("pad", "floor") and landing.motors_off else "NOT DOWN"


def line(seed: int, name: str, landing: Landing) -> str:
    return (
        f"{seed} {name}: {'good' if landing.good else down(landing)}, {landing.place} "
        f"{100.0 * landing.error_m:.1f} cm, {'locked, ' if landing.locked else ''}{landing.seconds:.0f} s: "
        f"{landing.reason}"
    )


def faults(words: list[str]) -> None:
    """Fly one flight with each fault whose name contains one of these words; print the results."""
    chosen = [name for name in FAULTS if not words or any(word in name for word in words)]
    for seed, name in enumerate(chosen, 1):
        more, fault = FAULTS[name]
        options = more.get("options", ())
        others = {key: value for key, value in more.items() if key != "options"}
        print(line(seed, name, fly(scenario(seed), seed, *options, fault=fault, **others)[0]), flush=True)


def main() -> None:
    """Print a line for each landing, then the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, help="none: 1 to 100")
    parser.add_argument("--in-a-row", type=int, default=1, help="landings of each seed, from pad to pad")
    parser.add_argument("--faults", nargs="*", metavar="WORD", help="fly the faults with such a name instead")
    parser.add_argument("--bridge", nargs=argparse.REMAINDER, default=[], help="options of bridge crazyflie")
    asked = parser.parse_args()
    if asked.faults is not None:
        faults(asked.faults)
        return
    landings = []
    for seed in asked.seeds or range(1, 101):
        one = scenario(seed)
        for landing in fly(one, seed, *asked.bridge, flights=asked.in_a_row):
            landings.append(landing)
            print(line(seed, one.target.path.value, landing), flush=True)
    errors_cm = [100.0 * each.error_m for each in landings if each.good]
    print(
        f"{len(errors_cm)} of {len(landings)} landed, "
        f"{sum(each.locked for each in landings)} crashed or locked; "
        f"error median, 95 %: {np.percentile(errors_cm, (50, 95)).round(1) if errors_cm else '-'} cm"
    )
