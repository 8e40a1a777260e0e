"""Vehicles of ``sitl``: the simulated vehicle, also flown by PX4; PX4 and ArduPilot with built-in physics.

A function for each kind of vehicle starts the processes and returns the options with which the onboard
process connects to them. Vehicles with built-in physics have no pad: they land on the floor under the landing
spot. These vehicles have the position 0 at the start, so the robot's path is moved instead.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from bridge.mavlink.profiles import ARDUPILOT, AUTO, OWN_SITL
from bridge.mavlink.profiles import PX4 as PX4_PROFILE
from flightstack.common.options import shared
from flightstack.common.processes import Child
from flightstack.common.strict_toml import ConfigError
from flightstack.core.types import Vec3
from flightstack.launch.launcher import Launcher
from flightstack.launch.run_options import Flies, RunOptions
from logs.schema import SCENARIO
from sim.autopilot.telemetry import ORIGIN_WGS84
from sim.options import Px4SimOptions, WorldOptions
from sim.px4.program import Px4Model, Px4Program, free_instance
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import MEMBERS_MAX, StartKind
from sim.vehicle.vehicle import compile_first

T = TypeVar("T")
_EAST_DEG = 90.0  # heading of the nose at the start, degrees from north
SIMULATOR_PORT = 4560  # port to which PX4 of instance 0 connects
_ARDUPILOT_TCP = 5760  # TCP port for SERIAL0 of instance 0; each further instance adds 10


class Run(NamedTuple):
    """A run of ``sitl``: the data that the functions for the kinds of vehicles need."""

    launcher: Launcher
    options: RunOptions
    scenario: Scenario
    robots_at: str  # Zenoh endpoint of the robots

    def start(self, verb: str, cls: type[Any], **own: Any) -> Child:
        """Start a simulator process; ``own``: options of this process in addition to those of the run."""
        launcher, options = self.launcher, self.options
        both = {"scenario": launcher.folder / SCENARIO, "recorder": launcher.socket, "zenoh_config": None}
        return launcher.start(verb, shared(options, cls, **both, **own))

    @property
    def longest_s(self) -> float:
        """Maximum time of a flight, s: the scenario's duration plus the time for an abort."""
        members = self.scenario.members
        return max(each.duration_max_s + each.onboard.retreat.abort_time_max_s for each in members)

    @property
    def others_s(self) -> float:
        """Run time of the simulator's processes, s; it is longer than that of onboard processes."""
        return self.longest_s + 10.0


@dataclass
class Flying:
    """Started vehicles of a run."""

    options: Sequence[Mapping[str, Any]]  # options of each vehicle's onboard process
    teller: Child | None = None  # process that prints a line when a vehicle arms or disarms
    # options that make robot and onboard process follow the vehicle's clock; empty: both run at --speed
    clock: Mapping[str, Any] = field(default_factory=dict)


def _own(run: Run) -> Flying:
    """Start one process that simulates robots and vehicles; the vehicles use the simulator's autopilot."""
    compile_first(run.scenario)
    elsewhere = run.options.members
    child = run.start(
        "world", WorldOptions, duration_s=run.others_s, listen=(run.robots_at,), url="udpin:127.0.0.1:0",
        leave_out=tuple(elsewhere),
    )  # fmt: skip
    urls = iter(child.wait_ready().replace("udpin", "udpout").split())
    # the simulated vehicle sends the heartbeat of PX4
    autopilot = OWN_SITL.name if run.options.autopilot == AUTO else run.options.autopilot
    given = [
        {"vehicle_url": elsewhere[number], "signing_key": None}
        if number in elsewhere
        else {"vehicle_url": next(urls), "autopilot": autopilot}
        for number in range(1, len(run.scenario.members) + 1)
    ]
    return Flying(given, child)


