"""Linear models of the control loops of the simulated vehicle, and poles of a measured response.

The models describe small motions about hover. The plant is integrated exactly over 2 ms with a constant
command; the firmware's difference equations close the loop. If motion capture corrects the estimate every
10 ms, the poles are those of this period. The parameters are those of ``crazyflie20.toml``, and the gains
are those of the firmware port.

    roll:       phi' = p,  J p' = M,  tau M' = M_c - M
    horizontal: x' = v,    m v' = m g theta - d v,  theta as roll
    vertical:   z' = v,    m v' = T - d v,          tau T' = T_c - T
    yaw:        psi' = r,  J r' = q W + I_p W',     tau W' = W_c - W

W is the difference of the speeds of the rotor pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from sim.firmware import geometric as att
from sim.firmware.estimator import ACCEL_XY_M_S2, ACCEL_Z_M_S2, axis_gains
from sim.firmware.geometric import K_V_N_S_M
from sim.plant.params import CONTROL_STEP_S, load

F64 = npt.NDArray[np.float64]
C128 = npt.NDArray[np.complex128]

PARAMS = load()
DT = CONTROL_STEP_S
G = PARAMS.contact.gravity_m_s2
MASS = PARAMS.body.mass_kg
N_PER_COUNT = PARAMS.rotor.thrust_max_n / 65535.0
TORQUE_PER_COUNT = 2.0 * PARAMS.rotor.arm_m * N_PER_COUNT  # torque of one count about roll or pitch, N m
HOVER_RPM = PARAMS.rotor.rpm(MASS * G / 4.0)
RAD_S_PER_RPM = 2.0 * math.pi / 60.0
GYRO_GAIN = -math.expm1(-DT * math.sqrt(2.0) * math.pi * PARAMS.imu.gyro_filter_hz)
ACCEL_GAIN = -math.expm1(-DT * math.sqrt(2.0) * math.pi * PARAMS.imu.accel_filter_hz)
MOCAP_PERIOD_S = 0.01
SAMPLES_MAX = 400  # maximum samples of a fitted response
STEPS_PER_SAMPLE = round(MOCAP_PERIOD_S / DT)


def slow_lag_s() -> float:
    """Return the time constant of a small torque, s: two motors speed up and two, more slowly, slow down."""
    fall = 2.0 * HOVER_RPM * PARAMS.rotor.slow_fall_1_rpm_s
    return 2.0 / (PARAMS.rotor.slow_rise_1_s + fall)


def held(a: F64, b: F64) -> tuple[F64, F64]:
    """Return the exact step of x' = a x + b u over 2 ms with constant u."""
    n = len(a)
    big = np.zeros((n + 1, n + 1))
    big[:n, :n], big[:n, n] = a, b
    e = expm(big * DT)
    return e[:n, :n], e[:n, n]


@dataclass(frozen=True)
class Loop:
    """A closed loop x -> step x + drive u every 2 ms, with ``correct`` before every fifth step if given."""

    step: F64
    drive: F64
    output: F64
    correct: F64 | None = None

    @property
    def period_s(self) -> float:
        """Time step of the matrix whose poles ``poles`` returns, s."""
        return DT if self.correct is None else MOCAP_PERIOD_S

    def poles(self) -> C128:
        """Return the poles in 1/s, slowest decay first; poles that decay within a period are left out."""
        matrix = self.step
        if self.correct is not None:
            matrix = np.linalg.matrix_power(self.step, STEPS_PER_SAMPLE) @ self.correct
        z = np.linalg.eigvals(matrix)
        s = np.log(z[np.abs(z) > 1e-6].astype(complex)) / self.period_s
        return s[np.argsort(-s.real)]

    def response(self, seconds: float, size: float = 1.0) -> F64:
        """Return the output after every step for a set-point step of ``size`` at time zero, from rest."""
        x = np.zeros(len(self.step))
        out = []
        for k in range(round(seconds / DT)):
            if self.correct is not None and k % STEPS_PER_SAMPLE == 0:
                x = self.correct @ x
            x = self.step @ x + self.drive * size
            out.append(float(self.output @ x))
        return np.array(out)


