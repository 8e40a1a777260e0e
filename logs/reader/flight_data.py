"""A flight as numpy arrays: decisions of the controller, true states, received samples and events.

Time is seconds since the first recorded step or true state (``t_s``), taken from the log time, which all
processes of a run share. Frames are ENU, metres, radians. What the log does not hold is ``None``, and a
number that was not known at a tick is NaN; nothing is ever filled with zeros.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flightstack.common.strict_toml import from_table, parse_toml
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Phase, Vec3
from logs.schema.rows import ControllerStepColumns, FleetPairRow, LoopTimingColumns, TrueStateColumns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
PAD_RADIUS_M = 0.10  # m, a Crazyflie's pad, where the log holds neither a run nor a configuration
ATTACHMENT = "onboard.toml"  # name in the log


class Steps(ControllerStepColumns):
    """Controller steps, n of them; vectors are (n, 3). Fields as in ``ControllerStep.msg``."""

    @cached_property
    def both_valid(self) -> Bools:
        """(n,) whether own and target state were present, fresh and finite."""
        finite = np.isfinite(self.own_position_enu_m).all(1) & np.isfinite(self.target_position_enu_m).all(1)
        return self.own_valid & self.target_valid & finite

    @cached_property
    def e_m(self) -> Floats:
        """(n, 3) estimated position relative to the landing spot, m; NaN where not both were valid."""
        return np.where(
            self.both_valid[:, None], self.own_position_enu_m - self.target_position_enu_m, np.nan
        )

    @cached_property
    def d_m(self) -> Floats:
        """(n,) estimated horizontal distance to the landing spot, m; NaN where not both were valid."""
        return np.hypot(self.e_m[:, 0], self.e_m[:, 1])

    @cached_property
    def relative_velocity_m_s(self) -> Floats:
        """(n, 3) estimated velocity relative to the landing spot, m/s; NaN where not both were valid."""
        velocity_m_s = self.own_velocity_enu_m_s - self.target_velocity_enu_m_s
        return np.where(self.both_valid[:, None], velocity_m_s, np.nan)


class Truth(TrueStateColumns):
    """The simulator's true states, n of them; vectors are (n, 3). Fields as in ``TrueState.msg``."""

    @cached_property
    def e_m(self) -> Floats:
        """(n, 3) true position relative to the landing spot, m."""
        return self.position_enu_m - self.pad_position_enu_m

    @cached_property
    def d_m(self) -> Floats:
        """(n,) true horizontal distance to the landing spot, m."""
        return np.hypot(self.e_m[:, 0], self.e_m[:, 1])

    @cached_property
    def relative_velocity_m_s(self) -> Floats:
        """(n, 3) velocity relative to the pad's surface below the vehicle, its turning included, m/s."""
        turn_rad_s = _rate(np.unwrap(self.pad_yaw_rad), self.t_s)
        carried = np.column_stack(
            (-turn_rad_s * self.e_m[:, 1], turn_rad_s * self.e_m[:, 0], np.zeros(len(self.t_s)))
        )
        return self.velocity_enu_m_s - self.pad_velocity_enu_m_s - carried


class Timing(LoopTimingColumns):
    """Wall-clock behaviour of the loop, n ticks. Fields as in ``LoopTiming.msg``, seconds."""


@dataclass(frozen=True)
class TargetOdometry:
    """Target odometry as it was received, n samples, accepted by the controller or not."""

    t_s: Floats  # (n,) arrival times
    stamp_ns: Ints  # (n,) measurement time, sender's clock
    position_enu_m: Floats  # (n, 3) centre of the pad's top
    velocity_child_m_s: Floats  # (n, 3) in the frame of the robot, as sent
    frame_id: list[str]  # n names, usually "map"


@dataclass(frozen=True)
class Event:
    t_s: float
    level: int
    source: str
    text: str