def _px4(run: Run) -> Flying:
    """Start the simulator, then PX4, which connects to it."""
    options = run.options
    compile_first(run.scenario)
    number = free_instance() if options.instance is None else options.instance
    clock: Mapping[str, Any] = {"clock": run.launcher.socket.with_name("clock")}
    simulator = run.start(
        "px4-sim", Px4SimOptions, duration_s=None, connect=(run.robots_at,), once=True,
        tcp=f"127.0.0.1:{SIMULATOR_PORT + number}", **clock,
    )  # fmt: skip
    simulator.wait_ready()
    # only this kind of vehicle needs these imports, which load the compiler (0.5 s)
    from sim.plant import params
    from sim.px4.airframe import parameters

    vehicle = run.scenario.vehicle
    wanted = parameters(params.load(vehicle.airframe), vehicle.mocap if options.mocap else None)
    given = _run_px4(run, number, Px4Model.NONE_IRIS, wanted)
    return Flying([given], simulator, {**clock, "speed": 1.0})


def _px4_sih(run: Run) -> Flying:
    """Start PX4 with its built-in simulation (SIH) of a 1 kg quadrotor."""
    from sim.px4.airframe import SAFE_PARAMETERS

    number = free_instance() if run.options.instance is None else run.options.instance
    return Flying([_run_px4(run, number, Px4Model.SIHSIM_QUADX, SAFE_PARAMETERS)])


def _run_px4(run: Run, number: int, model: Px4Model, wanted: Mapping[str, float]) -> Mapping[str, Any]:
    """Start PX4 and wait until it can arm; return the options of the onboard process."""
    launcher, binary = run.launcher, run.options.program
    assert binary is not None
    program = Px4Program(
        binary, launcher.folder / "px4", model, instance=number, parameters=wanted, speed=run.options.speed
    )
    launcher.children.append(program)
    program.boot()
    for name in program.absent:
        launcher.hint(f"PX4: this release has no {name}; the pre-flight check uses those that it has")
    url = f"udpin:127.0.0.1:{program.onboard_port}"
    system_id = 1 + number  # PX4's script rcS sets MAV_SYS_ID to this value
    return {"vehicle_url": url, "autopilot": PX4_PROFILE.name, "system_id": system_id}


def _ardupilot(run: Run) -> Flying:
    """Start ArduCopter's software in the loop; the onboard process waits for ArduCopter's heartbeat."""
    launcher, number = run.launcher, run.options.instance or 0
    folder = launcher.folder / "ardupilot"
    folder.mkdir(exist_ok=True)
    defaults = folder / "defaults.parm"
    defaults.write_text("".join(f"{name} {value:g}\n" for name, value in ARDUPILOT_PARAMETERS.items()))
    home = (*ORIGIN_WGS84, _EAST_DEG)
    child = Child(
        "ardupilot",
        ["--model", "quad", "--speedup", f"{run.options.speed:g}", "--home", ",".join(map(str, home)),
         "--defaults", str(defaults), "-I", str(number)],
        launcher.folder, program=[str(run.options.program)], works_in=folder,
    )  # fmt: skip
    launcher.children.append(child)
    url = f"tcp:127.0.0.1:{_ARDUPILOT_TCP + 10 * number}"
    return Flying([{"vehicle_url": url, "autopilot": ARDUPILOT.name}])


# Parameters of ArduCopter's simulated quadrotor that differ from the defaults: frame, battery, calibrations
# of the sensors (Tools/autotest/default_params/copter.parm), no radio, values for the pre-flight check. The
# table has the names of all known releases, because a release ignores unknown names.
ARDUPILOT_PARAMETERS: Mapping[str, float] = {
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 0,
    "BATT_MONITOR": 4,
    "MOT_BAT_VOLT_MIN": 9.6,
    "MOT_BAT_VOLT_MAX": 12.8,
    "MOT_THST_EXPO": 0.65,
    "MOT_THST_HOVER": 0.39,
    **{f"COMPASS_OFS{n}_{axis}": v for n in ("", 2, 3) for axis, v in (("X", 5), ("Y", 13), ("Z", -18))},
    **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", 2) for axis in "XYZ"},
    **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", 2) for axis in "XYZ"},
    "FS_THR_ENABLE": 0,
    "FS_GCS_ENABLE": 5,
    **dict.fromkeys(("SYSID_MYGCS", "MAV_GCS_SYSID"), 1),  # the onboard process is the ground station
    "GUID_TIMEOUT": 0.5,
    **{"WPNAV_ACCEL_Z": 150, "WP_ACC_Z": 1.5},  # up to release 4.6 in cm/s^2, from 4.7 on in m/s^2
}


