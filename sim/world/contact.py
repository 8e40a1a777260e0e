"""Contacts of the vehicle, read from the contact sensors of the MuJoCo model."""

from __future__ import annotations

from flightstack.compiled.foreign import Doubles
from flightstack.compiled.jit import jitted
from logs.schema.events import ContactBit

TOP_NORMAL = 0.7  # smallest |z| of the contact normal, about 45 degrees from the vertical, of the pad's top
RIM_M = 0.002  # a contact more than this distance below the pad's top counts as contact with the edge, m

# Layout of the sensor readings: one for the floor, one for the robot below the pad, then all pad contacts.
PAD_CONTACTS = 16  # maximum number of contacts with the pad: nine shapes of the vehicle, up to two each
PER_CONTACT = 7  # values per contact: whether it exists, position (world, m), normal
SENSORS = 2 + PAD_CONTACTS * PER_CONTACT


PAD, GROUND, ROBOT, PAD_EDGE = (
    ContactBit.PAD.value, ContactBit.GROUND.value, ContactBit.ROBOT.value, ContactBit.PAD_EDGE.value,
)  # fmt: skip


@jitted
def touched(sensors: Doubles, pad_m: float) -> int:
    """Return the contact bits. ``sensors``: ``SENSORS`` readings; ``pad_m``: height of the pad's top, m."""
    bits = GROUND if sensors[0] > 0.0 else 0
    if sensors[1] > 0.0:
        bits |= ROBOT
    for i in range(PAD_CONTACTS):
        at = 2 + PER_CONTACT * i
        if sensors[at] == 0.0:
            break
        on_top = abs(sensors[at + 6]) >= TOP_NORMAL and sensors[at + 3] >= pad_m - RIM_M
        bits |= PAD if on_top else PAD_EDGE
    return bits