class Builder:
    """Builds a loop from linear updates, each of one state from the current states."""

    def __init__(self, names: str) -> None:
        self.index = {name: i for i, name in enumerate(names.split())}
        self.n = len(self.index)
        self.matrix = np.eye(self.n + 1)  # the last column belongs to the set-point

    def row(self, **terms: float) -> F64:
        """Convert a linear form of current states and set-point ``u`` to the states at the step's start."""
        form = np.zeros(self.n + 1)
        for name, factor in terms.items():
            form[self.n if name == "u" else self.index[name]] = factor
        return form @ self.matrix

    def set(self, name: str, value: F64) -> None:
        """Replace the update of a state by this linear form."""
        self.matrix[self.index[name]] = value

    def plant(self, states: str, a: F64, b: F64, command: F64) -> None:
        """Advance the continuous states with a held command."""
        f, g = held(a, b)
        rows = [self.index[s] for s in states.split()]
        self.matrix[rows] = f @ self.matrix[rows] + np.outer(g, command)

    def finish(self, output: str, correct: F64 | None = None) -> Loop:
        """Return the loop with this state as its output."""
        out = np.zeros(self.n)
        out[self.index[output]] = 1.0
        return Loop(self.matrix[: self.n, : self.n], self.matrix[: self.n, self.n], out, correct)


def gyro(b: Builder) -> None:
    """Add the filtered turn rate, and the attitude integrated from this rate."""
    b.set("before", b.row(rate=1.0))
    b.set("rate", b.row(rate=1.0 - GYRO_GAIN, p=GYRO_GAIN))
    b.set("angle", b.row(angle=1.0, rate=DT))


def tilt_command(b: Builder, **wanted: float) -> F64:
    """Return the commanded torque of the attitude loop; ``wanted``: desired tilt as a linear form."""
    stiff = 2.0 * att.K_R_XY * TORQUE_PER_COUNT  # the firmware's attitude error eR lacks the factor 1/2
    inertia = att.K_D_OMEGA_RP * TORQUE_PER_COUNT / DT
    damping = att.K_W_XY * TORQUE_PER_COUNT
    return (
        b.row(angle=-stiff, rate=-damping - inertia, before=inertia)
        + b.row(**{k: stiff * v for k, v in wanted.items()})
    )  # fmt: skip


def roll_loop(lag: float) -> Loop:
    """Return the loop of roll (or pitch) with the paper's K1, K2; set-point and output in rad."""
    b = Builder("phi p M rate before angle")
    gyro(b)
    jxx = PARAMS.body.inertia_kg_m2[0]
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / jxx], [0.0, 0.0, -1.0 / lag]])
    b.plant("phi p M", a, np.array([0.0, 0.0, 1.0 / lag]), tilt_command(b, u=1.0))
    return b.finish("phi")


def yaw_loop(lag: float, reaction: bool = True) -> Loop:
    """Return the loop of yaw with the paper's K1, K2, with or without the rotors' spin-up torque."""
    r = PARAMS.rotor
    b = Builder("psi p W rate before angle sum")
    gyro(b)
    b.set("sum", b.row(sum=1.0, angle=-2.0 * DT, u=2.0 * DT))
    counts = b.row(angle=-2.0 * att.K_R_Z, u=2.0 * att.K_R_Z, rate=-att.K_W_Z, sum=att.K_I_Z)
    wanted = counts * N_PER_COUNT / (r.thrust_linear_n_rpm + 2.0 * r.thrust_square_n_rpm2 * HOVER_RPM)
    drag = 4.0 * (r.torque_linear_n_m_rpm + 2.0 * r.torque_square_n_m_rpm2 * HOVER_RPM)
    spin = 4.0 * r.inertia_kg_m2 * RAD_S_PER_RPM if reaction else 0.0
    jzz = PARAMS.body.inertia_kg_m2[2]
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, (drag - spin / lag) / jzz], [0.0, 0.0, -1.0 / lag]])
    b.plant("psi p W", a, np.array([0.0, spin / lag / jzz, 1.0 / lag]), wanted)
    return b.finish("psi")


