"""Steps a world without a vehicle's rotors."""

from logs.schema.events import ContactBit
from sim.world.step import physics_step, tumbled


def advance(world, force, torque=(0.0, 0.0, 0.0)):
    """Advance by 1 ms under a force (world, N) and torque (body, N m).

    Return the contact bits of the state before the step, and the tumble bit of the state after it.
    """
    wrench = world.record.wrench
    wrench.force[:], wrench.torque[:] = force, torque
    physics_step(world.record)
    return int(world.record.contacts) | (ContactBit.TUMBLED if tumbled(world.body().quaternion) else 0)
