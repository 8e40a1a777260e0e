"""Messages between the vehicles of a fleet on the wire, and the neighbours that a tick used.

Every number of the neighbours goes in and comes out bit by bit: a replay decides what the flight decided.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from flightstack.common.pacing import Tick
from flightstack.core.types import ZERO, Intent, Neighbour
from logs.schema.rows import ControllerNeighboursRow, FleetWordRow


def pack_neighbours(tick: Tick, neighbours: Sequence[Neighbour]) -> bytes:
    """Return the messages that a tick used as CDR of ``ControllerNeighbours``."""
    return ControllerNeighboursRow(tick.unix_ns, tick.number, tuple(map(_values, neighbours))).pack()


def unpack_neighbours(data: bytes) -> tuple[Neighbour, ...]:
    """Return the messages in a CDR payload of :func:`pack_neighbours`."""
    return tuple([_neighbour(values) for values in ControllerNeighboursRow.unpack(data).neighbours])


def _values(word: Neighbour) -> tuple[Any, ...]:
    pad, speed = word.pad_position_enu_m, word.pad_velocity_enu_m_s
    return (
        *word[: Neighbour._fields.index("pad_position_enu_m")],
        pad is not None,
        pad if pad is not None else ZERO,
        speed is not None,
        speed if speed is not None else ZERO,
        bytes(word.yields_to),
    )


def _neighbour(values: tuple[Any, ...]) -> Neighbour:
    *told, pad_known, pad, speed_known, speed, yields_to = values
    pads = (pad if pad_known else None, speed if speed_known else None)
    word = Neighbour._make((*told, *pads, tuple(yields_to)))
    return word._replace(intent=Intent(word.intent))


class Echo(NamedTuple):
    """Clock information about another member; fields as in ``FleetEcho.msg``."""

    id: int
    process: int
    arrival_ns: int


def word_row(word: Neighbour, epoch_ns: int, process: int, echoes: Sequence[Echo] = ()) -> FleetWordRow:
    """Return a vehicle's message to its neighbours; ``epoch_ns``: Unix time of stack time 0."""
    pad, claims = word.pad_position_enu_m, not math.isnan(word.claim_s)
    return FleetWordRow(
        epoch_ns + round(word.stamp_s * 1e9),
        word.id,
        process,
        word.position_enu_m,
        word.velocity_enu_m_s,
        word.wanted_enu_m_s,
        word.position_sigma_m,
        word.intent,
        claims,
        epoch_ns + round(word.claim_s * 1e9) if claims else 0,
        pad is not None,
        pad if pad is not None else ZERO,
        word.pad_velocity_enu_m_s or ZERO,
        bytes(word.yields_to),
        tuple(echoes),
    )


def neighbour_of(
    row: FleetWordRow, stamp_s: float, arrival_s: float, claim_s: float, clock_bound_s: float
) -> Neighbour:
    """Return another vehicle's message with its times on our stack clock; a claim of NaN is none."""
    return Neighbour(
        row.id,
        stamp_s,
        arrival_s,
        row.position_enu_m,
        row.velocity_enu_m_s,
        row.wanted_enu_m_s,
        row.position_sigma_m,
        clock_bound_s,
        Intent(row.intent),
        claim_s,
        row.pad_position_enu_m if row.pad_known else None,
        row.pad_velocity_enu_m_s if row.pad_known else None,
        tuple(row.yields_to),
    )
