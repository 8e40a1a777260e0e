"""Reads a flight log, complete or damaged: all data, or the part of one vehicle.

A killed recorder leaves a file without its index, truncated at any byte; a disk or a transfer may damage any
byte. The reader returns all readable records, and reports the place of the first unreadable record.

The metadata record ``fleet`` names the vehicles of the log, its members. The data of a member have its
namespace in front: ``/cf2/controller/step``, the logger ``cf2.onboard`` on /rosout, the metadata ``cf2/run``,
the attachment ``cf2/onboard.toml``. MAVLink frames are on ``/uas<system id>/...``, with the system id in the
metadata ``cf2/onboard``. Events, metadata and attachments without a member's name belong to all members;
other topics without a member's name belong to no member.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.records import Message as MessageRecord

from logs.reader.mcap_records import MAGIC, Records, named
from logs.schema import FLEET, LOSSES, Names, member_name, split
from logs.schema.rows import LogRow
from logs.schema.schemas import same_fields

ROSOUT = "/rosout"
_NAME = re.compile(r"(?=.{1,64}$)[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*")
_SYSTEM = re.compile(r"/uas(\d{1,3})/")  # start of a topic of MAVLink frames, with the system id
_OWNED = ("run", "onboard")  # metadata records that belong to one vehicle
_HEAD_BYTES = 32


class LogError(ValueError):
    """A file that cannot be used as a flight log."""


class EmptyLogError(LogError):
    """A complete log without controller steps and true states: no flight started."""


class Message(NamedTuple):
    topic: str
    schema: str
    log_time_ns: int  # Unix time; in lockstep, simulated time that starts at 2020-01-01
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
    # message types of this stack whose fields in the file differ from the fields of this version
    foreign: set[str] = field(default_factory=set)
    problem: str = ""  # kind, place and reason of the first unreadable record; empty: all are readable


class LogFile:
    """A flight log on disk, or the part of one member: its data, and the data that belong to all members."""

    def __init__(self, path: Path | str, member: str | None = None) -> None:
        """Check the first bytes of the file; ``member``: member whose part is read; None: the whole log.

        In a part, the names of metadata and attachments lack the namespace.
        """
        self.path, self.member = Path(path), member
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
        if member is not None and member not in (names := self.ids.values()):
            raise LogError(f"{self.path} has no member {member!r}; it holds {', '.join(names)}")

    @cached_property
    def ids(self) -> dict[int, str]:
        """Names of all members in the order of the log, by MAVLink system id, which is the vehicle's id."""
        metadata = self.outline.metadata
        names = [name.strip() for name in metadata.get(FLEET, {}).get("members", "").split(",")]
        names = list(filter(None, names)) or [
            owner for owner, own in map(split, metadata) if owner and own in _OWNED
        ]
        found = {}
        for number, name in enumerate(dict.fromkeys(names or [member_name(1)]), 1):
            if not _NAME.fullmatch(name):  # names are used for files and entities
                raise ValueError(
                    f"metadata {FLEET!r}: found a member {name!r}; allowed are A-Z a-z 0-9 _ - in parts "
                    "that / separates"
                )
            system_id = metadata.get(f"{name}/onboard", {}).get("system_id", "")
            found[int(system_id) if system_id.isdigit() else number] = name
        return found

    @property
    def members(self) -> tuple[str, ...]:
        """Names of all vehicles in the log, or of the vehicle of this part."""
        return tuple(self.ids.values()) if self.member is None else (self.member,)

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
    def names(self) -> Names:
        """Record names of the vehicle whose part of the log this reader reads."""
        return next(Names(name, number) for number, name in self.ids.items() if name == self.member)

    @property
    def problem(self) -> str:
        """Kind, place and reason of the first unreadable record; empty: all are readable."""
        return self.outline.problem

    @property
    def complete(self) -> bool:
        """Whether the recorder closed the file properly and every record can be read."""
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
        """Version of this stack that recorded the log; if unknown, the library that wrote the file."""
        made = self.outline.metadata.get("made", {})
        revision = f" (git {made['git_revision']})" if made.get("git_revision") else ""
        return f"version {made['version']}{revision}" if "version" in made else repr(self.outline.library)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Yield the readable messages in the order in which they were written."""
        schemas = dict[int, str]()
        wanted: dict[int, tuple[str, str]] = {}  # topic and schema by channel
        with self.path.open("rb") as stream:
            for record in Records(stream, messages=True):
                if isinstance(record, MessageRecord) and record.channel_id in wanted:
                    message = Message(
                        *wanted[record.channel_id], record.log_time, record.publish_time, record.sequence,
                        record.data,
                    )  # fmt: skip
                    if self.member is None or self.member in self.owners(message):
                        yield message
                elif isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel) and (topics is None or record.topic in topics):
                    wanted[record.id] = record.topic, schemas.get(record.schema_id, "")

    def owners(self, message: Message) -> Collection[str]:
        """Return the members to whose parts a message belongs; an undecodable event belongs to all."""
        topic = message.topic
        if topic == ROSOUT:
            try:
                sender = self.owner(LogRow.unpack(message.data).name, ".")
            except ValueError:
                sender = None
            return self.members if sender is None else (sender,)
        system = _SYSTEM.match(topic)
        owner = self.ids.get(int(system[1])) if system else self.owner(topic.removeprefix("/"))
        return () if owner is None else (owner,)

    def owner(self, name: str, separator: str = "/") -> str | None:
        """Return the member whose namespace is in front of a name; None: the name belongs to no member."""
        return next((each for each in self.ids.values() if name.startswith(f"{each}{separator}")), None)

    def plain(self, name: str, separator: str = "/") -> str:
        """Return the name that this part uses for a name in the file."""
        return name if self.member is None else name.removeprefix(f"{self.member}{separator}")

    def _names(self, names: Iterable[str], separator: str = "/") -> dict[str, str]:
        """Return the names that belong to this part, by their names in the file."""
        own = {None, self.member}
        return {
            name: self.plain(name, separator)
            for name in names
            if self.member is None or (name != FLEET and self.owner(name, separator) in own)
        }

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records by name; records with the same name are merged, the last value wins."""
        found = self.outline.metadata
        seen = {name: found[key] for key, name in self._names(found).items()}
        if LOSSES in seen:  # numbers of lost records: keep those of this member and of shared processes
            losses = seen[LOSSES]
            seen[LOSSES] = {name: losses[key] for key, name in self._names(losses, ".").items()}
        return seen

    def attachments(self) -> list[Attachment]:
        found = self.outline.attachments
        names = self._names(each.name for each in found)
        return [replace(each, name=names[each.name]) for each in found if each.name in names]

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
