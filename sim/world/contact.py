"""When the vehicle touched what: contact times, and the first touch of the pad."""

from __future__ import annotations

from sim.compiled.jit import jitted
from sim.compiled.records import F64, Record, Vector
from sim.world.world import ContactBit, DeckRecord

GAP_MS = 30  # a bounce shorter than this does not end a contact
NONE_MS = -1_000_000
GROUND, PAD = ContactBit.GROUND.value, ContactBit.PAD.value


class ContactRecord(Record):
    """Times in ms of simulated time, ``NONE_MS`` for never."""

    bits: int  # all contacts since they were last asked for
    since_ms: int  # begin of the contact with pad or ground
    pad_ms: int  # last contact with the pad's top
    ground_ms: int
    judging: bool  # the next touch of the pad is the first
    touch_ms: int  # the first touch
    touch_e: Vector  # vehicle minus pad centre at the begin of that step, m
    touch_velocity: Vector  # of the vehicle relative to the pad below it, m/s


@jitted
def note_contact(
    c: ContactRecord, deck: DeckRecord, bits: int, now_ms: int, before_e: F64, before_velocity: F64
) -> None:
    """Keep contact times; latch the state before the first judged touch of the pad.

    Args:
        c: changed in place.
        deck: the pad.
        bits: contacts of the step.
        now_ms: begin of the step.
        before_e: vehicle minus pad centre then, m.
        before_velocity: of the vehicle then, m/s.
    """
    c.bits |= bits
    if bits & (PAD | GROUND):
        if now_ms - max(c.pad_ms, c.ground_ms) > GAP_MS:
            c.since_ms = now_ms
        if bits & PAD:
            c.pad_ms = now_ms
        if bits & GROUND:
            c.ground_ms = now_ms
    if bits & PAD and c.judging and c.touch_ms == NONE_MS:
        c.touch_ms = now_ms
        c.touch_e[:] = before_e
        c.touch_velocity[0] = before_velocity[0] - (deck.velocity[0] - deck.rate * before_e[1])
        c.touch_velocity[1] = before_velocity[1] - (deck.velocity[1] + deck.rate * before_e[0])
        c.touch_velocity[2] = before_velocity[2] - deck.velocity[2]
