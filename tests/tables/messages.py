"""Renews ``bridge/mavlink/codec/wide_messages.csv`` from the installed pymavlink."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import ardupilotmega

from bridge.mavlink.codec.wide_messages import Definition, WideField, definitions

FILE = Path(__file__).parents[2] / "bridge" / "mavlink" / "codec" / "wide_messages.csv"
_HEAD = """\
# MAVLink messages that pymavlink's dialect ardupilotmega does not have: id;name;CRC_EXTRA;type name;...
# [n] is an array, + an extension. Sources: pymavlink's dialect all; and MAVLink's common.xml (mavlink.io,
# messages/common), for those that no dialect of pymavlink has. Renewed by: python -m tests.tables messages
"""


def read_class(cls: Any) -> Definition:
    """Read one of pymavlink's classes; CRC_EXTRA, which leaves extensions out, tells which fields they are.

    Raises:
        ValueError: no number of extensions gives the CRC_EXTRA.
    """
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    arrays = dict(zip(cls.ordered_fieldnames, cls.array_lengths, strict=True))
    for extensions in range(len(cls.ordered_fieldnames)):
        behind = cls.ordered_fieldnames[len(cls.ordered_fieldnames) - extensions :]
        fields = tuple(WideField(kinds[n], n, arrays[n], n in behind) for n in cls.fieldnames)
        made = Definition(cls.id, cls.msgname, cls.crc_extra, fields)
        if made.computed_crc_extra() == cls.crc_extra:
            return made
    raise ValueError(f"{cls.msgname}: CRC_EXTRA {cls.crc_extra} does not fit its fields")


def table() -> str:
    """The whole file: messages of pymavlink anew, the others as they are."""
    wide = {id_: cls for id_, cls in everything.mavlink_map.items() if id_ not in ardupilotmega.mavlink_map}
    made = {d.id: d for d in definitions() if d.id not in everything.mavlink_map}
    made.update({id_: read_class(cls) for id_, cls in wide.items()})
    return _HEAD + "".join(f"{made[id_].line}\n" for id_ in sorted(made))
