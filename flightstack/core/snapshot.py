"""Snapshot of one tick: the newest inputs, checks of their age, and the vehicle relative to the target."""

from __future__ import annotations

from typing import NamedTuple

from flightstack.core.fleet.precedence import ALONE, Permissions
from flightstack.core.numeric import hypot, numeric
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.target.track import TargetState
from flightstack.core.types import Charge, Inputs, OwnState, Vec3

FUTURE_MAX_S = 0.05  # maximum time of a vehicle state ahead of the stack's clock, s


@numeric
class Relative(NamedTuple):
    """Vehicle state relative to the target; it exists only if both states are available."""

    own: OwnState
    target: TargetState
    e_m: Vec3  # position of the vehicle minus landing spot, ENU, m
    d_m: float  # horizontal length of ``e_m``, m

    @property
    def slip_m_s(self) -> tuple[float, float]:
        """Horizontal velocity of the vehicle minus that of the target, ENU, m/s."""
        v, t = self.own.velocity_enu_m_s, self.target.velocity_enu_m_s
        return v[0] - t[0], v[1] - t[1]


def relative(own: OwnState, target: TargetState) -> Relative:
    """Return the states of vehicle and target with their offset and horizontal distance."""
    (x, y, z), (px, py, pz) = own.position_enu_m, target.position_enu_m
    e_m = (x - px, y - py, z - pz)
    return Relative(own, target, e_m, hypot(e_m[0], e_m[1]))


class Snapshot(NamedTuple):
    """Inputs of one tick, with the results of the checks of their age."""

    inputs: Inputs  # inputs as received, but with the vehicle state predicted to the current time
    target: TargetState | None  # target state predicted to the current time; ``None`` before the first sample
    own_ok: bool  # whether the vehicle state is plausible and recent
    target_ok: bool  # whether the target state is plausible and recent
    link_ok: bool  # whether the heartbeat is recent
    relative: Relative | None  # vehicle relative to target; ``None`` unless both are known
    follows: bool = True  # whether the vehicle follows the commanded velocity
    charge: Charge = Charge.FIT  # state of the battery; FIT without a table [reserve]
    permissions: Permissions = ALONE  # permissions by the fleet; a single vehicle has all of them
    # whether the velocity of ``target`` comes from positions, because the reported velocity is not trusted
    target_placed: bool = False

    @property
    def good(self) -> bool:
        """Whether vehicle state, link and target state are all usable."""
        return self.own_ok and self.link_ok and self.target_ok

    @property
    def e_m(self) -> Vec3 | None:
        """Position of the vehicle minus that of the landing spot, ENU, m; ``None`` unless both are known."""
        return self.relative.e_m if self.relative is not None else None


def snapshot_of(
    config: FlightConfig, inputs: Inputs, target: TargetState | None, now_s: float, *, trusted: bool = True,
    follows: bool = True, charge: Charge = Charge.FIT, permissions: Permissions = ALONE,
    target_trusted: bool = True,
) -> Snapshot:  # fmt: skip
    """Return the inputs of this tick with the results of the checks of their age."""
    checks, own, status = config.checks, inputs.own, inputs.status
    own_ok = trusted and own is not None and -FUTURE_MAX_S <= now_s - own.arrival_s <= checks.own_age_max_s
    target_fresh = target is not None and target.age_s <= checks.target_age_max_s
    link_ok = status is not None and now_s - status.arrival_s <= checks.status_age_max_s
    at = relative(own, target) if own is not None and target is not None else None
    target_ok, placed = target_fresh and target_trusted, target_fresh and not target_trusted
    return Snapshot(inputs, target, own_ok, target_ok, link_ok, at, follows, charge, permissions, placed)
