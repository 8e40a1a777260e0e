"""What each step allows, by the profile of the vehicle's autopilot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType

from bridge.mavlink.profiles.autopilots import ARDUPILOT, CRAZYFLIE, OWN_SITL, PX4


class Lost(Enum):
    """What the vehicle does by itself once no set-point comes any more."""

    LANDS = "lands and stops its motors"
    STOPS = "holds still, armed, until somebody lands it"


@dataclass(frozen=True)
class Limits:
    """Limits of the steps for one autopilot.

    Attributes:
        settle_s: time at zero velocity before anything is judged.
        still_m_s: speed below which it holds still.
        drift_m: distance that it may move in five seconds of zero velocity.
        step_m_s: speed of the step to the north and back.
        step_s: time of each of the two.
        moved_share: least and greatest way of the step, as a share of speed times time.
        lost: what it does without set-points.
        lost_s: time until it shows that.
    """

    settle_s: float
    still_m_s: float
    drift_m: float
    step_m_s: float
    step_s: float
    moved_share: tuple[float, float]
    lost: Lost
    lost_s: float


_OWN = Limits(
    settle_s=3.0, still_m_s=0.15, drift_m=0.3,
    # a velocity lag T makes the share 1 - 1.5 T / step_s: lags below 0.8 s
    step_m_s=0.3, step_s=2.0, moved_share=(0.4, 1.2),
    lost=Lost.LANDS, lost_s=2.0,  # COM_OF_LOSS_T = 0.5 s, and its heartbeat once a second
)  # fmt: skip

# PX4 holds velocity, not place: a change of force by 1 N on 1 kg moves it 1 / MPC_XY_VEL_I_ACC = 2.5 m in the
# end, half of that within 3 s. tests/unit/suite/test_suite_limits.py flies it 2000 times in wind of 0.5 m/s
# with gusts of 0.2 m/s, which push PX4's own quadrotor of 1 kg by 1 N for each m/s (SIH_KDV). Of 1000 flights
# 999 drift by less than 0.8 m, are slower than 0.23 m/s at zero velocity, and move 0.36 to 0.73 of the step.
_PX4 = Limits(
    settle_s=5.0, still_m_s=0.3, drift_m=1.0,
    step_m_s=0.5, step_s=3.0, moved_share=(0.25, 1.0),
    lost=Lost.LANDS, lost_s=2.5,  # COM_OF_LOSS_T = 1.0 s, checked at 10 Hz; heartbeat once a second
)  # fmt: skip

LIMITS: Mapping[str, Limits] = MappingProxyType(
    {
        OWN_SITL.name: _OWN,
        CRAZYFLIE.name: replace(_OWN, lost_s=3.5),  # its firmware stops the motors after 2 s
        PX4.name: _PX4,
        ARDUPILOT.name: replace(_OWN, lost=Lost.STOPS, lost_s=2.5),  # GUID_TIMEOUT, at most 1 s, and 1.5 s
    }
)
