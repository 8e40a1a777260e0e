"""What a recorder derives from which channel, while it records."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping

from flightstack.common.strict_toml import ConfigError
from logs.derive.derive import STEP_SUFFIX, Derived, Deriver
from logs.derive.diagnostics import FrameCounter, Health
from logs.derive.mavlink_decoded import FrameDecoder
from logs.reader.flight_data import ATTACHMENT, read_config, shape
from logs.schema.rows import ControllerStepRow, LoopTimingRow
from logs.schema.schemas import CONTROLLER_STEP, LOOP_TIMING, MAVLINK

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
