"""A flight as numpy arrays: decisions of the controller, true states, received samples and events.

Times are seconds since the first recorded step or true state (``t_s``), from the log time, which all
processes of a run share. Frames are ENU, units metres and radians. Missing data are ``None``, and a number
that is unknown at a tick is NaN; no value is ever replaced by zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from flightstack.common.strict_toml import from_table, parse_toml
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Intent, Phase
from logs.schema.rows import ControllerStepColumns, FleetPairRow, LoopTimingColumns, TrueStateColumns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
PAD_RADIUS_M = 0.10  # pad radius, m, if the log contains neither metadata of the run nor a configuration
ATTACHMENT = "onboard.toml"  # name of the configuration in the log


class Steps(ControllerStepColumns):
    """The n controller steps; vectors are (n, 3). The fields are those of ``ControllerStep.msg``."""

    @cached_property
    def both_valid(self) -> Bools:
        """Whether the states of both vehicle and target were valid, with finite positions, (n,)."""
        finite = np.isfinite(self.own_position_enu_m).all(1) & np.isfinite(self.target_position_enu_m).all(1)
        return self.own_valid & self.target_valid & finite

    @cached_property
    def e_m(self) -> Floats:
        """Estimated position relative to the landing spot, m, (n, 3); NaN unless both states were valid."""
        return np.where(
            self.both_valid[:, None], self.own_position_enu_m - self.target_position_enu_m, np.nan
        )

    @cached_property
    def d_m(self) -> Floats:
        """Estimated horizontal distance to the landing spot, m, (n,); NaN unless both states were valid."""
        return np.hypot(self.e_m[:, 0], self.e_m[:, 1])

    @cached_property
    def relative_velocity_m_s(self) -> Floats:
        """Estimated velocity relative to the landing spot, m/s, (n, 3); NaN unless both states were valid."""
        velocity_m_s = self.own_velocity_enu_m_s - self.target_velocity_enu_m_s
        return np.where(self.both_valid[:, None], velocity_m_s, np.nan)


class Truth(TrueStateColumns):
    """The simulator's n true states; vectors are (n, 3). The fields are those of ``TrueState.msg``."""

    @cached_property
    def e_m(self) -> Floats:
        """True position relative to the landing spot, m, (n, 3)."""
        return self.position_enu_m - self.pad_position_enu_m

    @cached_property
    def d_m(self) -> Floats:
        """True horizontal distance to the landing spot, m, (n,)."""
        return np.hypot(self.e_m[:, 0], self.e_m[:, 1])

    @cached_property
    def relative_velocity_m_s(self) -> Floats:
        """True velocity relative to the rotating pad's surface below the vehicle, m/s, (n, 3)."""
        turn_rad_s = _rate(np.unwrap(self.pad_yaw_rad), self.t_s)
        carried = np.column_stack(
            (-turn_rad_s * self.e_m[:, 1], turn_rad_s * self.e_m[:, 0], np.zeros(len(self.t_s)))
        )
        return self.velocity_enu_m_s - self.pad_velocity_enu_m_s - carried


class Timing(LoopTimingColumns):
    """Wall-clock timing of the loop in n ticks, s. The fields are those of ``LoopTiming.msg``."""


@dataclass(frozen=True)
class TargetOdometry:
    """All n received samples of the target odometry, including those that the controller rejected."""

    t_s: Floats  # arrival times, s, (n,)
    stamp_ns: Ints  # measurement times on the sender's clock, ns, (n,)
    position_enu_m: Floats  # position of the centre of the pad's top, m, (n, 3)
    velocity_child_m_s: Floats  # velocity in the robot's frame, as sent, m/s, (n, 3)


@dataclass(frozen=True)
class Event:
    t_s: float
    level: int
    source: str
    text: str


class Span(NamedTuple):
    """An interval in which all messages of a vehicle to the other members had the same content."""

    begin_s: float  # time of the first message, s
    end_s: float  # time of the first message with other content, or of the last message, s
    intent: Intent  # intent that the vehicle announced
    gives_way_to: tuple[str, ...]  # names of the members to which the vehicle gives way

    @property
    def waits(self) -> bool:
        """Whether the vehicle flew and gave way to a neighbour."""
        return self.intent is Intent.WAITING and bool(self.gives_way_to)


