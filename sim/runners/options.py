"""Options of the simulator's processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from flightstack.common.options import Option
from flightstack.config import options as shared


@dataclass(frozen=True, kw_only=True)
class VehicleOptions(shared.Signing, shared.Zenoh, shared.Simulated):
    """The simulated vehicle. Without Zenoh the deck stands where the scenario puts it."""

    url: shared.Url = "udpin:127.0.0.1:14580"
    peers: shared.Peers = ()
    parameters: Annotated[Mapping[str, float], Option(
        "--parameter", "Parameter of the autopilot, set before it starts; repeatable.", "NAME=VALUE",
        read=shared.numbers
    )] = field(default_factory=dict)  # fmt: skip
    rate_hz: shared.Rate = 100
    lockstep: shared.Lockstep = False
    duration_s: shared.Duration = None
    namespace: shared.Namespace = "cf1"
    recorder: shared.Recorder = None
    system_id: shared.SystemId = 1
    member: shared.OneMember = None
    leave_out: Annotated[tuple[int, ...], Option(
        "--leave-out", "Member of a team that is not simulated here, by its number; repeatable.", "N",
        span=(1, None)
    )] = ()  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TargetOptions(shared.Ros2, shared.Zenoh, shared.Simulated):
    """The simulated ground robot."""

    rate_hz: shared.Rate = 100
    lockstep: shared.Lockstep = False
    speed: shared.Speed = 1.0
    clock: shared.Clock = None
    duration_s: shared.Duration = None
    namespace: shared.Namespace = "cf1"
    recorder: shared.Recorder = None
