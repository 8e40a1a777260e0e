"""Makes a fault for each cell of the fault table, and flies vehicles with faults."""

from sim.chance import stream
from sim.faults.schedule import Running
from sim.plant.sensors import NS
from sim.scenarios.fault_spec import TABLE, Fault, Kind, Number, What
from sim.scenarios.tables import Start, StartKind, VehicleSpec, VelocityLoop
from sim.vehicle.vehicle import VehicleSim
from tests.unit.vehicle.vehicle_sim_helpers import QUIET, scenario

CELLS = [(what, kind) for what, kinds in TABLE.items() for kind in kinds]
ALOFT = Start(StartKind.HOVER, offset_m=(2.0, 0.0, 1.5))


def fault(what: What, kind: Kind, **values) -> Fault:
    """Return the fault ``kind`` of ``what``; the default motor is 2, the default offset 0.3 m east."""
    if what is What.MOTOR:
        values.setdefault("motor", 2)
    if TABLE[what][kind].offset:
        values.setdefault("offset_m", (0.3, 0.0, 0.0))
    return Fault(what, kind, **values)


def running(what: What, kind: Kind, start_s: float = 0.0, **values) -> Running:
    """Return a fault that runs from ``start_s`` on."""
    return Running(fault(what, kind, **values), stream(1, "test"), start_ns=round(start_s * NS))


def aloft(*faults: Fault, loop=VelocityLoop.PID, seed=1) -> VehicleSim:
    """Return a vehicle in hover, 1.7 m above free floor."""
    spec = VehicleSpec(velocity_loop=loop, mocap=QUIET)
    return VehicleSim(scenario(start=ALOFT, vehicle=spec, fault=faults), seed)


def hold(sim: VehicleSim, seconds: float):
    """Hold a position by a simple loop on the state estimate; return the true states at 100 Hz."""
    home, truths = (2.0, 0.0, 1.7), []
    for _ in range(round(seconds * 100)):
        position = sim.estimate().position_enu_m
        sim.set_velocity(tuple(max(-0.5, min(0.5, a - b)) for a, b in zip(home, position, strict=True)), 0.0)
        sim.advance(10)
        truths.append(sim.truth())
    return truths


def off_home(truth) -> float:
    """Return the true distance from the position to hold, m."""
    x, y, z = truth.position_enu_m
    return ((x - 2.0) ** 2 + y**2 + (z - 1.7) ** 2) ** 0.5


def table_row(what: What, kind: Kind) -> str:
    """Return the row of docs/reference/faults.md for this fault."""
    cell = TABLE[what][kind]
    columns = " | ".join(_shown(number) for number in (cell.value, cell.period))
    return f"| `{what.value}` | `{kind.value}` | {cell.effect} | {columns} |"


def _shown(number: Number | None) -> str:
    if number is None:
        return ""
    allowed = f"{number.meaning}, {number.low:g} to {number.high:g} {number.unit}".removesuffix(" 1")
    return f"{allowed} ({number.default:g})"
