"""Landings on driving pads with the shipped Crazyflie configuration, through bridge and cflib, in real time.

A model of firmware 2026.08 flies the simulated vehicle, with poses of ``bridge crazyflie --mocap``.
``onboard --config crazyflie`` lands the vehicle on a robot that drives at up to 0.3 m/s from time zero on.
``python -m tests.benchmarks crazyflie_landings [SEED ...] [--in-a-row N]``
"""

from __future__ import annotations

import argparse
import math
import subprocess
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

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
REST_S = 2.5  # time from motors off on a surface to the verdict, s
DOWN_MAX_S = 30.0  # time-out from the end of the onboard process to motors off, s
SPEED_MAX_M_S = 0.3
PATHS = (PathKind.STRAIGHT, PathKind.CIRCLE, PathKind.STOP_AND_GO, PathKind.REVERSING)


@dataclass(frozen=True)
class Landing:
    """Result of one flight, computed from true states."""

    error_m: float  # horizontal distance from the pad's centre at rest on the pad; NaN: not on the pad
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

    The robot drives from time zero on.
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


def fly(one: Scenario, seed: int, *options: str, flights: int = 1) -> list[Landing]:
    """Fly ``flights`` times with one firmware and bridge; ``options``: options of ``bridge crazyflie``."""
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

        try:
            plant = SimPlant(one, seed, session, by_poses=True)
            with (
                Server(Firmware(plant, needs_poses=True), seed=seed) as server,
                Mocap(KEY, lambda: (plant.position, plant.true_quaternion)) as mocap,
            ):
                words = ("--uri", server.uri, "--url", "udpin:127.0.0.1:0")
                posed = ("--mocap", KEY, "--connect", mocap.endpoint)
                with verb("crazyflie", *words, *posed, *options) as bridge:
                    vehicle = bridge.url.replace("udpin", "udpout")
                    words = ("--vehicle", vehicle, "--connect", here, "--listen", there)
                    return [_land(plant, server, words) for _ in range(flights)]
        finally:
            session.close()
            ended(robot)


def _land(plant: SimPlant, server: Server, words: tuple[str, ...]) -> Landing:
    began_s = time.monotonic()
    with tempfile.TemporaryFile("w+") as out:
        onboard = subprocess.Popen(
            [*COMMAND, "onboard", *words, "--config", "crazyflie", "--no-record", "--duration",
             f"{FLIGHT_MAX_S:g}"],
            cwd=ROOT, stdout=out, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        try:
            while onboard.poll() is None and time.monotonic() - began_s < FLIGHT_MAX_S + DOWN_MAX_S:
                time.sleep(0.02)
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
    locked = (
        server.firmware.supervisor.state in (State.LOCKED, State.CRASHED) or "crashed" in vehicle.state_text
    )
    reason = told[-1] if told[-1].startswith("LANDED") else " | ".join(told)[-300:]
    return Landing(error_m, place, not plant.motors, locked, reason, seconds)


def line(seed: int, name: str, landing: Landing) -> str:
    return (
        f"{seed} {name}: {'good' if landing.good else 'BAD'}, {landing.place} "
        f"{100.0 * landing.error_m:.1f} cm, {'locked, ' if landing.locked else ''}{landing.seconds:.0f} s: "
        f"{landing.reason}"
    )


def main() -> None:
    """Print one line for each landing, and then the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, help="none: 1 to 100")
    parser.add_argument("--in-a-row", type=int, default=1, help="landings of each seed, from pad to pad")
    parser.add_argument("--bridge", nargs=argparse.REMAINDER, default=[], help="options of bridge crazyflie")
    asked = parser.parse_args()
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
