"""Reads a flight log tick by tick, each tick with all records of the onboard process.

The onboard process writes the records of a tick together, and stamps all of them with the tick's time. So
the file is read once, to its end or its first damage, with one tick in memory.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from flightstack.common.strict_toml import ConfigError, from_table, over, parse_toml
from flightstack.core.parameters.flight import FlightConfig
from logs.reader.flight_data import ATTACHMENT
from logs.reader.reader import ROSOUT, LogError, LogFile
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

# readers of the records of a tick, by topic, without MAVLink frames and events
_READERS: dict[str, Callable[[bytes], Any]] = {
    "controller/input": unpack_controller_input,
    "controller/step": bytes,
    "controller/power": lambda data: (data, unpack_power(data)),
    "controller/neighbours": unpack_neighbours,
    "controller/state": ControllerStateRow.unpack,
    "target/odom": bytes,
}


class ReplayError(ValueError):
    """A log that cannot be replayed."""


@dataclass(slots=True)
class TickRecord:
    """Records of one tick of the onboard process."""

    unix_ns: int  # log time of the tick, Unix time, ns
    given: TickInputs | None = None  # inputs of the controller; None if the log ends before their record
    step: bytes | None = None  # recorded decisions; None if the log ends before their record
    # recorded battery and motor values and thrust reserve; None: not recorded
    power: bytes | None = None
    told: bool = False  # whether the tick has messages of other members; they are in ``given``
    state: ControllerStateRow | None = None  # state of the controller after the tick; None in most ticks
    events: list[LogRow] = field(default_factory=list)  # recorded events of the controller
    said: list[LogRow] = field(default_factory=list)  # other events of the onboard process
    # received MAVLink frames, each with the name of its peer; sent frames
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
        metadata = self.log.metadata()
        # metadata of the onboard process and of the preflight check; empty if the log has none
        self.onboard, self.preflight = metadata.get("onboard", {}), metadata.get("preflight", {})
        if "namespace" not in self.onboard:
            raise ReplayError(
                f"{path}: no metadata of an onboard process, which records the inputs of the controller: "
                "`flightstack onboard --recorder SOCKET`"
            )
        self.names = self.log.names
        self.source, self.sink = map(self.names.frames, ("mavlink_source", "mavlink_sink"))
        files = {each.name: each.data for each in self.log.attachments()}
        if ATTACHMENT not in files:
            raise ReplayError(
                f"{path}: no attachment {ATTACHMENT}: without its configuration nothing can be replayed"
            )
        try:
            self.table = parse_toml(files[ATTACHMENT])  # the configuration as plain TOML data
        except ConfigError as error:
            raise ReplayError(f"{path}: the attachment {ATTACHMENT} is {error}") from error

    def config(self) -> FlightConfig:
        try:
            return from_table(FlightConfig, self.table)
        except ConfigError as error:
            raise ReplayError(
                f"{self.log.path}: the attachment {ATTACHMENT}: {error}; the log was recorded by "
                f"{self.log.made_by}"
            ) from error

    def topic(self, name: str) -> str:
        return f"/{self.names.member}/{name}"

    def ticks(self) -> Iterator[TickRecord]:
        """Yield the ticks in order; the last tick may be incomplete."""
        given, step, power, neighbours, state, odometry = map(self.topic, _READERS)
        for unix_ns, records in groupby(self._records(), itemgetter(0)):
            found: dict[str, list[Any]] = defaultdict(list)
            for _, topic, content in records:
                found[topic].append(content)
            said: list[LogRow] = found[ROSOUT]
            tick = TickRecord(
                unix_ns,
                given=found[given][-1] if found[given] else None,
                step=found[step][-1] if found[step] else None,
                told=bool(found[neighbours]),
                # after a gap in the log, the snapshot of an older tick may follow; this snapshot is left out
                state=next((each for each in found[state] if each.stamp_ns == unix_ns), None),
                events=[row for row in said if row.name == self.names.logger(CONTROLLER)],
                said=[row for row in said if row.name == self.names.logger(ONBOARD)],
                frames_in=[(each.frame, each.peer) for each in found[self.source]],
                frames_out=[each.frame for each in found[self.sink]],
                odometry=found[odometry],
            )
            if tick.given is not None:
                inputs = tick.given.inputs
                if found[power]:
                    tick.power, received = found[power][-1]
                    inputs = inputs._replace(power=received)
                if tick.told:
                    inputs = inputs._replace(neighbours=found[neighbours][-1])
                tick.given = tick.given._replace(inputs=inputs)
            yield tick

    def _records(self) -> Iterator[tuple[int, str, Any]]:
        """Yield log time, topic and content of each record of the onboard process."""
        unpack = {self.topic(name): read for name, read in _READERS.items()}
        unpack |= {self.source: unpack_mavlink, self.sink: unpack_mavlink, ROSOUT: LogRow.unpack}
        loggers = self.names.logger(ONBOARD), self.names.logger(CONTROLLER)
        newest_ns = 0
        for message in self.log.messages(unpack):
            topic, now_ns = message.topic, message.log_time_ns
            try:
                content = unpack[topic](message.data)
                if topic == ROSOUT and content.name not in loggers:
                    continue
                if now_ns < newest_ns:
                    raise ValueError("it is older than the previous one; was the log merged?")
            except ValueError as error:
                raise ReplayError(f"{self.log.path}: {topic} at log time {now_ns}: {error}") from error
            newest_ns = now_ns
            yield now_ns, topic, content


def changed(table: dict[str, Any], settings: Sequence[str]) -> FlightConfig:
    """Apply each ``section.key=value`` to the configuration; a value that is not TOML becomes a string."""
    for setting in settings:
        key, equals, text = setting.partition("=")
        steps = key.strip().split(".")
        if not equals or not all(steps):
            raise ConfigError(
                f"--set {setting}: KEY=VALUE is needed, for example barrier.alpha_1_m=1.2 or filter=paper"
            )
        part = _value(text.strip())
        for step in reversed(steps):
            part = {step: part}
        table = over(table, part)
    return from_table(FlightConfig, table)


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}".encode())["value"]
    except ConfigError:
        return text
