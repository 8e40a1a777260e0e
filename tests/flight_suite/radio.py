"""A radio link between companion and vehicle that can be cut: forwards datagrams both ways until then."""

from __future__ import annotations

import select
import socket
import threading
from types import TracebackType

POLL_S = 0.05


class Radio:
    """Use as a context.

    Args:
        url: ``udpout:HOST:PORT`` of the vehicle.
        local_port: UDP port of loopback to which the vehicle sends; 0: it answers where it is called from.

    Attributes:
        url: where the companion finds it.
    """

    def __init__(self, url: str, local_port: int = 0) -> None:
        _, host, port = url.split(":")
        self._vehicle = (host, int(port))
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.bind(("127.0.0.1", local_port))
        self.url = f"udpout:127.0.0.1:{self._near.getsockname()[1]}"
        self._companion: tuple[str, int] | None = None
        self._cut, self._end = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._forward, daemon=True)

    def cut(self) -> None:
        """Nothing passes from now on."""
        self._cut.set()

    def mend(self) -> None:
        """All passes again."""
        self._cut.clear()

    def _forward(self) -> None:
        while not self._end.is_set():
            for ready in select.select([self._near, self._far], [], [], POLL_S)[0]:
                data, sender = ready.recvfrom(65536)
                if self._cut.is_set():
                    continue
                if ready is self._near:
                    self._companion = sender
                    self._far.sendto(data, self._vehicle)
                elif self._companion is not None:
                    self._near.sendto(data, self._companion)

    def __enter__(self) -> Radio:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join()
        self._near.close()
        self._far.close()
