"""Topics, events, metadata and attachments of each member in the log of a fleet.

The log of a fleet has a metadata record ``fleet`` with its members. What belongs to one of them has its
namespace in front: ``/cf2/controller/step``, the logger ``cf2.onboard`` on /rosout, the metadata ``cf2/run``,
the attachment ``cf2/onboard.toml``. MAVLink frames are on ``/uas<system id>/...``, with the system id in the
metadata ``cf2/onboard``. Events, metadata and attachments without a member's name in front belong to all, but
for ``fleet`` and ``team.toml``; these and the topics of no member belong to the fleet alone.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from logs.schema.names import FLEET, LOSSES, TEAM
from logs.schema.rows import LogRow
from logs.schema.schemas import LOG

ROSOUT = "/rosout"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_SYSTEM = "uas"  # first part of the topics of MAVLink frames, with the system id behind it
_FRAMES = "/uas1"  # the same in the log of one flight, whatever its system id


class Members:
    """The members of a fleet."""

    def __init__(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        told = metadata.get(FLEET, {}).get("members", "")
        # namespaces of the members, in the order of the log; empty for a log of one flight
        self.names = tuple(name for part in told.split(",") if (name := part.strip()))
        for name in self.names:  # they become names of files and entities
            if not _NAME.fullmatch(name):
                raise ValueError(f"metadata {FLEET!r}: found a member {name!r}; allowed are A-Z a-z 0-9 _ -")
        # namespaces by MAVLink system id, which is the vehicle's id
        self.ids = {_system_id(metadata, n, name): name for n, name in enumerate(self.names, 1)}
        self._owners = {name: name for name in self.names}
        self._owners |= {f"{_SYSTEM}{system_id}": name for system_id, name in self.ids.items()}

    def owner(self, topic: str) -> str | None:
        """Return the member that a topic belongs to; None: no member."""
        return self._owners.get(topic.removeprefix("/").partition("/")[0])

    def split(self, name: str, separator: str = "/") -> tuple[str | None, str]:
        """Return the member (None: no member) and the name without its namespace."""
        first, _, rest = name.partition(separator)
        return (first, rest) if rest and first in self.names else (None, name)


def _system_id(metadata: Mapping[str, Mapping[str, str]], number: int, name: str) -> int:
    """System id by the metadata of the onboard process; without it members are counted from 1."""
    told = metadata.get(f"{name}/onboard", {}).get("system_id", "")
    return int(told) if told.isdigit() else number


class MemberView:
    """What belongs to one member, under the names that it has in the log of one flight."""

    def __init__(self, members: Members, member: str) -> None:
        self._members, self._member = members, member

    def topic(self, topic: str) -> str | None:
        """Return the name of a topic; None for one of another member. /rosout is shared."""
        if topic == ROSOUT:
            return topic
        if self._members.owner(topic) != self._member:
            return None
        rest = topic.removeprefix("/").partition("/")[2]
        return topic if topic.startswith(f"/{self._member}/") else f"{_FRAMES}/{rest}"

    def name(self, name: str) -> str | None:
        """Return the name of a metadata record or attachment; None for one of another member."""
        owner, rest = self._members.split(name)
        return rest if owner in (None, self._member) and name not in (FLEET, TEAM) else None

    def values(self, name: str, values: dict[str, str]) -> dict[str, str]:
        """Return the values of a metadata record; losses only of this member and of shared processes."""
        if name != LOSSES:
            return values
        whose = {who: self._members.split(who, ".") for who in values}
        return {whose[who][1]: text for who, text in values.items() if whose[who][0] in (None, self._member)}

    def event(self, data: bytes) -> bytes | None:
        """Return an event of /rosout with its logger's name; None for another member's.

        An unreadable event belongs to all members, unchanged.
        """
        try:
            row = LogRow.unpack(data)
        except ValueError:
            return data
        owner, logger = self._members.split(row.name, ".")
        if owner is None:
            return data
        return row._replace(name=logger).pack() if owner == self._member else None

    def data(self, schema: str, data: bytes) -> bytes | None:
        """Return the data of a message on one of this member's topics; None: an event of another member."""
        return self.event(data) if schema == LOG else data