class JudgedSteps(Protocol):
    """Fields of the controller steps that are needed for a verdict by true states."""

    @property
    def t_s(self) -> Floats: ...

    @property
    def phase(self) -> Ints: ...


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Data that are needed for a verdict by true states, from a log or from a landing in a campaign."""

    steps: JudgedSteps | None = None  # controller steps; ``None``: there are none
    truth: Truth | None = None  # true states; ``None``: there are none
    events: tuple[Event, ...] = ()  # events of /rosout in order of time
    config: FlightConfig | None = None  # configuration of the onboard process; ``None`` if not in the log
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # metadata records by name
    complete: bool = True  # whether the recorder closed the file and every byte could be read
    pad_radius_m: float = PAD_RADIUS_M

    def began_s(self, phase: Phase) -> float | None:
        """Return the time of the first controller step in a phase; None: there is no such step."""
        if self.steps is None:
            return None
        begun = np.flatnonzero(self.steps.phase == phase)
        return float(self.steps.t_s[begun[0]]) if len(begun) else None

    @cached_property
    def landing_start_s(self) -> float | None:
        """Time of the first controller step in phase APPROACH: the landing and its verdict start there."""
        return self.began_s(Phase.APPROACH)


@dataclass(frozen=True, kw_only=True)
class Flight(Judged):
    """All data of one flight in a log."""

    path: Path  # log file
    origin_ns: int  # log time at ``t_s = 0``, ns
    duration_s: float  # time from the first to the last step or true state, s
    # descriptions of unreadable parts of the log, and the reason why its configuration cannot be read
    problems: tuple[str, ...] = ()
    steps: Steps | None = None
    timing: Timing | None = None
    target: TargetOdometry | None = None
    spans: tuple[Span, ...] = ()  # status messages to the other members, in order of time; empty: none
    attachments: dict[str, bytes] = field(default_factory=dict)  # files stored in the log, by name
    barrier: Barrier | None = None  # barrier of the verdict; ``None``: not in the log
    member: str = ""  # name of the vehicle in the log; empty for a flight without a log
    pad_carries: bool = True  # whether the vehicle can stand on the pad; False: the physics has no pad

    def phase_spans(self) -> list[tuple[Phase | int, float, float]]:
        """Return the phases in order, each with its start time and its end time, s."""
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
    """All flights of a log, or one flight of it."""

    path: Path  # log file
    flights: dict[str, Flight]  # flights by member; the times of each flight start at its ``origin_ns``
    pairs: dict[tuple[int, int], FleetPairRow]  # newest simulator record of each pair of ids
    ids: dict[int, str]  # members by vehicle id, which is also the MAVLink system id
    # events of /rosout in order, with times since ``origin_ns``; in a fleet, sources start with a member name
    events: tuple[Event, ...]
    metadata: dict[str, dict[str, str]]  # metadata records that belong to all members, by name
    attachments: dict[str, bytes]  # attachments that belong to all members, by name

    @property
    def origin_ns(self) -> int:
        """Log time of the first step or true state of any member."""
        return min(flight.origin_ns for flight in self.flights.values())

    @property
    def landing_start_s(self) -> float | None:
        """Start of the earliest landing of any member, s; None: no landing started."""
        starts_s = [
            flight.landing_start_s + self.shift_s(flight)
            for flight in self.flights.values()
            if flight.landing_start_s is not None
        ]
        return min(starts_s, default=None)

    def shift_s(self, flight: Flight) -> float:
        """Return the offset that converts the times of a member to the origin of the fleet, s."""
        return (flight.origin_ns - self.origin_ns) * 1e-9


def phase_name(phase: int) -> str:
    """Return the name of a phase; a phase unknown to this version is shown as a number."""
    return Phase(phase).name if phase in Phase._value2member_map_ else f"phase {phase}"


def _phase(number: int) -> Phase | int:
    """Return the phase, or its number if this version does not know it."""
    return Phase(number) if number in Phase._value2member_map_ else number


def _rate(values: Floats, t_s: Floats) -> Floats:
    """Return the time derivative of values, (n,); NaN at repeated times, or with fewer than two values."""
    if len(t_s) < 2:
        return np.full(len(t_s), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.gradient(values, t_s)


def read_config(data: bytes) -> FlightConfig:
    return from_table(FlightConfig, parse_toml(data))


class Sizes(NamedTuple):
    barrier: Barrier | None  # barrier of the flight; None: unknown
    pad_radius_m: float
    # horizontal and vertical semi-axis, m, of the ellipsoid that separates two vehicles; None: no neighbours
    ellipsoid_m: tuple[float, float] | None = None


def sizes_of(config: FlightConfig | None, run: Mapping[str, str]) -> Sizes:
    """Return barrier, pad radius and separation ellipsoid of a flight.

    The metadata of a simulated run contain the pad radius.
    """
    radius_m = number(run, "pad_radius_m")
    if config is None:
        return Sizes(None, PAD_RADIUS_M if radius_m is None else radius_m)
    fleet = config.fleet
    ellipsoid_m = (fleet.radius_xy_m, fleet.radius_z_m) if fleet.others else None
    radius_m = config.touchdown.pad_radius_m if radius_m is None else radius_m
    return Sizes(config.barrier, radius_m, ellipsoid_m)


def number(values: Mapping[str, str], key: str) -> float | None:
    """Return a value of the metadata as a number; None: it is missing or is not a number."""
    try:
        return float(values[key])
    except (KeyError, ValueError):
        return None
