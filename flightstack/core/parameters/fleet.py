"""Parameters of a fleet: members, the ellipsoid between two vehicles, and bounds of the members' motion.

The ellipsoid of two Crazyflies has the semi-axes 0.25 and 0.75 m: each Crazyflie has the radii 0.125 and
0.375 m that Crazyswarm sets for the firmware's collision avoidance. The larger height covers downwash.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from flightstack.common.strict_toml import ConfigError, span

ID_MAX = 250
OTHERS_MAX = 8  # maximum number of other members; each can add a constraint to the program
PART_OF_LAG = 0.25  # maximum rate_1_s * velocity loop lag; below it h of two vehicles does not overshoot
# time for which a yielding vehicle takes the whole share after its last announcement, in latencies
HOLD_LATENCIES = 3.0
ZERO_LATENCIES = 2.0  # time for which a neighbour relies on ``yields_to``, in latencies
DECIDE_LATENCIES = 4.0  # time until the higher id yields if two members both claim to be first, in latencies
CARRIED_AGES = 2.2  # ratio of a silent vehicle's extrapolation time to ``age_max_s``
KEPT_PART = 0.2  # ratio of the horizon of a vehicle with the right of way to ``descent_s``
CIRCLE_LATENCIES = 8.0  # time until a cycle is broken, in latencies times (1 + number of higher ids)


@dataclass(frozen=True, slots=True)
class Fleet:
    """This vehicle and the other members of its fleet; without this table the vehicle is alone."""

    id: Annotated[int, span(1, ID_MAX)]  # id of this member
    members: tuple[Annotated[int, span(1, ID_MAX)], ...]  # ids of all members, including this one
    radius_xy_m: Annotated[float, span(0.05, 10.0)] = 0.25  # horizontal semi-axis of the ellipsoid
    radius_z_m: Annotated[float, span(0.05, 10.0)] = 0.75  # vertical semi-axis of the ellipsoid
    rate_1_s: Annotated[float, span(0.05, 10.0)] = 0.8  # allowed decay rate of h between two vehicles
    margin_m: Annotated[float, span(0.0, 5.0)] = 0.08  # margin for velocity errors of both vehicles
    sigma_factor: Annotated[float, span(0.0, 6.0)] = 3.0  # number of covered standard deviations of positions
    speed_max_m_s: Annotated[float, span(0.05, 20.0)] = 1.0  # maximum speed of another vehicle
    # maximum acceleration of another vehicle, and of the velocity command of this other vehicle
    acceleration_max_m_s2: Annotated[float, span(0.05, 20.0)] = 3.0
    # maximum horizontal acceleration of the commanded velocity; a Crazyflie can follow 2.1 m/s^2
    slew_xy_max_m_s2: Annotated[float, span(0.05, 20.0)] = 2.0
    reach_m: Annotated[float, span(0.2, 200.0)] = 3.0  # distance within which a member adds a constraint
    age_max_s: Annotated[float, span(0.05, 5.0)] = 0.5  # message age above which a vehicle is silent
    latency_max_s: Annotated[float, span(0.01, 1.0)] = 0.15  # maximum latency of a message
    silent_flight_s: Annotated[float, span(0.1, 60.0)] = 6.0  # time after which a silent vehicle has landed
    # maximum wait for the right of way before an abort
    wait_max_s: Annotated[float, span(1.0, 3600.0)] = 30.0
    # distance between pads below which only one vehicle lands at a time
    pad_distance_m: Annotated[float, span(0.1, 50.0)] = 0.8
    descent_s: Annotated[float, span(0.0, 60.0)] = 5.0  # horizon for the predicted distance of two pads
    # horizontal distance of the waiting place from the pad
    wait_distance_m: Annotated[float, span(0.1, 50.0)] = 1.2
    wait_height_m: Annotated[float, span(0.1, 50.0)] = 1.0  # height of the waiting place above the pad
    # whether a landed vehicle takes off again for a member that waits for its pad, and lands beside the pad
    frees_pad: bool = False

    @property
    def others(self) -> tuple[int, ...]:
        """Ids of the other members, in ascending order."""
        return tuple(sorted(set(self.members) - {self.id}))

    @property
    def flat(self) -> float:
        """Ratio of the ellipsoid's horizontal semi-axis to its vertical one."""
        return self.radius_xy_m / self.radius_z_m

    @property
    def growth_m_s(self) -> float:
        """Growth rate of the ellipsoid around a neighbour whose message has the maximum latency, m/s."""
        return self.acceleration_max_m_s2 * self.latency_max_s

    @property
    def slew_side_max_m_s2(self) -> float:
        """Maximum acceleration of the command on each horizontal axis, m/s^2; infinite without neighbours."""
        return self.slew_xy_max_m_s2 / math.sqrt(2.0) if self.others else math.inf

    def check(self, lag_s: float, period_s: float, clearance_m: float) -> None:
        """Reject members or limits that contradict each other, the velocity loop, the tick or the retreat."""
        members = f"fleet.members: found {list(self.members)}"
        if len(set(self.members)) != len(self.members) or self.id not in self.members:
            raise ConfigError(f"{members}; each once is needed, and id {self.id}")
        if not self.others:  # the other keys do not act
            return
        if len(self.others) > OTHERS_MAX:
            raise ConfigError(
                f"fleet.members: found {len(self.members)}, allowed are 1 to {OTHERS_MAX + 1}: as many "
                "others as the program has rows"
            )
        brakes_m = self.radius_xy_m + self.margin_m + 2.0 * self.speed_max_m_s / self.rate_1_s
        relies_s = max(ZERO_LATENCIES, HOLD_LATENCIES) * self.latency_max_s
        for key, least, why in (
            ("reach_m", brakes_m, "two vehicles of speed_max_m_s that meet brake from there"),
            ("age_max_s", relies_s, f"{HOLD_LATENCIES:g} latency_max_s"),
            ("pad_distance_m", 2.0 * self.radius_xy_m, "2 radius_xy_m between two vehicles that both land"),
            ("wait_distance_m", self.pad_distance_m, "a wait leaves pad_distance_m free"),
            ("wait_distance_m", clearance_m * self.frees_pad, "checks.clearance_m, with frees_pad"),
            ("latency_max_s", period_s, "a message is at least one tick late"),
        ):
            if (found := getattr(self, key)) < least:
                unit = key.rpartition("_")[2]
                raise ConfigError(
                    f"fleet.{key}: found {found:g}; at least {least:.3g} {unit} is needed: {why}"
                )
        if self.rate_1_s * lag_s > PART_OF_LAG:
            raise ConfigError(
                f"fleet.rate_1_s: found {self.rate_1_s:g}; with a lag of {lag_s:g} s at most "
                f"{PART_OF_LAG / lag_s:.3g} 1/s come to rest without an overshoot: lower it"
            )


ALONE = Fleet(id=1, members=(1,))  # a vehicle without neighbours
