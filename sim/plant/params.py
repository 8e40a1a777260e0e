"""Parameters of a simulated vehicle, read from its TOML file, and their random spread."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Annotated

from flightstack.common.strict_toml import ConfigError, from_table, span
from flightstack.core.types import Vec3
from sim.chance import stream
from sim.scenarios.tables import VEHICLE_FILES, VehicleSpec

Four = tuple[float, float, float, float]

STEP_S = 0.001  # time step of the physics, s
CONTROL_STEP_S = 0.002  # period of the control loops, s; firmware stabilizer_types.h: ATTITUDE_RATE 500 Hz


@dataclass(frozen=True, slots=True)
class Body:
    """Rigid body of the vehicle.

    The drag acts at the point ``drag_above_com_m`` above the centre of mass, along body z. A roll or pitch
    rate w causes the torque -``rate_damping_n_m_s`` w, because a rotor that moves down has more thrust.
    """

    mass_kg: float
    inertia_kg_m2: Vec3
    drag_n_s_m: Vec3
    drag_above_com_m: float = 0.0
    rate_damping_n_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Rotor:
    """Parameters of a motor with its propeller.

    ``volt_map``: the firmware's map from mean motor voltage V to counts. The sum of volt_map[k] V^k is the
    fraction of full counts. The duty cycle is V divided by the battery voltage; a low battery saturates it.
    None: the map is exact, counts are linear in thrust, and the battery limits only the speed.
    """

    arm_m: float
    above_com_m: float
    radius_m: float
    thrust_linear_n_rpm: float
    thrust_square_n_rpm2: float
    torque_linear_n_m_rpm: float
    torque_square_n_m_rpm2: float
    inertia_kg_m2: float
    thrust_max_n: float
    thrust_min_n: float
    lag_s: float
    slow_rise_1_s: float
    slow_fall_1_rpm_s: float
    volt_map: Four | None = None

    def thrust_n(self, rpm: float) -> float:
        """Return the static thrust of one rotor, N."""
        return max(0.0, (self.thrust_linear_n_rpm + self.thrust_square_n_rpm2 * rpm) * rpm)

    def rpm(self, thrust_n: float) -> float:
        """Return the rotor speed, rpm, for a static thrust (inverse of ``thrust_n``); no thrust gives 0."""
        if thrust_n <= 0.0:
            return 0.0
        a, b = self.thrust_square_n_rpm2, self.thrust_linear_n_rpm
        return float((-b + (b * b + 4.0 * a * thrust_n) ** 0.5) / (2.0 * a))


@dataclass(frozen=True, slots=True)
class Battery:
    """LiPo cell with a linear discharge curve and an internal resistance."""

    charge_a_s: float
    full_v: float
    empty_v: float
    resistance_ohm: float
    idle_current_a: float
    hover_current_a: float
    speed_at_zero_v_rpm: float
    speed_per_volt_rpm: float

    def speed_rpm(self, motor_v: float) -> float:
        """Return the steady rotor speed, rpm, for a mean voltage at the motor."""
        return self.speed_at_zero_v_rpm + self.speed_per_volt_rpm * motor_v

    def motor_v(self, speed_rpm: float) -> float:
        """Return the mean voltage at the motor for a steady speed (inverse of ``speed_rpm``)."""
        return (speed_rpm - self.speed_at_zero_v_rpm) / self.speed_per_volt_rpm

    @property
    def hover_sag_v(self) -> float:
        """Voltage drop under the load of hover, V."""
        return self.resistance_ohm * (self.idle_current_a + self.hover_current_a)

    def hover_duty(self, speed_rpm: float, voltage_v: float) -> float:
        """Return the duty cycle at a speed near hover; ``voltage_v``: battery voltage under hover load, V."""
        return (self.motor_v(speed_rpm) + self.hover_sag_v) / (voltage_v + self.hover_sag_v)


@dataclass(frozen=True, slots=True)
class Geometry:
    """Contact shapes of the vehicle, in the body frame."""

    foot_offset_m: float
    foot_radius_m: float
    foot_bottom_m: float
    body_half_size_m: Vec3
    body_centre_z_m: float
    propeller_half_thickness_m: float


@dataclass(frozen=True, slots=True)
class Robot:
    """Contact shapes of the ground robot."""

    body_length_m: float
    body_width_m: float
    body_height_m: float
    ground_clearance_m: float
    body_centre_behind_axle_m: float
    lidar_radius_m: float
    lidar_top_m: float
    pad_thickness_m: float
    wheel_half_track_m: float


@dataclass(frozen=True, slots=True)
class Contact:
    friction: float
    time_constant_s: float
    gravity_m_s2: float


@dataclass(frozen=True, slots=True)
class Imu:
    """Noise densities (one-sided), biases (standard deviation over vehicles) and filters of the IMU."""

    gyro_noise_rad_s_sqrthz: float
    gyro_bias_rad_s: float
    gyro_filter_hz: float
    accel_noise_m_s2_sqrthz: float
    accel_bias_m_s2: float
    accel_filter_hz: float


@dataclass(frozen=True, slots=True)
class WindShape:
    """Correlation times of gusts, and ratio of vertical to horizontal gusts."""

    horizontal_time_s: float
    vertical_time_s: float
    vertical_share: float


@dataclass(frozen=True, slots=True)
class TorqueNoiseShape:
    """Standard deviations and correlation times of the torque noise about body x, y, z; zero by default."""

    rms_n_m: Vec3 = (0.0, 0.0, 0.0)
    time_s: Vec3 = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class VelocityGains:
    """Gains of the PID loop from velocity to tilt (degrees) and to thrust (thousands of counts).

    Defaults: Crazyflie firmware, platform_defaults_cf2.h, PID_VEL_X and PID_VEL_Z. The other fields model an
    autopilot that filters attitude commands: a later horizontal response and a different steady velocity.
    """

    xy_p: float = 25.0
    xy_i: float = 1.0
    z_p: float = 25.0
    z_i: float = 15.0
    xy_dead_time_s: Annotated[float, span(0.0, 0.6)] = 0.0  # dead time from set-point to velocity error, s
    tilt_time_s: Annotated[float, span(0.0, 1.0)] = 0.0  # time constant of the tilt command's low-pass, s
    # ratio of the loop's target velocity to the set-point
    xy_response: Annotated[float, span(0.5, 3.0)] = 1.0


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of a vehicle's file."""

    body: Body
    rotor: Rotor
    battery: Battery
    geometry: Geometry
    robot: Robot
    contact: Contact
    imu: Imu
    wind: WindShape
    velocity_gains: VelocityGains = field(default_factory=VelocityGains)
    torque_noise: TorqueNoiseShape = field(default_factory=TorqueNoiseShape)