@dataclass(frozen=True)
class Flight:
    """Everything one log holds about one flight.

    Attributes:
        path: the log.
        member: of the fleet whose log it is, None in the log of one flight.
        complete: whether the recorder closed the file and every byte could be read.
        damage: parts of the log that could not be read, as text; empty for a good one.
        problems: the same, and a configuration of another version.
        origin_ns: log time of ``t_s = 0``.
        duration_s: from the first to the last step or true state.
        steps, timing, truth, target: ``None`` where the log has no such messages.
        events: /rosout in order.
        metadata: metadata records by name.
        attachments: files kept in the log by name.
        config: configuration the onboard process flew with, ``None`` if the log does not hold it.
        barrier: the one to judge by, ``None`` if the log does not say.
        velocity_max_m_s: box of the filter, m/s, ``None`` if the log does not say.
        pad_radius_m: of the landing pad.
        pad_carries: whether the vehicle's physics has a pad that it can stand on; the log says where not.
    """

    path: Path
    origin_ns: int
    duration_s: float
    complete: bool = True
    damage: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    steps: Steps | None = None
    timing: Timing | None = None
    truth: Truth | None = None
    target: TargetOdometry | None = None
    events: tuple[Event, ...] = ()
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    config: FlightConfig | None = None
    barrier: Barrier | None = None
    velocity_max_m_s: Vec3 | None = None
    pad_radius_m: float = PAD_RADIUS_M
    member: str | None = None
    pad_carries: bool = True

    @cached_property
    def landing_start_s(self) -> float | None:
        """Time of the first controller step in phase APPROACH: the landing and its judging begin."""
        if self.steps is None:
            return None
        begun = np.flatnonzero(self.steps.phase == Phase.APPROACH)
        return float(self.steps.t_s[begun[0]]) if len(begun) else None

    def phase_spans(self) -> list[tuple[Phase | int, float, float]]:
        """Phases in order, each with its first time and the time the next one began, seconds."""
        if self.steps is None:
            return []
        phase, t_s = self.steps.phase, self.steps.t_s
        starts = np.concatenate(([0], np.flatnonzero(np.diff(phase)) + 1))
        ends = np.append(t_s[starts[1:]], t_s[-1])
        return [
            (_phase(int(phase[i])), float(t_s[i]), float(end)) for i, end in zip(starts, ends, strict=True)
        ]


@dataclass(frozen=True)
class Fleet:
    """The flights of a fleet, from one log."""

    path: Path  # the log
    flights: dict[str, Flight]  # by member; each on its own time, which begins at its ``origin_ns``
    pairs: dict[tuple[int, int], FleetPairRow]  # newest simulator record of each pair of ids
    ids: dict[int, str]  # members by the ids of their vehicles, which are their MAVLink system ids
    # /rosout in order, times since ``origin_ns``; sources have the member's namespace in front
    events: tuple[Event, ...]
    metadata: dict[str, dict[str, str]]  # metadata records that belong to no single member, by name
    attachments: dict[str, bytes]  # attachments that belong to no single member, by name

    @property
    def origin_ns(self) -> int:
        """Log time of the first step or true state of any member."""
        return min(flight.origin_ns for flight in self.flights.values())

    def shift_s(self, flight: Flight) -> float:
        """Offset that converts the times of a member to the origin of the fleet, s."""
        return (flight.origin_ns - self.origin_ns) * 1e-9


def phase_name(phase: int) -> str:
    """Name of a phase; a phase that this version does not know is shown as a number."""
    return Phase(phase).name if phase in Phase._value2member_map_ else f"phase {phase}"


def _phase(number: int) -> Phase | int:
    """The phase, or its number if a newer stack wrote an unknown one."""
    return Phase(number) if number in Phase._value2member_map_ else number


def _rate(values: Floats, t_s: Floats) -> Floats:
    """Time derivative; NaN where there are too few or repeated times."""
    if len(t_s) < 2:
        return np.full(len(t_s), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.gradient(values, t_s)


def read_config(data: bytes) -> FlightConfig:
    """Read the attachment."""
    return from_table(FlightConfig, parse_toml(data))


def shape(config: FlightConfig) -> dict[str, str]:
    """Barrier and pad under the names that the metadata of a simulated run have, m and 1/m.

    Of a fleet also the semi-axes of the ellipsoid of two vehicles.
    """
    barrier, fleet = config.barrier.build(), config.fleet
    found = {
        "barrier_alpha_1_m": repr(barrier.alpha_1_m),
        "barrier_beta_m": repr(barrier.beta_m),
        "pad_radius_m": repr(config.touchdown.pad_radius_m),
    }
    if fleet is not None:
        found |= {"ellipsoid_xy_m": repr(fleet.radius_xy_m), "ellipsoid_z_m": repr(fleet.radius_z_m)}
    return found
