"""Tables of contents of the firmware model: log variables and parameters."""

import struct
import zlib
from dataclasses import dataclass, field

LOG_TYPES = {"u8": 1, "u16": 2, "u32": 3, "i8": 4, "i16": 5, "i32": 6, "f": 7}
PARAM_TYPES = {"u8": 8, "u16": 9, "u32": 0xA, "i8": 0, "i16": 1, "i32": 2, "f": 6}
CODE = {"u8": "<B", "u16": "<H", "u32": "<I", "i8": "<b", "i16": "<h", "i32": "<i", "f": "<f"}
READ_ONLY = 0x40

SENT_SINCE = {"pm.vbatMV": 8}  # first CRTP version with this variable; CrazySim's firmware of 2024 has 7
LOGS = {
    **{f"stateEstimateZ.{name}": "i16" for name in ("x", "y", "z", "vx", "vy", "vz")},
    "stateEstimateZ.quat": "u32",
    **{f"stateEstimateZ.rate{name}": "i16" for name in ("Roll", "Pitch", "Yaw")},
    "supervisor.info": "u16",
    "pm.vbat": "f",
    "pm.vbatMV": "u16",
    "pm.state": "i8",
    "pm.batteryLevel": "u8",
    **{f"acc.{axis}": "f" for axis in "xyz"},
    **{f"motor.m{number}": "u16" for number in range(1, 5)},
    **{f"kalman.varP{axis}": "f" for axis in "XYZ"},
}


@dataclass
class Param:
    kind: str
    value: float
    read_only: bool = False


def params(entries: int) -> dict[str, Param]:
    """Return a parameter table of this size, at least the parameters that the bridge uses."""
    known = {
        "stabilizer.estimator": Param("u8", 1),
        "stabilizer.controller": Param("u8", 1),
        **{f"kalman.initial{name}": Param("f", 0) for name in ("X", "Y", "Z", "Yaw")},
        "kalman.resetEstimation": Param("u8", 0),
        "locSrv.extPosStdDev": Param("f", 0.01),
        "locSrv.extQuatStdDev": Param("f", 4.5e-3),
        **{f"kalman.dragB_{axis}": Param("f", 0) for axis in "xyz"},
        "deck.bcFlow2": Param("u8", 0, True),
        "deck.bcLighthouse4": Param("u8", 1, True),
        "deck.bcLoco": Param("u8", 0, True),
    }
    return known | {f"other.param{i}": Param("u8", 0) for i in range(entries - len(known))}


@dataclass
class Toc:
    """Table of contents: names and types of the entries, by number."""

    entries: list[tuple[str, int]] = field(default_factory=list)

    def info(self) -> bytes:
        text = repr(self.entries).encode()
        return struct.pack("<BHI", 3, len(self.entries), zlib.crc32(text))

    def item(self, index: int) -> bytes:
        name, kind = self.entries[index]
        group, _, variable = name.partition(".")
        return struct.pack("<BHB", 2, index, kind) + f"{group}\0{variable}\0".encode()

    def name(self, index: int) -> str:
        return self.entries[index][0]


def log_toc(protocol: int, entries: int) -> Toc:
    """Return the log table of this size for a CRTP protocol version."""
    names = [name for name in LOGS if protocol >= SENT_SINCE.get(name, 0)]
    filled = [(f"other.log{i}", LOG_TYPES["f"]) for i in range(entries - len(names))]
    return Toc([(name, LOG_TYPES[LOGS[name]]) for name in names] + filled)


def param_toc(table: dict[str, Param]) -> Toc:
    return Toc([(name, PARAM_TYPES[p.kind] | (READ_ONLY if p.read_only else 0)) for name, p in table.items()])


def quaternion_bits(wxyz: tuple[float, float, float, float]) -> int:
    """Pack a quaternion into 32 bits (quatcompress.h): index of the largest element, then the other three."""
    q = (wxyz[1], wxyz[2], wxyz[3], wxyz[0])
    largest = max(range(4), key=lambda i: abs(q[i]))
    bits = largest
    for i in range(4):
        if i != largest:
            negative = (q[i] < 0) != (q[largest] < 0)
            bits = bits << 10 | negative << 9 | int(511 * abs(q[i]) * 2**0.5 + 0.5)
    return bits
