"""Reads a flight log, complete or damaged: all data, or the part of one vehicle.

A killed recorder leaves a file without its index, truncated at any byte; a disk or a transfer may damage any
byte. The reader returns all readable records, and reports the place of the first unreadable one.

The metadata record ``fleet`` names the vehicles of the log, its members. The data of a member have its
namespace in front: ``/cf2/controller/step``, the logger ``cf2.onboard`` on /rosout, the metadata ``cf2/run``,
the attachment ``cf2/onboard.toml``. MAVLink frames are on ``/uas<system id>/...``, with the system id in the
metadata ``cf2/onboard``. Events, metadata and attachments without a member's name belong to all members;
topics of no member belong to none.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.records import Message as MessageRecord

from logs.reader.mcap_records import MAGIC, Records, named
from logs.schema import FLEET, LOSSES, member_name, split
from logs.schema.rows import LogRow
from logs.schema.schemas import LOG, same_fields

ROSOUT = "/rosout"
_NAME = re.compile(r"(?=.{1,64}$)[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*")
_SYSTEM = "uas"  # first part of the topics of MAVLink frames; the system id follows
_FRAMES = "/uas1"  # first part of these topics in a member's view of the log, for any system id
_OWNED = ("run", "onboard")  # metadata records that belong to one vehicle


class Members:
    """Names and system ids of the vehicles in a log."""

    def __init__(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        told = metadata.get(FLEET, {}).get("members", "")
        owners = [owner for name in metadata for owner, own in (split(name),) if owner and own in _OWNED]
        # namespaces of the members, in the order of the log
        self.names = tuple(name for part in told.split(",") if (name := part.strip()))
        self.names = self.names or tuple(dict.fromkeys(owners)) or (member_name(1),)
        for name in self.names:  # the names are used for files and entities
            if not _NAME.fullmatch(name):
                raise ValueError(
                    f"metadata {FLEET!r}: found a member {name!r}; allowed are A-Z a-z 0-9 _ - in parts "
                    "that / separates"
                )
        # namespaces by MAVLink system id, which is the vehicle's id
        self.ids = {_system_id(metadata, n, name): name for n, name in enumerate(self.names, 1)}
        self._firsts = {f"/{name}/": name for name in self.names}
        self._firsts |= {f"/{_SYSTEM}{system_id}/": name for system_id, name in self.ids.items()}
        self._known: dict[str, str | None] = {}  # members by topic

    def owner(self, topic: str) -> str | None:
        """Return the member that owns a topic; None: no member."""
        if topic not in self._known:
            first = next((each for each in self._firsts if topic.startswith(each)), None)
            self._known[topic] = self._firsts[first] if first else None
        return self._known[topic]

    def split(self, name: str, separator: str = "/") -> tuple[str | None, str]:
        """Return the member (None: no member) and the name without its namespace."""
        for member in self.names:
            if name.startswith(f"{member}{separator}"):
                return member, name[len(member) + 1 :]
        return None, name


def _system_id(metadata: Mapping[str, Mapping[str, str]], number: int, name: str) -> int:
    """Return the system id from the onboard process's metadata; by default members are counted from 1."""
    told = metadata.get(f"{name}/onboard", {}).get("system_id", "")
    return int(told) if told.isdigit() else number


_HEAD_BYTES = 32


class LogError(ValueError):
    """A file that cannot be used as a flight log."""


class EmptyLogError(LogError):
    """A complete log without controller steps and true states: no flight started."""


class Message(NamedTuple):
    topic: str
    schema: str
    log_time_ns: int  # Unix time; simulated time from 2020-01-01 on in lockstep
    publish_time_ns: int
    sequence: int
    data: bytes  # CDR payload with its four-byte header


@dataclass
class Outline:
    """Content of a log file without its messages."""

    library: str = ""  # program that wrote the file
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[Attachment] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)  # declarations by id
    channels: dict[int, Channel] = field(default_factory=dict)
    # message types of this stack whose fields in the file differ from this version
    foreign: set[str] = field(default_factory=set)
    problem: str = ""  # kind, place and reason of the first unreadable record; empty: all are readable


