"""Each two members of a fleet over time, by their true states: distances, and whether both flew."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from logs.reader.flight_data import Bools, Fleet, Flight, Floats
from logs.schema.events import ContactBit
from logs.verdict.types import RADIUS_ABOVE_M, RADIUS_BESIDE_M


class PairSeries(NamedTuple):
    """Two members over time, by their true states; (n,) each."""

    name: str  # both members, for example cf1–cf2
    t_s: Floats  # seconds since the origin of the fleet
    one_m: Floats  # (n, 3) position of the first
    other_m: Floats  # (n, 3) position of the second
    distance_m: Floats  # distance of the centres of mass
    measure: Floats  # distance in the ellipsoid's measure, 1 on its surface
    flying: Bools  # whether both flew


def shift_s(fleet: Fleet, flight: Flight) -> float:
    """What to add to the times of a member, to count from the origin of the fleet."""
    return (flight.origin_ns - fleet.origin_ns) * 1e-9


def pair_series(fleet: Fleet) -> list[PairSeries]:
    """Distances of all pairs whose true states are in the log, where both are."""
    found = []
    for (a, one), (b, other) in combinations(fleet.flights.items(), 2):
        if one.truth is None or other.truth is None:
            continue
        t_s, to_s = one.truth.t_s + shift_s(fleet, one), other.truth.t_s + shift_s(fleet, other)
        both = (t_s >= to_s[0]) & (t_s <= to_s[-1])
        if not both.any():
            continue
        t_s = t_s[both]
        there_m = np.column_stack([np.interp(t_s, to_s, column) for column in other.truth.position_enu_m.T])
        here_m = one.truth.position_enu_m[both]
        apart_m = here_m - there_m
        beside, above = 2.0 * RADIUS_BESIDE_M, 2.0 * RADIUS_ABOVE_M
        measure = np.sqrt(
            (apart_m[:, 0] ** 2 + apart_m[:, 1] ** 2) / beside**2 + (apart_m[:, 2] / above) ** 2
        )
        nearest = np.clip(np.searchsorted(to_s, t_s), 0, len(to_s) - 1)
        flying = _flying(one)[both] & _flying(other)[nearest]
        distance_m = np.linalg.norm(apart_m, axis=1)
        found.append(PairSeries(f"{a}–{b}", t_s, here_m, there_m, distance_m, measure, flying))
    return found


def _flying(flight: Flight) -> Bools:
    assert flight.truth is not None
    rests = flight.truth.contacts & int(ContactBit.PAD | ContactBit.GROUND)
    return np.asarray(flight.truth.motors_running & (rests == 0))
