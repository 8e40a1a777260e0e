"""Moving air: wind (mean and gusts), and the downwash of another vehicle's rotors.

Each axis of the gusts and of the disturbance torques is an Ornstein-Uhlenbeck process, dg = -g/T dt + rms
sqrt(2/T) dW, with the first-order spectrum of Dryden's longitudinal gusts. ``crazyflie20.toml`` has T and the
ratio of vertical to horizontal gusts.

The wakes of the four rotors merge into one turbulent jet along the thrust. The model of the mean velocity is
from Bauersfeld, Muller, Ziegler, Coletti and Scaramuzza, "Robotics meets Fluid Dynamics: A Characterization
of the Induced Airflow below a Quadrotor as a Turbulent Jet" (arXiv 2403.13321), fitted to six vehicles:

    U(s, r) = U_c (1 + (sqrt(2) - 1) (r / b)^2)^-2     U_c = U_H DECAY / (s/l - ORIGIN)
    U_H = sqrt(T / (2 rho 4 pi R^2))                   b = SPREAD (s/l - ORIGIN) l

s is the distance along the jet, r the distance from the jet's axis, T the thrust, R the rotors' radius, l the
distance between two opposite motors. The published model starts 2.5 l below the rotors; closer to the rotors,
the value at 2.5 l is used.

A vehicle in a jet loses thrust according to its drag along body z, a quarter at each rotor. The rotor drag
acts sideways. The body has the drag of a plate of its board's size (C_D = 1.18, as in Jain, Fortmuller, Byun,
Makiharju and Mueller, ICUAS 2019). docs/how_it_works/vehicle.md has the numbers.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Motors, Record, Vector
from flightstack.core.types import Vec3
from sim.chance import stream
from sim.plant.params import Body, Geometry, Rotor, WindShape
from sim.plant.rotors import POSITION_X, POSITION_Y
from sim.plant.sensors import Tape, TapeRecord, take
from sim.plant.states import Nine
from sim.scenarios.tables import Wind


class NoiseRecord(Record):
    """State of the noise on three axes, in units of the standard deviation."""

    now: Vector
    decay: Vector  # factor on the value in one step
    kick: Vector  # standard deviation of the noise that one step adds
    on: bool
    tape: TapeRecord


@jitted
def vary(n: NoiseRecord) -> None:
    """Advance the noise by one step, with three random numbers of the tape."""
    if n.on:
        for i in range(3):
            n.now[i] = n.decay[i] * n.now[i] + n.kick[i] * take(n.tape)


def set_up_noise(n: NoiseRecord, rms: Vec3, time_s: Vec3, seed: int, purpose: str, step_s: float) -> Tape:
    """Initialise the record of correlated noise; top up the returned tape at least every 340 steps.

    ``rms``: standard deviation of each axis, all zero for no noise; ``time_s``: correlation times, s.
    """
    tape = Tape(seed, purpose, n.tape)
    n.on = any(axis > 0.0 for axis in rms)
    for i, (axis, time) in enumerate(zip(rms, time_s, strict=True)):
        decay = math.exp(-step_s / time)  # the discretisation is exact
        n.decay[i], n.kick[i] = decay, axis * math.sqrt(1.0 - decay**2)
        n.now[i] = axis * take(n.tape)  # first value from the stationary distribution
    return tape


class WindRecord(Record):
    """Wind at the vehicle, m/s, world ENU."""

    now: Vector
    steady: Vector  # mean wind, m/s ENU
    gust: NoiseRecord


@jitted
def blow(w: WindRecord) -> None:
    """Advance the gusts by one step, with three random numbers of their tape."""
    vary(w.gust)
    if w.gust.on:
        for i in range(3):
            w.now[i] = w.steady[i] + w.gust.now[i]


def set_up_wind(w: WindRecord, wind: Wind, shape: WindShape, seed: int, step_s: float) -> Tape:
    """Initialise the record; return the tape of the gusts (``set_up_noise``)."""
    drawn = stream(seed, "wind.direction").uniform(-math.pi, math.pi)
    direction = drawn if wind.direction_rad is None else wind.direction_rad
    w.steady[:] = wind.mean_m_s * math.cos(direction), wind.mean_m_s * math.sin(direction), 0.0
    rms_h, rms_v = wind.gust_rms_m_s, wind.gust_rms_m_s * shape.vertical_share
    times = (shape.horizontal_time_s, shape.horizontal_time_s, shape.vertical_time_s)
    tape = set_up_noise(w.gust, (rms_h, rms_h, rms_v), times, seed, "wind.gust", step_s)
    w.now[:] = w.steady + w.gust.now
    return tape


AIR_KG_M3 = 1.204  # air density at 20 degrees C and sea level
DECAY = 10.11  # factor in the velocity on the axis; DECAY, ORIGIN and SPREAD are from Bauersfeld et al.
ORIGIN = -5.817  # distance of the jet's virtual origin below the rotors, divided by l; negative: above them
SPREAD = 0.07668  # half width of the jet, divided by the distance from the virtual origin
NEAR = 2.5  # distance from the rotors at which the four wakes have merged, divided by l
EDGE = 4.0  # outer radius of the jet, in half widths; the velocity fades out from 3 to 4 half widths
PLATE_DRAG = 1.18  # drag coefficient of a flat plate across the flow
_NARROWS = math.sqrt(2.0) - 1.0

# columns of a jet: origin (m) and direction in the world (ENU), induced velocity in hover (m/s), size (m)
JET = 8


class DownwashRecord(Record):
    """Air velocity at a vehicle from other vehicles' jets; ``air`` and ``along`` are valid if ``on``."""

    on: bool
    air: Vector  # air velocity at the centre of mass, world ENU, m/s
    along: Motors  # air velocity along body z at the rotors, m/s
    loss: float  # thrust loss of each rotor divided by the air velocity, N s/m
    across: float  # rotor drag across body z divided by the air velocity, N s/m
    moment: float  # moment of the rotor drag about the centre of mass, N m per m/s
    plate: float  # drag of the body divided by the squared velocity, N s^2/m^2
    arm: float  # distance of the rotor axes from the centre along body x and y, m
    above: float  # height of the rotor plane above the centre of mass, m
    inertia: float  # 2 rho A of all rotors, kg/m; thrust = inertia * (induced velocity)^2
    span: float  # distance between two opposite motors, m