class LogFile:
    """A flight log on disk, or the part of one member."""

    def __init__(self, path: Path | str, member: str | None = None) -> None:
        """Check the first bytes of the file.

        If ``member`` is given, only data of this member and of all members are read. Their names, except
        topics, are returned without the namespace.
        """
        self.path = Path(path)  # the log file
        self.member = member  # member whose part is read; None: the whole log
        try:
            if self.path.exists() and not self.path.is_file():
                raise LogError(f"{self.path} is no file; an MCAP file is needed")
            with self.path.open("rb") as stream:
                head = stream.read(_HEAD_BYTES)
        except OSError as error:
            raise LogError(f"cannot open the log {self.path}: {error.strerror}") from error
        if not head:
            raise LogError(f"{self.path} is empty; expected an MCAP file")
        if not head.startswith(MAGIC):
            raise LogError(f"{self.path} is not an MCAP file: {named(head)}")
        if member is not None and member not in (names := self.parts.names):
            raise LogError(f"{self.path} has no member {member!r}; it holds {', '.join(names)}")

    @property
    def members(self) -> tuple[str, ...]:
        """Namespaces of all vehicles in the log, or of the vehicle of this part."""
        return self.parts.names if self.member is None else (self.member,)

    def single(self) -> LogFile:
        """Return the part of the only vehicle. Raises LogError: there are several."""
        first, *others = self.members
        if others:
            raise LogError(
                f"{self.path} holds a fleet of {', '.join(self.members)}; choose a member, for example with "
                f"--member {first}"
            )
        return self.part(first)

    def part(self, member: str) -> LogFile:
        """Return a member's part of the log; the file is not read again."""
        found = copy(self)
        found.member = member
        return found

    @property
    def problem(self) -> str:
        """Kind, place and reason of the first unreadable record; empty: all are readable."""
        return self.outline.problem

    @property
    def complete(self) -> bool:
        """Whether the recorder closed the file properly and every byte of it was understood."""
        return not self.problem

    def need(self, *schemas: str) -> None:
        """Raise LogError if one of these types has other fields in the log than in this version."""
        foreign = [name.rpartition("/")[2] for name in schemas if name in self.outline.foreign]
        if foreign:
            raise LogError(
                f"{self.path} was recorded by another version of this stack: {self.made_by}. "
                f"The fields of its {' and '.join(foreign)} messages are not those of this version, "
                f"{version('crazyflie-flightstack')}. Read it with the version that recorded it; "
                "`flightstack log info` and `log export` read it as it is"
            )

    @property
    def made_by(self) -> str:
        """Version of this stack that recorded the log; without one, the library that wrote the file."""
        made = self.outline.metadata.get("made", {})
        revision = f" (git {made['git_revision']})" if made.get("git_revision") else ""
        return f"version {made['version']}{revision}" if "version" in made else repr(self.outline.library)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Yield the readable messages in the order in which they were written."""
        schemas = dict[int, str]()
        wanted: dict[int, tuple[str, str]] = {}  # topic and schema by channel
        with self.path.open("rb") as stream:
            for record in Records(stream, messages=True):
                if isinstance(record, MessageRecord):
                    if record.channel_id not in wanted:
                        continue
                    topic, schema = wanted[record.channel_id]
                    data = self._data(schema, record.data)
                    if data is not None:
                        yield Message(
                            topic, schema, record.log_time, record.publish_time, record.sequence, data
                        )
                elif isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    seen = self._topic(record.topic)
                    if seen is not None and (topics is None or seen in topics):
                        wanted[record.id] = seen, schemas.get(record.schema_id, "")

    def part_of(self, message: Message) -> Message | None:
        """Convert a message of the whole log to this member's names; None: another member sent it."""
        topic, data = self._topic(message.topic), self._data(message.schema, message.data)
        return None if topic is None or data is None else message._replace(topic=topic, data=data)

    def _topic(self, topic: str) -> str | None:
        """Return the name of a topic; None if it belongs to another member. /rosout belongs to all."""
        if self.member is None or topic == ROSOUT or topic.startswith(f"/{self.member}/"):
            return topic
        if self.parts.owner(topic) != self.member:
            return None
        return f"{_FRAMES}/{topic.removeprefix('/').partition('/')[2]}"

    def _data(self, schema: str, data: bytes) -> bytes | None:
        """Return the data of a message of this part; an event gets the logger name without namespace.

        The result is None for an event of another member. An event that cannot be decoded belongs to all
        members and is returned unchanged.
        """
        if self.member is None or schema != LOG:
            return data
        try:
            row = LogRow.unpack(data)
        except ValueError:
            return data
        owner, logger = self.parts.split(row.name, ".")
        if owner is None:
            return data
        return row._replace(name=logger).pack() if owner == self.member else None

    def _names(self, names: Iterable[str], separator: str = "/") -> dict[str, str]:
        """Return the names of this part without its namespace, by the names in the file."""
        if self.member is None:
            return {name: name for name in names}
        split = {name: self.parts.split(name, separator) for name in names if name != FLEET}
        return {name: rest for name, (owner, rest) in split.items() if owner in (None, self.member)}

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records by name; of records with one name the last value of a key counts."""
        found = self.outline.metadata
        seen = {name: found[key] for key, name in self._names(found).items()}
        if LOSSES in seen:  # only those of this member and of shared processes
            losses = seen[LOSSES]
            seen[LOSSES] = {name: losses[key] for key, name in self._names(losses, ".").items()}
        return seen

    def attachments(self) -> list[Attachment]:
        """Return the files stored in the log, in the order in which they were written."""
        found = self.outline.attachments
        names = self._names(each.name for each in found)
        return [replace(each, name=names[each.name]) for each in found if each.name in names]

    def attachment(self, name: str) -> bytes | None:
        """Return the last file with this name; ``None`` if there is none."""
        return next((each.data for each in reversed(self.attachments()) if each.name == name), None)

    @cached_property
    def parts(self) -> Members:
        return Members(self.outline.metadata)

    @cached_property
    def outline(self) -> Outline:
        """Content of the whole file without its messages, from a pass over all records."""
        found = Outline()
        with self.path.open("rb") as stream:
            records = Records(stream, messages=False)
            for record in records:
                if isinstance(record, Metadata):
                    found.metadata.setdefault(record.name, {}).update(record.metadata)
                elif isinstance(record, Attachment):
                    found.attachments.append(record)
                elif isinstance(record, Header):
                    found.library = record.library
                elif isinstance(record, Schema):
                    found.schemas[record.id] = record
                    if not same_fields(record.name, record.data.decode(errors="replace")):
                        found.foreign.add(record.name)
                elif isinstance(record, Channel):
                    found.channels[record.id] = record
        found.problem = records.problem
        return found
