"""Messages of the log, and the names of a flight's records, which start with the namespace of the vehicle.

These parts are written by hand: the definitions in ``msg/*.msg``, the levels of events in ``events.py``, and
``controller_rows.py``, which fills the rows of a tick. ``schemas.py`` and ``rows.py`` make types and rows
from the definitions; ``rows.pyi`` is generated.

The flight of ``cf2`` has topics ``/cf2/...``, metadata ``cf2/run``, attachments ``cf2/onboard.toml``, loggers
``cf2.onboard`` on /rosout, and MAVLink frames on ``/uas2``, where 2 is the MAVLink system id.
"""

from __future__ import annotations

from typing import NamedTuple

FLEET = "fleet"  # metadata record that lists the members
LOSSES = "losses"  # metadata record: number of records that each process could not pass to the recorder
NO_PAD = "absent"  # metadata "run", key "pad": the vehicle's physics has a floor but no pad
SCENARIO = "scenario.toml"  # attachment with the scenario of all vehicles


class Names(NamedTuple):
    """Record names of one vehicle in a flight."""

    member: str  # namespace of the vehicle
    system_id: int  # MAVLink system id, part of the topics of the vehicle's frames

    def record(self, name: str) -> str:
        return f"{self.member}/{name}"

    def logger(self, name: str) -> str:
        """Return the name of a process, which is also a source of events."""
        return f"{self.member}.{name}"

    def frames(self, name: str) -> str:
        return f"/uas{self.system_id}/{name}"


def member_name(system_id: int) -> str:
    """Return the namespace of a fleet vehicle from its MAVLink system id: cf1, cf2 and so on."""
    return f"cf{system_id}"


def split(name: str) -> tuple[str, str]:
    """Split the name of a metadata record or attachment into fleet member (empty: none) and plain name."""
    member, _, rest = name.rpartition("/")
    return member, rest
