"""What a recorder derives from which channel, while it records."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Mapping
from typing import NamedTuple

from flightstack.common.strict_toml import ConfigError
from logs.derive.derive import STEP_SUFFIX, Derived, Deriver
from logs.derive.diagnostics import FrameCounter, Health
from logs.reader.flight_data import ATTACHMENT, read_config, shape
from logs.schema.codec_mavlink import PEER_CHARACTERS, FrameError
from logs.schema.mavlink_types import Type, of
from logs.schema.rows import ControllerStepRow, LoopTimingRow
from logs.schema.schemas import CONTROLLER_STEP, LOOP_TIMING, MAVLINK

TOPICS_MAX = 512  # bound on topics, since a sender can invent system ids
_HEADER_BYTES = 20  # encapsulation, stamp, frame_id of three characters: the fields begin aligned to 8
_NOBODY = struct.pack("<I", PEER_CHARACTERS + 1) + b"p--\x00"  # frame_id of a frame whose peer is not known
# Offsets in the raw record of ``codec_mavlink``.
_FIXED_AT, _FIXED_NOBODY_AT = 20, 17  # of framing_status, with and without the name of a peer
_LENGTH, _SENDER = 2, 6  # behind that: payload length; system and component
_ID_AT = 28  # message id
_WORDS_END, _PAYLOAD_AT = 40, 44


class Decoded(NamedTuple):
    """Where messages of one kind and sender go."""

    topic: str
    type: Type


class FrameDecoder:
    """Turns records of raw frames into messages of named fields."""

    def __init__(self, topic: str) -> None:
        """Take the topic of the raw frames; its first part is the name space until the run gives one."""
        self._space = "/" + topic.strip("/").partition("/")[0]
        self._known: dict[bytes, Decoded | None] = {}

    def configure(self, onboard: Mapping[str, str]) -> None:
        """Take the name space from the metadata of the onboard process."""
        if "namespace" in onboard:
            self._space = "/" + onboard["namespace"].strip("/")
            self._known.clear()

    def step(self, log_time_ns: int, payload: bytes) -> list[tuple[str, str, bytes]]:
        """Return (topic, schema, CDR) of one record of :func:`logs.schema.codec_mavlink.pack_mavlink`.

        Raises:
            FrameError: The record is cut short.
        """
        del log_time_ns
        if len(payload) < _WORDS_END:
            raise FrameError(f"frame record of {len(payload)} bytes is cut short")
        named = payload[12] == PEER_CHARACTERS + 1
        at = _FIXED_AT if named else _FIXED_NOBODY_AT
        key = payload[at + _SENDER : at + _SENDER + 2] + payload[_ID_AT : _ID_AT + 4]
        known = self._known.get(key)
        if known is None:
            if key in self._known:
                return []
            known = self._meet(key)
            if known is None:
                return []
        length, kind = payload[at + _LENGTH], known.type
        body = payload[_PAYLOAD_AT : _PAYLOAD_AT + min(length, kind.size)]
        head = payload[:_HEADER_BYTES] if named else payload[:12] + _NOBODY
        if kind.verbatim:
            return [(known.topic, kind.schema, head + body.ljust(kind.size, b"\x00"))]
        return [(known.topic, kind.schema, head + repacked(kind, body.ljust(kind.size, b"\x00")))]

    def _meet(self, key: bytes) -> Decoded | None:
        """Give a new sender or message its topic; None for one the dialect does not have."""
        system, component, number = struct.unpack("<BBI", key)
        kind = of(number)
        found = None
        if len(self._known) < TOPICS_MAX:
            if kind is not None:
                topic = f"{self._space}/mavlink/sys{system}/comp{component}/{kind.message}"
                found = Decoded(topic, kind)
            self._known[key] = found
        return found


def repacked(kind: Type, payload: bytes) -> bytes:
    """Return a payload with text, or with fields that CDR aligns otherwise, as the body behind a header."""
    out = bytearray()
    at = 0
    for field in kind.fields:
        size = field.size * max(1, field.array)
        raw = payload[at : at + size]
        at += size
        if field.kind == "string":
            text = raw.partition(b"\x00")[0].decode("utf-8", "replace").encode() + b"\x00"
            out += bytes(-len(out) % 4) + struct.pack("<I", len(text)) + text
        else:
            out += bytes(-len(out) % field.size) + raw  # both sides are little-endian
    return bytes(out)


TIMING_SUFFIX = "/loop/timing"
SOURCE_SUFFIX = "/mavlink_source"  # frames from the vehicle; the others are to it

Derive = Callable[[int, bytes], list[Derived]]  # log time in ns, CDR -> messages


class Derivers:
    """Derivations of all clients of one recorder, by topic: a client that comes again continues."""

    def __init__(self) -> None:
        self._run: dict[str, str] = {}
        self._shape: dict[str, str] = {}  # of barrier and pad, by the configuration
        self._onboard: dict[str, str] = {}
        self._steps: dict[str, Deriver] = {}
        self._frames: dict[str, _Frames] = {}
        self._health: dict[str, Health] = {}

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Take what the metadata of the run and of the onboard process say.

        Raises:
            ValueError: A value that is not a number.
        """
        if name == "run":
            self._run.update(values)
            for deriver in self._steps.values():
                deriver.configure(self._run, self._shape)
        elif name == "onboard":
            self._onboard.update(values)
            for frames in self._frames.values():
                self._configure(frames)

    def attachment(self, name: str, data: bytes) -> None:
        """Take barrier and pad from the configuration, for a flight without metadata of a run."""
        if name != ATTACHMENT:
            return
        with contextlib.suppress(ConfigError):  # of another version: barrier and pad are not drawn by it
            self._shape = shape(read_config(data))
        for deriver in self._steps.values():
            deriver.configure(self._run, self._shape)

    def declare(self, topic: str, schema: str) -> Derive | None:
        """Return what to call with each message of a channel; None: nothing is derived from it."""
        if schema == CONTROLLER_STEP:
            if topic not in self._steps:
                self._steps[topic] = Deriver(topic, self._health_of(topic.removesuffix(STEP_SUFFIX)))
                self._steps[topic].configure(self._run, self._shape)
            step = self._steps[topic].step
            return lambda log_time_ns, payload: step(log_time_ns, ControllerStepRow.unpack(payload))
        if schema == LOOP_TIMING:
            health = self._health_of(topic.removesuffix(TIMING_SUFFIX))
            return lambda log_time_ns, payload: health.timing(log_time_ns, LoopTimingRow.unpack(payload))
        if schema == MAVLINK:
            if topic not in self._frames:
                self._frames[topic] = _Frames(topic)
                self._configure(self._frames[topic])
            return self._frames[topic].step
        return None

    def _health_of(self, space: str) -> Health:
        return self._health.setdefault(space, Health(space))

    def _configure(self, frames: _Frames) -> None:
        if "namespace" in self._onboard:
            frames.decoder.configure(self._onboard)
            health = self._health_of("/" + self._onboard["namespace"].strip("/"))
            frames.counter = health.incoming if frames.topic.endswith(SOURCE_SUFFIX) else health.outgoing


class _Frames:
    """One topic of raw frames: counted and decoded."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.decoder = FrameDecoder(topic)
        self.counter = FrameCounter()

    def step(self, log_time_ns: int, payload: bytes) -> list[Derived]:
        derived = self.decoder.step(log_time_ns, payload)  # first, since it refuses what is no frame
        self.counter.add(payload)
        return derived
