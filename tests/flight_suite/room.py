"""Where the suite flies: our simulated vehicle and robot by default, or what the command line names."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from bridge.mavlink.profiles.autopilots import OWN_SITL, PX4
from flightstack.common.processes import Child, Port
from flightstack.common.strict_toml import dumps
from flightstack.core.types import ZERO, Vec3
from sim.scenarios.scenario import Scenario, load
from tests.flight_suite.limits import LIMITS, Limits

SCENARIO = "grid"  # starts on the ground, lands by contact on a robot that drives off
# of our simulated vehicle, with the parameters that its defaults leave unsafe
PROFILES: Mapping[str, tuple[str, ...]] = {
    "px4": (),
    "ardupilot": ("GUID_TIMEOUT=0.5", "FS_GCS_ENABLE=5", "SYSID_MYGCS=1"),
}
ORIGIN_WGS84 = (47.397742, 8.545594, 10.0)  # what ArduPilot needs without satellites


@dataclass(frozen=True)
class Fence:
    """Beyond it a step ends, and the vehicle is brought down.

    Attributes:
        height_m: above the place where the step began.
        distance_m: horizontal, from there.
    """

    height_m: float = 2.0
    distance_m: float = 4.0


@dataclass(frozen=True)
class Room:
    """Everything a step needs to know.

    Attributes:
        url: MAVLink URL of the vehicle.
        autopilot: name of its profile.
        target_key: Zenoh key of the target's odometry.
        connect: Zenoh endpoints of the target.
        listen: Zenoh endpoint of the onboard process.
        config: its configuration.
        folder: for output of processes.
        fence: limits of place.
        system_id: of the vehicle.
        signing_key: for MAVLink; None: unsigned.
        takeoff_height_m: how high the pilot climbs.
        target_offset_m: landing spot from the tracked frame, in that frame's axes.
        limits: of the steps; None: those of the profile.
        speed: of a simulator against real time; 1 on hardware.
        clock: of a simulator by which the onboard process lives; None: the wall's.
        target: the simulated robot; None on hardware.
        vehicle: the simulated vehicle; None on hardware.
    """

    url: str
    autopilot: str
    target_key: str
    connect: tuple[str, ...]
    listen: str
    config: Path
    folder: Path
    fence: Fence = field(default_factory=Fence)
    system_id: int = 1
    signing_key: Path | None = None
    takeoff_height_m: float = 0.5
    target_offset_m: Vec3 = ZERO
    limits: Limits | None = None
    speed: float = 1.0
    clock: Path | None = None
    target: Child | None = None
    vehicle: Child | None = None


def configured(scenario: Scenario, folder: Path) -> Path:
    """A scenario's configuration of the onboard process as a file, for a room where nobody comes back."""
    checks = replace(scenario.onboard.checks, climb_time_max_s=2.0)  # less waiting
    side = replace(scenario.onboard.vehicle, origin_wgs84=ORIGIN_WGS84)
    file = folder / "onboard.toml"
    file.write_text(dumps(replace(scenario.onboard, checks=checks, vehicle=side)))
    return file


@contextlib.contextmanager
def simulated(folder: Path, server_profile: str) -> Iterator[Room]:
    """Start vehicle and robot, in real time; ended whatever happens."""
    scenario = load(SCENARIO)
    config = configured(scenario, folder)
    ports, children = [Port(), Port()], []
    target_at, onboard_at = (port.endpoint for port in ports)
    common = ["--scenario", SCENARIO, "--seed", "1", "--duration", "300"]
    try:
        words = ["--profile", server_profile, "--connect", target_at, "--url", "udpin:127.0.0.1:0"]
        words += [word for one in PROFILES[server_profile] for word in ("--parameter", one)]
        vehicle = Child("vehicle", ["vehicle", *common, *words], folder)
        children.append(vehicle)
        target = Child("target", ["target", *common, "--listen", target_at, "--connect", onboard_at], folder)
        children.append(target)
        url = vehicle.wait_ready().replace("udpin", "udpout")
        target.wait_ready()
        yield Room(
            url, server_profile, "cf1/target/odom", (target_at,), onboard_at, config, folder,
            takeoff_height_m=scenario.onboard.takeoff.height_m, target=target, vehicle=vehicle,
            limits=LIMITS[OWN_SITL.name] if server_profile == PX4.name else None,
        )  # fmt: skip
    finally:
        for child in reversed(children):
            child.end()
        for port in ports:
            port.close()


@contextlib.contextmanager
def given(config: pytest.Config, folder: Path) -> Iterator[Room]:
    """The room that the command line names.

    Raises:
        pytest.UsageError: something is missing.
    """
    option = config.getoption
    if option("--config") is None:
        raise pytest.UsageError("--vehicle needs --config FILE: the configuration of the onboard process")
    height_m, distance_m = option("--fence")
    with contextlib.closing(Port()) as port:
        yield Room(
            option("--vehicle"), option("--autopilot"), option("--target"), tuple(option("--connect")),
            option("--listen") or port.endpoint, option("--config"), folder, Fence(height_m, distance_m),
            option("--system-id"), option("--signing-key"), option("--takeoff-height"),
            tuple(option("--target-offset")),
        )  # fmt: skip
