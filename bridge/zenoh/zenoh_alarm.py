"""Reports when a Zenoh session has no connection: Zenoh itself retries without a message.

A refused certificate, a wrong password and a machine that is switched off look the same from here.
"""

from __future__ import annotations

from collections.abc import Sequence

from bridge.zenoh import zenoh_link

PATIENCE_S = 3.0  # s without a connection before it is said; a restarted router is back in less
LOOK_EVERY_S = 1.0


class ConnectionAlarm:
    """Watches one session; poll it in every tick.

    ``whom`` are the endpoints it dials; with none it waits to be dialled and nothing is wrong.
    """

    def __init__(
        self, session: zenoh_link.Session, whom: Sequence[str], role: zenoh_link.Role = zenoh_link.Role.PEER
    ) -> None:
        self._session, self._whom = session, ", ".join(whom)
        self._since_s: float | None = None  # without a connection
        self._next_s = -1.0
        self._said = False
        self._said_router = role is not zenoh_link.Role.PEER

    def poll(self, now_s: float) -> list[str]:
        """Return messages about changes since the last call; ``now_s`` never goes back."""
        if not self._whom or now_s < self._next_s:
            return []
        self._next_s = now_s + LOOK_EVERY_S
        if zenoh_link.transports(self._session) == 0:
            return self._alone(now_s)
        texts: list[str] = []
        if self._said and self._since_s is not None:
            texts.append(f"Zenoh: connected to {self._whom} after {now_s - self._since_s:.0f} s")
        self._since_s, self._said = None, False
        if not self._said_router and zenoh_link.knows_router(self._session):
            self._said_router = True
            texts.append(
                f"Zenoh: {self._whom} is a router, and we are its peer: it passes on nothing from its other "
                "peers, such as ROS 2 nodes; be a client, with mode client in --zenoh-config "
                "(docs/how_to/zenoh.md)"
            )
        return texts

    def _alone(self, now_s: float) -> list[str]:
        if self._since_s is None:
            self._since_s = now_s
        if self._said or now_s - self._since_s < PATIENCE_S:
            return []
        self._said = True
        return [
            f"Zenoh: no connection to {self._whom} for {now_s - self._since_s:.0f} s: nobody is there, or it "
            "refuses our certificate or password"
        ]
