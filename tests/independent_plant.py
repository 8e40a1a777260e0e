"""A second model of the vehicle in free flight, written from the equations, without code of ``sim``.

Rigid body and four rotors with vertical shafts, angular momentum balance of the whole:

    m dv/dt = T z_B - D (v - wind) - m g e_3,   D = diag(d) along the body axes
    J dw/dt = M_arms + M_drag - dh/dt - w x (J w + h),   h = e_3 sum(I_p s_i Omega_i)

with s_i = +1 for a rotor that turns counter-clockwise seen from above. The drag of the air on such a rotor
acts clockwise, on the rotor and through the motor on the body. Speeds follow their commands with the
first-order or the slow lag. Parameters and geometry are from the L250 identification (drone-models
0.1.0). The integration error is far below the compared differences.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

G = 9.81  # gravity, m/s^2
MASS = 0.0319  # vehicle mass, kg
INERTIA = np.array([16.8e-6, 16.8e-6, 29.8e-6])  # moments of inertia, body axes, kg m^2
DRAG = np.array([0.0147, 0.0147, 0.0128])  # drag coefficients along the body axes, N s/m
ARM = 0.03253  # distance of a rotor from the centre along x and along y, m
ROTOR_XY = ARM * np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]])  # M1 front right, then clockwise from above
SPIN = np.array([1, -1, 1, -1])  # sense of rotation; M1 and M3 turn counter-clockwise
THRUST = np.array([2.4583e-10, -5.382e-7, 0.0])  # thrust of a rotor, N: coefficients of rpm^2, rpm, 1
TORQUE = np.array([1.4593e-12, 1.4105e-9, 0.0])  # drag torque of a rotor, N m: coefficients of rpm^2, rpm, 1
ROTOR_INERTIA = 34.5e-9  # moment of inertia of one rotor, kg m^2
RAD_S = 2.0 * np.pi / 60.0


@dataclass(frozen=True)
class Lag:
    """Lag of the motors: of first order with ``time_s``, or with ``rise_1_s`` times the difference of the
    speeds for a rise and ``fall_1_rpm_s`` times the difference of their squares for a fall."""

    time_s: float = 0.07
    rise_1_s: float | None = None
    fall_1_rpm_s: float = 0.0

    def rate(self, rpm, command):
        if self.rise_1_s is None:
            return (command - rpm) / self.time_s
        return np.where(
            command > rpm, self.rise_1_s * (command - rpm), self.fall_1_rpm_s * (command**2 - rpm**2)
        )


SLOW = Lag(rise_1_s=7.3556, fall_1_rpm_s=2.4444e-4)


def rotation(q):
    """Return the rotation matrix, body to world, of a quaternion w, x, y, z."""
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def derivative(state, command, lag, drag, wind):
    """Return the derivative of the 17 states: position, velocity, quaternion, body rates, rotor speeds."""
    v, q, w, rpm = state[3:6], state[6:10], state[10:13], state[13:]
    r = rotation(q / np.linalg.norm(q))
    thrusts, speed_rate = np.polyval(THRUST, rpm), lag.rate(rpm, command)
    force = r @ (np.array([0, 0, thrusts.sum()]) - drag * (r.T @ (v - wind)))
    arms = np.array([ROTOR_XY[:, 1] @ thrusts, -ROTOR_XY[:, 0] @ thrusts, 0.0])
    air = np.array([0, 0, -SPIN @ np.polyval(TORQUE, rpm)])
    h = np.array([0, 0, ROTOR_INERTIA * RAD_S * (SPIN @ rpm)])
    h_rate = np.array([0, 0, ROTOR_INERTIA * RAD_S * (SPIN @ speed_rate)])
    w_rate = (arms + air - h_rate - np.cross(w, INERTIA * w + h)) / INERTIA
    q_rate = 0.5 * np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])
    return np.concatenate([v, force / MASS - (0, 0, G), q_rate, w_rate, speed_rate])


def fly(state, commands, hold_s, lag=None, drag=DRAG, wind=(0.0, 0.0, 0.0)):
    """Integrate rotor commands (n, 4), each constant for ``hold_s``; return the state after each, (n, 17)."""
    out = []
    for command in np.asarray(commands, float):
        solved = solve_ivp(
            lambda _, s, c=command: derivative(s, c, lag or Lag(), drag, np.asarray(wind)),
            (0.0, hold_s),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-12,
        )
        state = solved.y[:, -1]
        out.append(state)
    return np.array(out)
