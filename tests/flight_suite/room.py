"""Vehicles that the suite flies, with their limits: simulated, PX4, or one named by the user."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from types import MappingProxyType

import pytest

from bridge.mavlink.profiles import ARDUPILOT, AUTO, CRAZYFLIE, OWN_SITL, PX4
from flightstack.common.processes import Child, Port
from flightstack.common.strict_toml import dumps
from flightstack.core.types import ZERO, Vec3
from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.program import Px4Model, Px4Program, free_instance
from sim.scenarios.scenario import Scenario, load, text
from tests.processes.started import StartedChild


class Lost(Enum):
    LANDS = "lands and stops its motors"
    STOPS = "hovers, armed, until a command lands it"


@dataclass(frozen=True)
class Limits:
    settle_s: float  # wait at zero velocity before the drift is measured
    still_m_s: float  # maximum allowed speed with a zero velocity set-point
    drift_m: float  # maximum allowed displacement in 5 s with a zero velocity set-point
    step_m_s: float  # speed of the velocity step to the north and back
    step_s: float  # duration of each direction of the step
    moved_share: tuple[float, float]  # range of the step's distance, as a fraction of speed times duration
    lost: Lost  # reaction of the vehicle to missing set-points
    lost_s: float  # maximum time from the last set-point to this reaction, s


_OWN = Limits(
    settle_s=3.0, still_m_s=0.15, drift_m=0.3,
    # a velocity lag T gives the fraction 1 - 1.5 T / step_s, so 0.4 allows lags of up to 0.8 s
    step_m_s=0.3, step_s=2.0, moved_share=(0.4, 1.2),
    lost=Lost.LANDS, lost_s=2.0,  # COM_OF_LOSS_T = 0.5 s plus the period of the heartbeat, 1 s
)  # fmt: skip

# PX4 holds velocity, not position: a force change of 1 N moves a vehicle of 1 kg by 1 / MPC_XY_VEL_I_ACC =
# 2.5 m, and by half of this distance within 3 s. A model of PX4's velocity loop flew 1000 times in wind of
# 0.5 m/s with gusts of 0.2 m/s, which push the 1 kg quadrotor by 1 N per m/s (SIH_KDV). In 999 flights the
# vehicle drifts by less than 0.8 m, is slower than 0.23 m/s at zero velocity, and moves 0.36 to 0.73 of the
# step.
_PX4 = Limits(
    settle_s=5.0, still_m_s=0.3, drift_m=1.0,
    step_m_s=0.5, step_s=3.0, moved_share=(0.25, 1.0),
    lost=Lost.LANDS, lost_s=2.5,  # COM_OF_LOSS_T = 1.0 s, checked at 10 Hz, plus one heartbeat period
)  # fmt: skip

LIMITS: Mapping[str, Limits] = MappingProxyType(
    {
        OWN_SITL.name: _OWN,
        CRAZYFLIE.name: replace(_OWN, lost_s=3.5),  # the firmware stops the motors after 2 s
        PX4.name: _PX4,
        ARDUPILOT.name: replace(_OWN, lost=Lost.STOPS, lost_s=2.8),  # GUID_TIMEOUT <= 1 s, plus 1.8 s to stop
    }
)


SCENARIO = "grid"  # scenario that starts on the ground and lands by contact on a driving robot
ORIGIN_WGS84 = (47.397742, 8.545594, 10.0)  # degrees, degrees, m: origin for ArduPilot without satellites


@dataclass(frozen=True)
class Fence:
    """Limits of a step; outside them the step ends and the vehicle is landed."""

    height_m: float = 2.0  # height above the start of the step
    distance_m: float = 4.0  # horizontal distance from the start of the step


@dataclass(frozen=True)
class Room:
    """All parameters of a flight step: addresses, files, limits and processes."""

    url: str  # MAVLink URL of the vehicle
    autopilot: str  # name of the autopilot's profile
    target_key: str  # Zenoh key of the target's odometry
    connect: tuple[str, ...]  # Zenoh endpoints of the target
    listen: str  # Zenoh endpoint of the onboard process
    config: Path  # configuration of the onboard process
    folder: Path  # folder for output of processes
    fence: Fence = field(default_factory=Fence)  # limits of the vehicle's position during the step
    system_id: int = 1  # system id of the vehicle
    signing_key: Path | None = None  # MAVLink signing key; None: unsigned
    takeoff_height_m: float = 0.5  # height of the pilot's take-off
    target_offset_m: Vec3 = ZERO  # landing spot relative to the tracked frame, in that frame's axes
    limits: Limits | None = None  # limits of the steps; None: those of the profile
    speed: float = 1.0  # ratio of a simulator's time to real time; 1 on hardware
    clock: Path | None = None  # simulator clock that the onboard process uses; None: wall clock
    target: Child | None = None  # the simulated robot; None on hardware
    vehicle: Child | None = None  # the simulated vehicle; None on hardware
    px4: Px4Program | None = None  # PX4 program that flies the vehicle; None without PX4
    recorder: Path | None = None  # socket of the recorder; None: only a real flight is recorded


def configured(scenario: Scenario, folder: Path) -> Path:
    """Write a scenario's onboard configuration with a short CLIMB; no lost target comes back in a flight."""
    checks = replace(scenario.onboard.checks, climb_time_max_s=2.0)  # wait for a lost target, s
    side = replace(scenario.onboard.vehicle, origin_wgs84=ORIGIN_WGS84)
    file = folder / "onboard.toml"
    file.write_text(dumps(replace(scenario.onboard, checks=checks, vehicle=side)))
    return file


