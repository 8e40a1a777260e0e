"""Scenarios and flights for the tests of the simulated vehicle."""

from flightstack.core.parameters.flight import FlightConfig, Takeoff
from flightstack.core.safety.barrier import Barrier
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import OdometryLink, Start, StartKind, VehicleSpec, VelocityLoop
from sim.vehicle.vehicle import VehicleSim

LOOPS = list(VelocityLoop)
STANDING = 0.0144
QUIET = OdometryLink(100.0, delay_s=0.01)
HIGH = Start(StartKind.HOVER, offset_m=(0.0, 0.0, 1.0))


def scenario(start=HIGH, **parts):
    takeoff = Takeoff(start_offset_m=(-1.0, 0.0, 0.7))
    onboard = FlightConfig(Barrier(1.0, 1.5), takeoff=takeoff)
    parts.setdefault("vehicle", VehicleSpec(mocap=QUIET))
    return Scenario("test", "", onboard, start=start, **parts)


def vehicle(seed=1, **parts):
    return VehicleSim(scenario(**parts), seed)


def fly(sim, velocity, seconds, yaw=0.0):
    """Fly with one set-point, which is sent at 100 Hz; return the true states at 100 Hz."""
    out = []
    for _ in range(round(seconds * 100)):
        sim.set_velocity(velocity, yaw)
        sim.advance(10)
        out.append(sim.truth())
    return out