_FIRMWARE = re.compile(rb"ArduCopter V(\d+)\.(\d+)")  # pattern of THISFIRMWARE in ArduCopter/version.h
_DEAD_TIME_SINCE = (4, 7)  # first release whose velocity loop has a dead time (ATC_INPUT_TC)


def _ardupilot_configuration(scenario: Scenario, program: Path | None) -> str:
    """Return the name of the configuration for the program's release; an unknown one counts as newest."""
    del scenario
    release = _DEAD_TIME_SINCE
    if program is not None and program.is_file() and program.stat().st_size:
        with program.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as held:
            if found := _FIRMWARE.search(held):
                release = int(found[1]), int(found[2])
    return "ardupilot-1kg" if release < _DEAD_TIME_SINCE else "ardupilot47-1kg"


class Vehicle(NamedTuple):
    """A kind of vehicle that ``sitl`` can fly."""

    # function that starts the vehicle and, if the URL is not known before, waits until the vehicle is ready;
    # it raises LaunchError if the vehicle does not become ready
    start: Callable[[Run], Flying]
    # function from scenario and program to the configuration's name; None: the scenario's configuration
    configuration: Callable[[Scenario, Path | None], str | None] = lambda _scenario, _program: None
    with_robots: bool = False  # whether the vehicle's process also simulates the robots
    # whether the autopilot's program simulates the physics: without a pad, and from the position 0
    own_physics: bool = False
    vehicles_max: int = 1  # maximum number of vehicles in a run


_PX4_CONFIGURATIONS = {"crazyflie20": "px4-crazyflie", "quad_1000g": "px4-1kg"}  # names by airframe
VEHICLES: Mapping[Flies, Vehicle] = {
    Flies.OWN: Vehicle(_own, with_robots=True, vehicles_max=MEMBERS_MAX),
    Flies.PX4: Vehicle(_px4, lambda scenario, _: _PX4_CONFIGURATIONS.get(scenario.vehicle.airframe)),
    Flies.PX4_SIH: Vehicle(_px4_sih, lambda *_: "px4-1kg", own_physics=True),
    Flies.ARDUPILOT: Vehicle(_ardupilot, _ardupilot_configuration, own_physics=True),
}


def around_the_start(scenario: Scenario) -> Scenario:
    """Return the scenario in coordinates with the origin at the place where the vehicle starts."""
    start, target = scenario.start, scenario.target
    x_m, y_m = target.position_m
    if start.kind is StartKind.GROUND:
        east_m, north_m = start.ground_position_m
        start = replace(start, ground_position_m=(0.0, 0.0))
    elif start.offset_m is not None:
        east_m, north_m = x_m + start.offset_m[0], y_m + start.offset_m[1]
    else:
        raise ConfigError(f"{scenario.name}: start.offset_m: missing; this vehicle starts at a given place")
    return replace(scenario, start=start, target=replace(target, position_m=(x_m - east_m, y_m - north_m)))


def to_the_floor_m(scenario: Scenario) -> Vec3:
    """Return the target offset that puts the landing spot on the floor, m: no pad carries this vehicle."""
    down_m = scenario.target.pad_height_m + scenario.onboard.touchdown.feet_below_reference_m
    return 0.0, 0.0, round(-down_m, 6)
