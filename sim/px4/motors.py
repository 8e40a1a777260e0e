"""PX4's motor outputs to rotor speeds of the simulated vehicle. Pure.

PX4 numbers the motors of its quad X otherwise than the Crazyflie: 1 front right, 2 rear left (both
counter-clockwise), 3 front left, 4 rear right (both clockwise), seen from above; airframe 10016_none_iris,
CA_ROTOR0 to 3. Spin and place agree with M1, M3, M4 and M2 here (``sim/plant/rotors.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim.plant.params import Rotor
from sim.plant.rotors import Four

PX4_OF_M = (0, 3, 1, 2)  # which of PX4's outputs drives M1..M4
OFF: Four = (0.0, 0.0, 0.0, 0.0)


def share(control: float) -> float:
    """Output within 0 to 1; PX4 sends NaN for a motor that is off, and what is not a number stops it here."""
    return min(1.0, max(0.0, control)) if math.isfinite(control) else 0.0


def rotor_speeds(controls: Sequence[float], armed: bool, rotor: Rotor) -> Four:
    """Speeds wanted of M1..M4, rpm.

    An output is a share of the highest thrust, as PX4's allocation means it with THR_MDL_FAC = 0; below the
    smallest thrust a motor stops. So the vehicle's own map gives the speed, the same as for the simulated
    firmware.

    Args:
        controls: HIL_ACTUATOR_CONTROLS.controls, at least four, in PX4's order.
        armed: unless so, all motors are off.
        rotor: nominal map of thrust.
    """
    if not armed:
        return OFF
    thrusts = (share(controls[i]) * rotor.thrust_max_n for i in PX4_OF_M)
    m1, m2, m3, m4 = (rotor.rpm(t) if t >= rotor.thrust_min_n else 0.0 for t in thrusts)
    return (m1, m2, m3, m4)