@jitted
def jet_speed(along_m: float, beside_m: float, hover_m_s: float, size_m: float) -> float:
    """Return the air velocity in a jet, m/s, from s, r, U_H and l (``size_m``) of the module's formula."""
    lengths = along_m / size_m
    if lengths <= 0.0:
        return 0.0
    grown = max(lengths, NEAR) - ORIGIN
    ratio = beside_m / (SPREAD * grown * size_m)
    if ratio >= EDGE:
        return 0.0
    fade = min(1.0, EDGE - ratio)
    profile = 1.0 / (1.0 + _NARROWS * ratio * ratio)
    begins = min(1.0, lengths)  # factor that makes the velocity continuous at the rotor plane
    return hover_m_s * DECAY / grown * profile * profile * fade * fade * (3.0 - 2.0 * fade) * begins


@jitted
def add_jet(jets: F64, number: int, x: float, y: float, z: float, air: F64) -> None:
    """Add the velocity of jet ``number`` at a position (ENU, m) to ``air`` (3,), m/s."""
    jet = jets[number]
    x, y, z = x - jet[0], y - jet[1], z - jet[2]
    along = x * jet[3] + y * jet[4] + z * jet[5]
    square = max(0.0, x * x + y * y + z * z - along * along)
    speed = jet_speed(along, math.sqrt(square), jet[6], jet[7])
    if speed > 0.0:
        for i in range(3):
            air[i] += speed * jet[3 + i]


@jitted
def set_jet(d: DownwashRecord, thrust_n: float, position: F64, axes: Nine, jet: F64) -> None:
    """Set the jet (JET,) of a vehicle from its total thrust, centre of mass (ENU, m) and body axes."""
    for i in range(3):
        jet[i] = position[i] + d.above * axes[6 + i]
        jet[3 + i] = -axes[6 + i]
    jet[6] = math.sqrt(max(0.0, thrust_n) / d.inertia)
    jet[7] = d.span


@jitted
def feel(d: DownwashRecord, jets: F64, own: int, position: F64, axes: Nine) -> None:
    """Sum the air velocities at vehicle ``own`` from the jets (N, JET) of all other vehicles."""
    d.on = False
    d.air[:] = 0.0
    d.along[:] = 0.0
    x, y, z, zx, zy, zz = position[0], position[1], position[2], axes[6], axes[7], axes[8]
    for number in range(len(jets)):
        if number == own:
            continue
        before_x, before_y, before_z = d.air[0], d.air[1], d.air[2]
        for i in range(4):
            a, b = POSITION_X[i] * d.arm, POSITION_Y[i] * d.arm
            d.air[:] = 0.0
            add_jet(
                jets,
                number,
                x + a * axes[0] + b * axes[3] + d.above * zx,
                y + a * axes[1] + b * axes[4] + d.above * zy,
                z + a * axes[2] + b * axes[5] + d.above * zz,
                d.air,
            )
            d.along[i] += d.air[0] * zx + d.air[1] * zy + d.air[2] * zz
        d.air[0], d.air[1], d.air[2] = before_x, before_y, before_z
        add_jet(jets, number, x, y, z, d.air)
    d.on = bool(d.air.any() or d.along.any())


@jitted
def press(d: DownwashRecord, axes: Nine, force: F64, torque: F64) -> None:
    """Add the effect of the jets to ``force`` (3,), world, N, and ``torque`` (3,), body, N m."""
    zx, zy, zz = axes[6], axes[7], axes[8]
    u, a = d.air, d.along
    along = u[0] * zx + u[1] * zy + u[2] * zz
    pushed = d.plate * math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    lost = d.loss * (a[0] + a[1] + a[2] + a[3]) - d.across * along
    force[0] += (d.across + pushed) * u[0] + lost * zx
    force[1] += (d.across + pushed) * u[1] + lost * zy
    force[2] += (d.across + pushed) * u[2] + lost * zz
    torque[0] += d.arm * d.loss * (a[2] + a[3] - a[0] - a[1])
    torque[1] += d.arm * d.loss * (a[1] + a[2] - a[0] - a[3])
    torque[0] -= d.moment * (u[0] * axes[3] + u[1] * axes[4] + u[2] * axes[5])
    torque[1] += d.moment * (u[0] * axes[0] + u[1] * axes[1] + u[2] * axes[2])


def set_up_downwash(d: DownwashRecord, body: Body, rotor: Rotor, geometry: Geometry) -> DownwashRecord:
    """Initialise the record of one vehicle, without jets."""
    half_x, half_y, _ = geometry.body_half_size_m
    d.on = False
    d.loss, d.across = 0.25 * body.drag_n_s_m[2], body.drag_n_s_m[0]
    d.moment = body.drag_above_com_m * body.drag_n_s_m[0]
    d.plate = 0.5 * AIR_KG_M3 * PLATE_DRAG * 4.0 * half_x * half_y
    d.arm, d.above, d.span = rotor.arm_m, rotor.above_com_m, 2.0 * math.sqrt(2.0) * rotor.arm_m
    d.inertia = 2.0 * AIR_KG_M3 * 4.0 * math.pi * rotor.radius_m**2
    return d
