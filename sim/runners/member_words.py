"""Messages of a fleet member in lockstep, on the simulator's side."""

from __future__ import annotations

import time

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import COMPANION_SILENT_S, PAIR, Silence
from flightstack.onboard.lockstep import HEARD, OVER, TOLD, joined
from sim.clock import STARTUP_S, NoAnswerError, wait_until

_NOTHING = b""
_YIELDS = 20  # polls that only yield the processor; the message usually arrives within them
_PAUSE_S = 50e-6  # time between later polls, s
_MATCH_PAUSE_S = 0.002  # time between two checks for subscribers


class MemberWords:
    """Transmits the messages of one member without decoding them.

    ``flightstack.onboard.lockstep.LockstepWords`` is the other end.
    """

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self.namespace, self.tick = namespace, 0  # namespace of the member; current tick of the vehicles
        self._told = zenoh_link.fifo_subscriber(session, f"{namespace}/{TOLD}")
        self._heard = zenoh_link.blocking_publisher(session, f"{namespace}/{HEARD}")
        self._tick, self._payload = -1, _NOTHING
        self._last: int | None = None  # tick after which the member's process ended
        self._silent = False

    @property
    def left(self) -> bool:
        """Whether the onboard process has announced its end before this tick."""
        self._poll()
        return self._last is not None and self._last < self.tick

    def take(self, silence: Silence, stop: Stop) -> bytes | None:
        """Wait for the member's message of this tick and return it; None: no message.

        A member that answers its vehicle but sends no message is waited for only once.

        ``silence``: time without messages of all members in this tick.
        """
        looks = 0
        while not self._told_now() and not self._silent and not stop.is_set:
            if silence.look() > COMPANION_SILENT_S:
                self._silent = True
            looks += 1
            time.sleep(0.0 if looks <= _YIELDS else _PAUSE_S)
        return self._payload if self._tick == self.tick and self._payload else None

    def hear(self, words: list[bytes]) -> None:
        """Send the messages that the member receives with the next tick."""
        self._heard.put(joined(words), attachment=PAIR.pack(self.tick + 1, len(words)))

    def await_listener(self, stop: Stop) -> None:
        """Wait until the member has subscribed, because earlier messages are lost and not repeated.

        Raises NoAnswerError: time-out.
        """

        def matched() -> bool:
            return zenoh_link.is_matched(self._heard)

        if not wait_until(matched, stop, STARTUP_S, pause_s=_MATCH_PAUSE_S):
            raise NoAnswerError(
                f"nobody subscribed to {self.namespace}/{HEARD} within {STARTUP_S:g} s; is its onboard "
                "process running in lockstep, with a table [fleet], and connected to this process's endpoint?"
            )

    def _told_now(self) -> bool:
        self._poll()
        return self._tick >= self.tick or self._last is not None

    def _poll(self) -> None:
        for sample in zenoh_link.drain(self._told):
            tick, over = PAIR.unpack(sample.attachment.to_bytes())
            if over == OVER:
                self._last = tick
            else:
                self._tick, self._payload = tick, sample.payload.to_bytes()
                self._silent = False
