"""What the vehicles of a fleet tell each other, as rows of the log: the neighbours that a tick was given.

Every number goes in and comes out bit by bit, so that a replay decides what the flight decided.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flightstack.common.pacing import Tick
from flightstack.core.types import ZERO, Intent, Neighbour
from logs.schema.rows import ControllerNeighboursRow


def pack_neighbours(tick: Tick, neighbours: Sequence[Neighbour]) -> bytes:
    """Return the words that a tick was given as CDR of ``ControllerNeighbours``.

    Args:
        tick: its number and time are noted.
        neighbours: in the order in which the controller took them.

    Raises:
        struct.error: a number out of the range of its field.
        ValueError: an id in ``yields_to`` that is not in 0 to 255.
    """
    return ControllerNeighboursRow(tick.unix_ns, tick.number, tuple(map(_values, neighbours))).pack()


def unpack_neighbours(data: bytes) -> tuple[Neighbour, ...]:
    """Return the words in a CDR payload of :func:`pack_neighbours`.

    Raises:
        ValueError: cut short, too long, or with an intent that is none.
    """
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
