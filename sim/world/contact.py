"""What the vehicle touches, read from the contact sensors of the MuJoCo model."""

from __future__ import annotations

from flightstack.compiled.foreign import Doubles
from flightstack.compiled.jit import jitted
from logs.schema.events import ContactBit

TOP_NORMAL = 0.7  # a contact whose normal is within 45 degrees of the vertical is with the pad's top
RIM_M = 0.002  # a contact lower than this under the pad's top is with its edge

# numbers of the sensors: contacts with the floor, with what is below the pad, and each one with the pad
PAD_CONTACTS = 16  # nine shapes of the vehicle, one or two of each
PER_CONTACT = 7  # whether there is one, place (world, m), normal
SENSORS = 2 + PAD_CONTACTS * PER_CONTACT


PAD, GROUND, ROBOT, PAD_EDGE = (
    ContactBit.PAD.value, ContactBit.GROUND.value, ContactBit.ROBOT.value, ContactBit.PAD_EDGE.value,
)  # fmt: skip


@jitted
def touched(sensors: Doubles, pad_m: float) -> int:
    """Contact bits. ``sensors``: readings, see ``SENSORS``; ``pad_m``: height of the pad's top."""
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
