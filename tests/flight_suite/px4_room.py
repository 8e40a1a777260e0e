"""The room of a PX4 SITL: PX4 itself, on the physics of ``flightstack px4-sim``, and the simulated robot."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from bridge.mavlink.profiles.autopilots import AUTO
from flightstack.common.processes import Child, Port
from flightstack.common.strict_toml import dumps
from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.program import InstanceClaim, Px4Model, Px4Program
from sim.scenarios.scenario import load
from tests.flight_suite.room import Fence, Room, configured

FENCE = Fence(height_m=4.0, distance_m=25.0)  # the robot of scenario `large` drives straight on at 0.4 m/s


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
    """Start simulator, PX4 and robot; ended whatever happens.

    Args:
        folder: for output of processes.
        place: of PX4's program, as ``sim.px4.program.find_px4`` takes it.
        scenario_name: name or file of the scenario; its robot waits for the first approach.
        seed: of wind, noise and the vehicle's spread.
        speed: of all of it against real time.
        clocked: robot and onboard process live by the simulator's clock, which is as fast as all of them can
            be, at most ``speed``; a pilot in this process still lives by the wall's.
        mocap: the scenario's motion capture instead of satellites.
        recorder: socket of a recorder for the true states.

    Raises:
        FileNotFoundError: no PX4 there.
        LaunchError: a process did not start.
    """
    scenario = load(scenario_name)
    # until the first approach, or it is far away before everything has started
    scenario = replace(scenario, target=replace(scenario.target, wait_for_landing=True))
    file = folder / "scenario.toml"
    file.write_text(dumps(scenario))
    poses = scenario.vehicle.mocap if mocap else None
    common = ["--scenario", str(file), "--seed", str(seed)]
    paced = ["--speed", str(speed)]
    clock = ["--clock", str(folder / "clock")] if clocked else []
    with contextlib.ExitStack() as stack:
        claim = stack.enter_context(contextlib.closing(InstanceClaim()))
        target_at, onboard_at = (stack.enter_context(contextlib.closing(Port())).endpoint for _ in range(2))

        def start(verb: str, *words: str) -> Child:
            child = Child(verb, [verb, *common, *words], folder)
            stack.callback(child.end)
            child.wait_ready()
            return child

        # PX4's TCP port follows from its instance
        plugs = ["--tcp", f"127.0.0.1:{4560 + claim.number}", "--connect", target_at, *paced, *clock]
        plugs += ["--mocap"] if mocap else []
        plugs += ["--recorder", str(recorder)] if recorder is not None else []
        simulator = start("px4-sim", *plugs)
        px4 = Px4Program(
            place, folder / "px4", Px4Model.NONE_IRIS, instance=claim.number,
            parameters=parameters(params.load(scenario.vehicle.airframe), poses),
        )  # fmt: skip
        stack.callback(px4.end)
        px4.wait_ready()
        target = start("target", "--listen", target_at, "--connect", onboard_at, *(clock or paced))
        yield Room(
            f"udpin:127.0.0.1:{px4.onboard_port}", AUTO, "cf1/target/odom", (target_at,), onboard_at,
            configured(scenario, folder), folder, FENCE, system_id=claim.number + 1,  # so does PX4
            takeoff_height_m=scenario.onboard.takeoff.height_m, target=target, vehicle=simulator,
            speed=1.0 if clocked else speed, clock=folder / "clock" if clocked else None,
        )  # fmt: skip