def correction(b: Builder, gains: tuple[float, float, float], states: tuple[str, str, str, str]) -> F64:
    """Return how a motion-capture sample corrects the estimate of one axis as a matrix over its states."""
    matrix = np.eye(b.n)
    true, position, *_ = states
    for gain, name in zip(gains, states[1:], strict=True):
        matrix[b.index[name], b.index[true]] += gain
        matrix[b.index[name], b.index[position]] -= gain
    return matrix


def horizontal_loop(lag: float, k_v: float = K_V_N_S_M) -> Loop:
    """Return the paper's loop of east velocity, eq. 8, through estimator and attitude loop; m/s."""
    b = Builder("x v phi p M rate before angle felt last xe ve")
    gyro(b)
    new = b.row(felt=1.0 - ACCEL_GAIN, v=ACCEL_GAIN / DT, last=-ACCEL_GAIN / DT, phi=-ACCEL_GAIN * G)
    b.set("felt", new)
    b.set("last", b.row(v=1.0))
    change = b.row(felt=DT, angle=G * DT)
    b.set("xe", b.row(xe=1.0, ve=DT) + 0.5 * DT * change)
    b.set("ve", b.row(ve=1.0) + change)
    share = k_v / (MASS * G)
    jyy, drag = PARAMS.body.inertia_kg_m2[1], PARAMS.body.drag_n_s_m[0] / MASS
    a = np.zeros((5, 5))
    a[0, 1], a[1, 1], a[1, 2], a[2, 3], a[3, 4], a[4, 4] = 1.0, -drag, G, 1.0, 1.0 / jyy, -1.0 / lag
    command = tilt_command(b, u=share, ve=-share)
    b.plant("x v phi p M", a, np.array([0.0, 0.0, 0.0, 0.0, 1.0 / lag]), command)
    kp, kv, accel = axis_gains(MOCAP_PERIOD_S, ACCEL_XY_M_S2, G)
    return b.finish("v", correction(b, (kp, kv, accel / G), ("x", "xe", "ve", "angle")))


def vertical_loop(lag: float, k_v: float = K_V_N_S_M) -> Loop:
    """Return the paper's loop of upward velocity; m/s."""
    b = Builder("z v T felt last ze ve bias")
    b.set("felt", b.row(felt=1.0 - ACCEL_GAIN, v=ACCEL_GAIN / DT, last=-ACCEL_GAIN / DT))
    b.set("last", b.row(v=1.0))
    change = b.row(felt=DT, bias=DT)
    b.set("ze", b.row(ze=1.0, ve=DT) + 0.5 * DT * change)
    b.set("ve", b.row(ve=1.0) + change)
    drag = PARAMS.body.drag_n_s_m[2] / MASS
    a = np.array([[0.0, 1.0, 0.0], [0.0, -drag, 1.0 / MASS], [0.0, 0.0, -1.0 / lag]])
    b.plant("z v T", a, np.array([0.0, 0.0, 1.0 / lag]), b.row(u=k_v, ve=-k_v))
    gains = axis_gains(MOCAP_PERIOD_S, ACCEL_Z_M_S2, G)
    return b.finish("v", correction(b, gains, ("z", "ze", "ve", "bias")))


def prony_poles(y: F64, step_s: float, order: int) -> C128:
    """Return the poles of a response that has settled at its last value, 1/s; the slowest decay is first.

    Singular values of the Hankel matrix (matrix pencil): ``order`` exponentials by least squares.
    """
    stride = 1 + len(y) // SAMPLES_MAX
    d = (y - y[-1])[::stride]
    half = len(d) // 2
    hankel = np.lib.stride_tricks.sliding_window_view(d, half)[: len(d) - half + 1]
    u, _, _ = np.linalg.svd(hankel.T, full_matrices=False)
    u = u[:, :order]
    z = np.linalg.eigvals(np.linalg.lstsq(u[:-1], u[1:], rcond=None)[0])
    s = np.log(z.astype(complex)) / (step_s * stride)
    return s[np.argsort(-s.real)]
