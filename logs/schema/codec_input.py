"""CDR packers for what a controller is given and what it remembers: ``ControllerInput``, ``ControllerState``.

Every number goes in and comes out bit by bit, so that a replay decides what the flight decided.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import NamedTuple

from flightstack.core.types import Inputs, Landed, Mode, Operator, OwnState, TargetSample, VehicleStatus

_CDR = b"\x00\x01\x00\x00"  # plain CDR, little-endian
_NS = 1_000_000_000  # nanoseconds in a second
_MAP = b"map\x00"
_TICK = struct.Struct("<4siII4sQ")  # encapsulation, stamp, frame "map", tick
_INPUT = struct.Struct("<4siII4sQd8B10dI")  # up to the number of samples; ends four bytes off alignment
_SAMPLE = struct.Struct("<12d")
_U32 = struct.Struct("<I")
_NO_STATUS = (0, 0, 0, 0, 0.0)
_NO_OWN = (0.0,) * 9


class ControllerInputRow(NamedTuple):
    """One tick's inputs as ``Controller.step`` takes them."""

    stamp_ns: int
    tick: int
    now_s: float
    inputs: Inputs
    command_failed: bool


class ControllerStateRow(NamedTuple):
    """One snapshot; fields as in ``ControllerState.msg``."""

    stamp_ns: int
    tick: int
    layout: str
    state: str


def pack_controller_input(
    stamp_ns: int, tick: int, now_s: float, inputs: Inputs, command_failed: bool
) -> bytes:
    """Return the inputs of a tick as CDR.

    Raises:
        struct.error: A number out of the range of its field.
    """
    own, status, samples = inputs.own, inputs.status, inputs.target_samples
    head = _INPUT.pack(
        _CDR, stamp_ns // _NS, stamp_ns % _NS, 4, _MAP, tick, now_s,
        inputs.operator, command_failed, own is not None, status is not None,
        *((status.armed, status.mode, status.landed, status.ready_to_arm, status.arrival_s)
          if status is not None else _NO_STATUS),
        *((own.arrival_s, own.source_time_s, *own.position_enu_m, *own.velocity_enu_m_s, own.yaw_rad)
          if own is not None else _NO_OWN),
        len(samples),
    )  # fmt: skip
    if not samples:
        return head
    parts = [head]
    off = 4  # bytes past a multiple of eight
    for s in samples:
        parts += (
            _names(s.frame_id, s.child_frame_id, off),
            _SAMPLE.pack(
                s.arrival_s, s.source_time_s, *s.position_enu_m, *s.velocity_enu_m_s, s.yaw_rad,
                s.yaw_rate_rad_s, s.position_sigma_m, s.velocity_sigma_m_s,
            ),
        )  # fmt: skip
        off = 0
    return b"".join(parts)


def unpack_controller_input(data: bytes) -> ControllerInputRow:
    """Return the inputs in a CDR payload of :func:`pack_controller_input`.

    Raises:
        ValueError: Cut short, too long, or with a value that is not in its table.
    """
    f = _checked(_INPUT, data, "ControllerInput")
    operator, failed, own_there, status_there, armed, mode, landed, ready = f[7:15]
    own = OwnState(f[16], f[17], f[18:21], f[21:24], f[24]) if own_there else None
    status = (
        VehicleStatus(f[15], bool(armed), Mode(mode), Landed(landed), bool(ready)) if status_there else None
    )
    at, samples = _INPUT.size, []
    try:
        for _ in range(f[25]):
            frame_id, at = _string(data, at)
            child_frame_id, at = _string(data, at)
            at = _aligned(at, 8)
            n = _SAMPLE.unpack_from(data, at)
            at += _SAMPLE.size
            samples.append(TargetSample(n[0], n[1], frame_id, child_frame_id, n[2:5], n[5:8], *n[8:]))
    except struct.error as error:
        raise ValueError(f"ControllerInput of {len(data)} bytes is cut short: {error}") from error
    if at != len(data):
        raise ValueError(f"ControllerInput of {len(data)} bytes, of which {len(data) - at} mean nothing")
    inputs = Inputs(own, status, tuple(samples), Operator(operator))
    return ControllerInputRow(f[1] * _NS + f[2], f[5], f[6], inputs, bool(failed))


def pack_controller_state(stamp_ns: int, tick: int, layout: str, state: str) -> bytes:
    """Return a snapshot as CDR."""
    data = _TICK.pack(_CDR, stamp_ns // _NS, stamp_ns % _NS, 4, _MAP, tick)
    for text in (layout, state):
        raw = text.encode() + b"\x00"
        data += bytes(-len(data) % 4) + _U32.pack(len(raw)) + raw
    return data


def unpack_controller_state(data: bytes) -> ControllerStateRow:
    """Return the snapshot in a CDR payload of :func:`pack_controller_state`.

    Raises:
        ValueError: Cut short or not such a message.
    """
    f = _checked(_TICK, data, "ControllerState")
    try:
        layout, at = _string(data, _TICK.size)
        state, at = _string(data, at)
    except struct.error as error:
        raise ValueError(f"ControllerState of {len(data)} bytes is cut short: {error}") from error
    if at != len(data):
        raise ValueError(f"ControllerState of {len(data)} bytes, of which {len(data) - at} mean nothing")
    return ControllerStateRow(f[1] * _NS + f[2], f[5], layout, state)


@lru_cache(maxsize=64)
def _names(frame_id: str, child_frame_id: str, off: int) -> bytes:
    """Both strings, padded for the doubles that follow; ``off`` is where they begin, past a multiple of 8."""
    out = bytes(off)
    for text in (frame_id, child_frame_id):
        raw = text.encode() + b"\x00"
        out += bytes(-len(out) % 4) + _U32.pack(len(raw)) + raw
    return out[off:] + bytes(-len(out) % 8)


def _string(data: bytes, at: int) -> tuple[str, int]:
    """The string at ``at`` or after its padding, and the offset behind it."""
    at = _aligned(at, 4)
    (length,) = _U32.unpack_from(data, at)
    raw = data[at + 4 : at + 4 + length]
    if length < 1 or len(raw) != length or raw[-1:] != b"\x00":
        raise ValueError(f"text of {length} bytes at byte {at} of {len(data)} is cut short or has no end")
    return raw[:-1].decode(), at + 4 + length


def _aligned(at: int, size: int) -> int:
    """Next multiple of ``size``, counted from the end of the CDR header."""
    return at + (len(_CDR) - at) % size


def _checked(layout: struct.Struct, data: bytes, name: str) -> tuple:  # type: ignore[type-arg]
    if len(data) < layout.size or data[:4] != _CDR or data[12:20] != b"\x04\x00\x00\x00" + _MAP:
        raise ValueError(
            f"not a {name} of this stack: {len(data)} bytes beginning with {bytes(data[:20]).hex()}; "
            f"expected at least {layout.size} bytes, little-endian CDR, frame 'map'"
        )
    return layout.unpack_from(data)
