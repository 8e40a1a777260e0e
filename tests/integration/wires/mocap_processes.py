"""A motion capture on Zenoh, and a vehicle that shows what reaches it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.zenoh import zenoh_link
from tests.integration.sim_processes import Client, free_port
from tests.unit.target.ros2_helpers import pose_stamped

KEY = "lab/cf1/pose"


class Mocap:
    """Publishes a pose at 100 Hz under a key, until stopped."""

    def __init__(self, key: str, pose: Callable[[], tuple]) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._session = zenoh_link.open_session([self.endpoint])
        self._publisher = zenoh_link.dropping_publisher(self._session, key)
        self._pose, self._done = pose, threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self._done.wait(0.01):
            self._publisher.put(pose_stamped(time.time_ns(), "map", *self._pose()))

    def stop(self) -> None:
        self._done.set()
        self._thread.join()

    def __enter__(self) -> Mocap:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._session.close()


@contextmanager
def plain_vehicle(autopilot: int) -> Iterator[Client]:
    """A socket that beats like an autopilot, and decodes what comes with pymavlink alone."""
    one = Client(f"udpin:127.0.0.1:{free_port()}", 1, 1, listen=True)
    try:
        one.beat = lambda: one.send(mav.MAVLink_heartbeat_message(2, autopilot, 0, 0, 3, 3))
        yield one
    finally:
        one.close()