@contextlib.contextmanager
def simulated(folder: Path, scenario_name: str = SCENARIO) -> Iterator[Room]:
    """Start vehicle and robot in real time, and end them at the end of the context."""
    scenario = load(scenario_name)
    config = configured(scenario, folder)
    ports, children = [Port(), Port()], []
    target_at, onboard_at = (port.endpoint for port in ports)
    common = ["--scenario", scenario_name, "--seed", "1", "--duration", "300"]
    try:
        words = ["--connect", target_at, "--url", "udpin:127.0.0.1:0"]
        vehicle = StartedChild("vehicle", ["vehicle", *common, *words], folder)
        children.append(vehicle)
        target = StartedChild(
            "target", ["target", *common, "--listen", target_at, "--connect", onboard_at], folder
        )
        children.append(target)
        url = vehicle.wait_ready().replace("udpin", "udpout")
        target.wait_ready()
        yield Room(
            url, PX4.name, "cf1/target/odom", (target_at,), onboard_at, config, folder,
            takeoff_height_m=scenario.onboard.takeoff.height_m, target=target, vehicle=vehicle,
            limits=LIMITS[OWN_SITL.name],
        )  # fmt: skip
    finally:
        for child in reversed(children):
            child.end()
        for port in ports:
            port.close()


@contextlib.contextmanager
def given(config: pytest.Config, folder: Path) -> Iterator[Room]:
    """Yield the room that the command line describes. Raises pytest.UsageError: an option is missing."""
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


FENCE = Fence(height_m=4.0, distance_m=25.0)  # 25 m: the robot of `large` drives straight at 0.4 m/s


@contextlib.contextmanager
def on_px4(
    folder: Path,
    place: Path,
    scenario_name: str,
    seed: int,
    *,
    speed: float = 1.0,
    clocked: bool = False,
    mocap: bool = False,
    recorder: Path | None = None,
) -> Iterator[Room]:
    """Start simulator, PX4 and robot, and end them at the end of the context.

    Raises FileNotFoundError: no PX4 there. Raises LaunchError: a process did not start.

    Args:
        folder: folder for output of processes.
        place: location of PX4's program (argument of ``sim.px4.program.find_px4``).
        scenario_name: name or file of the scenario; its robot waits for the first approach.
        seed: seed of wind, noise and the vehicle's spread.
        speed: ratio of simulated to real time.
        clocked: whether robot and onboard process use the simulator's clock, which runs at most
            ``speed`` times as fast as real time, and slower if one of the processes cannot follow; a
            pilot in this process uses the wall clock.
        mocap: whether the scenario's motion capture replaces satellites.
        recorder: socket of a recorder for the true states.
    """
    scenario = load(scenario_name)
    # without this wait, the robot would be far away before all processes have started
    scenario = replace(scenario, target=replace(scenario.target, wait_for_landing=True))
    file = folder / "scenario.toml"
    file.write_text(text(scenario))
    poses = scenario.vehicle.mocap if mocap else None
    common = ["--scenario", str(file), "--seed", str(seed)]
    paced = ["--speed", str(speed)]
    clock = ["--clock", str(folder / "clock")] if clocked else []
    with contextlib.ExitStack() as stack:
        instance = free_instance()
        target_at, onboard_at = (stack.enter_context(contextlib.closing(Port())).endpoint for _ in range(2))

        def start(verb: str, *words: str) -> Child:
            child = StartedChild(verb, [verb, *common, *words], folder)
            stack.callback(child.end)
            child.wait_ready()
            return child

        # PX4's instance number determines the TCP port
        plugs = ["--tcp", f"127.0.0.1:{4560 + instance}", "--connect", target_at, *paced, *clock]
        plugs += ["--mocap"] if mocap else []
        plugs += ["--recorder", str(recorder)] if recorder is not None else []
        simulator = start("px4-sim", *plugs)
        px4 = Px4Program(
            place, folder / "px4", Px4Model.NONE_IRIS, instance=instance,
            parameters=parameters(params.load(scenario.vehicle.airframe), poses),
        )  # fmt: skip
        stack.callback(px4.end)
        px4.boot()
        target = start("target", "--listen", target_at, "--connect", onboard_at, *(clock or paced))
        yield Room(
            f"udpin:127.0.0.1:{px4.onboard_port}", AUTO, "cf1/target/odom", (target_at,), onboard_at,
            configured(scenario, folder), folder, FENCE, system_id=instance + 1,  # PX4's rule
            takeoff_height_m=scenario.onboard.takeoff.height_m, target=target, vehicle=simulator,
            speed=1.0 if clocked else speed, clock=folder / "clock" if clocked else None, px4=px4,
        )  # fmt: skip