@dataclass(frozen=True, slots=True)
class Plant:
    """Ratios of this vehicle's parameters to the nominal parameters, which the firmware uses."""

    mass: float = 1.0
    motor_lag: float = 1.0
    thrust: float = 1.0
    motors: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)  # thrust of M1..M4; the mean is 1
    battery_charge: float = 1.0  # state of charge at the start, 0 to 1

    @classmethod
    def draw(cls, spec: VehicleSpec, seed: int) -> Plant:
        """Draw the ratios from uniform distributions with the scenario's half-widths and ranges."""
        draws = stream(seed, "plant")
        mass, lag, thrust = draws.uniform(-1.0, 1.0, 3).tolist()
        motors = 1.0 + spec.motor_spread * draws.uniform(-1.0, 1.0, 4)
        m1, m2, m3, m4 = (motors / motors.mean()).tolist()
        return cls(
            1.0 + spec.mass_spread * mass,
            1.0 + spec.motor_lag_spread * lag,
            1.0 + spec.thrust_spread * thrust,
            (m1, m2, m3, m4),
            float(draws.uniform(*spec.battery_charge)),
        )


def able_to_hover(plant: Plant, params: Params, reserve: float) -> Plant:
    """Raise the charge, up to full, until each motor can lift ``reserve`` times a quarter of the weight."""
    battery, rotor = params.battery, params.rotor
    thrust_n = 0.25 * reserve * params.body.mass_kg * plant.mass * params.contact.gravity_m_s2 / plant.thrust
    most_v = max(battery.motor_v(rotor.rpm(thrust_n / motor)) for motor in plant.motors)
    current_a = battery.idle_current_a + battery.hover_current_a * reserve**1.5
    rest_v = most_v + battery.resistance_ohm * current_a
    charge = min(1.0, (rest_v - battery.empty_v) / (battery.full_v - battery.empty_v))
    return replace(plant, battery_charge=max(plant.battery_charge, charge))


@cache
def load(airframe: str = "crazyflie20") -> Params:
    """Read a vehicle's file by name or path. Raises ConfigError: no such file, or a wrong key."""
    path = VEHICLE_FILES.path_of(airframe)
    try:
        return from_table(Params, VEHICLE_FILES.table(path))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
