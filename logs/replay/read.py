"""Reads a flight log tick by tick, each tick with all records of the onboard process.

One process writes the records of a tick in the order of its work, and stamps all of them with the tick's
time; so the file is read once, to its end or its first damage, with one tick in memory.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flightstack.common.strict_toml import ConfigError, from_table, parse_toml
from flightstack.core.parameters.flight import FlightConfig
from logs.reader.flight_data import ATTACHMENT
from logs.reader.reader import LogError, LogFile
from logs.schema.controller_rows import TickInputs, unpack_controller_input, unpack_neighbours, unpack_power
from logs.schema.events import CONTROLLER, ONBOARD
from logs.schema.mavlink import unpack_mavlink
from logs.schema.rows import ControllerStateRow, LogRow
from logs.schema.schemas import (
    CONTROLLER_INPUT,
    CONTROLLER_NEIGHBOURS,
    CONTROLLER_POWER,
    CONTROLLER_STATE,
    CONTROLLER_STEP,
)

SOURCE, SINK, ROSOUT = "/uas1/mavlink_source", "/uas1/mavlink_sink", "/rosout"


class ReplayError(ValueError):
    """A log that cannot be replayed."""


@dataclass(slots=True)
class TickRecord:
    """Records of one tick of the onboard process."""

    unix_ns: int  # log time of the tick, Unix, ns
    given: TickInputs | None = None  # inputs of the controller; None if the log ends before their record
    step: bytes | None = None  # recorded decisions; None if the log ends before their record
    # recorded battery, motors and thrust reserve; None in a flight without them
    power: bytes | None = None
    told: bool = False  # whether the tick has messages of other members, which are in ``given``
    state: ControllerStateRow | None = None  # snapshot after the tick; None in most ticks
    events: list[LogRow] = field(default_factory=list)  # recorded events of the controller
    said: list[LogRow] = field(default_factory=list)  # other events of the onboard process
    # MAVLink frames; an incoming frame has the name of its peer
    frames_in: list[tuple[bytes, str]] = field(default_factory=list)
    frames_out: list[bytes] = field(default_factory=list)
    odometry: list[bytes] = field(default_factory=list)  # CDR payloads of the received target samples


class FlightInputs:
    """Inputs of a flight, read from its log for a replay."""

    def __init__(self, path: Path | str, member: str | None = None) -> None:
        """Find the inputs and the configuration in the log."""
        try:
            self.log = LogFile(path, member).single()
            self.log.need(
                CONTROLLER_INPUT, CONTROLLER_POWER, CONTROLLER_NEIGHBOURS, CONTROLLER_STEP, CONTROLLER_STATE
            )
        except LogError as error:
            raise ReplayError(str(error)) from error
        # metadata of the onboard process; empty if the log has none
        self.onboard = self.log.metadata().get("onboard", {})
        # metadata of the preflight check; empty if the log has none
        self.preflight = self.log.metadata().get("preflight", {})
        if "namespace" not in self.onboard:
            raise ReplayError(
                f"{path}: no metadata of an onboard process, which records the inputs of the controller: "
                "`flightstack onboard --recorder SOCKET`"
            )
        data = self.log.attachment(ATTACHMENT)
        if data is None:
            raise ReplayError(
                f"{path}: no attachment {ATTACHMENT}: without its configuration nothing can be replayed"
            )
        try:
            self.table = parse_toml(data)  # the configuration as plain TOML data
        except ConfigError as error:
            raise ReplayError(f"{path}: the attachment {ATTACHMENT} is {error}") from error

    def config(self) -> FlightConfig:
        """Return the configuration of the flight."""
        try:
            return from_table(FlightConfig, self.table)
        except ConfigError as error:
            raise ReplayError(
                f"{self.log.path}: the attachment {ATTACHMENT}: {error}; the log was recorded by "
                f"{self.log.made_by}"
            ) from error

    def topic(self, name: str) -> str:
        return f"/{self.onboard['namespace']}/{name}"

    def ticks(self) -> Iterator[TickRecord]:
        """Yield the ticks in order; the last one may be incomplete."""
        given, step = self.topic("controller/input"), self.topic("controller/step")
        state, odometry = self.topic("controller/state"), self.topic("target/odom")
        power, neighbours = self.topic("controller/power"), self.topic("controller/neighbours")
        topics = {given, step, state, power, neighbours, odometry, SOURCE, SINK, ROSOUT}
        tick: TickRecord | None = None
        for message in self.log.messages(topics):
            topic, data = message.topic, message.data
            try:
                said = LogRow.unpack(data) if topic == ROSOUT else None
                if said is not None and said.name not in (ONBOARD, CONTROLLER):
                    continue
                if tick is None or message.log_time_ns != tick.unix_ns:
                    if tick is not None:
                        if message.log_time_ns < tick.unix_ns:
                            raise ValueError("it is older than the previous one; was the log merged?")
                        yield tick
                    tick = TickRecord(message.log_time_ns)
                if said is not None:
                    (tick.events if said.name == CONTROLLER else tick.said).append(said)
                elif topic == given:
                    tick.given = unpack_controller_input(data)
                elif topic == step:
                    tick.step = data
                elif topic in (power, neighbours) and tick.given is None:
                    pass  # power and neighbours follow the inputs; a tick without inputs is incomplete
                elif topic == power and tick.given is not None:
                    inputs = tick.given.inputs._replace(power=unpack_power(data))
                    tick.given, tick.power = tick.given._replace(inputs=inputs), data
                elif topic == neighbours and tick.given is not None:
                    inputs = tick.given.inputs._replace(neighbours=unpack_neighbours(data))
                    tick.given, tick.told = tick.given._replace(inputs=inputs), True
                elif topic == state:
                    snapshot = ControllerStateRow.unpack(data)
                    if snapshot.stamp_ns == tick.unix_ns:  # an older snapshot shows a gap in the log
                        tick.state = snapshot
                elif topic == odometry:
                    tick.odometry.append(data)
                else:
                    record = unpack_mavlink(data)
                    if topic == SOURCE:
                        tick.frames_in.append((record.frame, record.peer))
                    else:
                        tick.frames_out.append(record.frame)
            except ValueError as error:
                raise ReplayError(
                    f"{self.log.path}: {topic} at log time {message.log_time_ns}: {error}"
                ) from error
        if tick is not None:
            yield tick


def changed(table: dict[str, Any], settings: Sequence[str]) -> FlightConfig:
    """Return the configuration with each ``section.key=value`` set; a value that is not TOML is a string."""
    table = copy.deepcopy(table)
    for setting in settings:
        key, equals, text = setting.partition("=")
        *sections, name = key.strip().split(".")
        if not equals or not name or not all(sections):
            raise ConfigError(
                f"--set {setting}: KEY=VALUE is needed, for example barrier.alpha_1_m=1.2 or filter=paper"
            )
        inner = table
        for section in sections:
            inner = inner.setdefault(section, {})
            if not isinstance(inner, dict):
                raise ConfigError(f"--set {setting}: {section} is a value and has no keys of its own")
        inner[name] = _value(text.strip())
    return from_table(FlightConfig, table)


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}".encode())["value"]
    except ConfigError:
        return text
