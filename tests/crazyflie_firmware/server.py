"""Serves the firmware model on a UDP socket, in its own thread, with a radio that loses packets."""

import random
import select
import socket
import threading
import time
from types import TracebackType

from flightstack.common.pacing import ask_for_priority
from tests.crazyflie_firmware.firmware import Firmware

TICK_S = 0.002


class Server:
    """Serves one firmware at ``server.uri`` within ``with Server(firmware) as server``.

    ``mute``: packets from the firmware are lost; ``deaf``: packets to the firmware are lost.
    """

    def __init__(self, firmware: Firmware, *, loss: float = 0.0, seed: int = 0) -> None:
        self.firmware = firmware
        self.loss = loss  # fraction of lost packets in each direction
        self.mute = self.deaf = False
        self.lost = 0
        self.error: BaseException | None = None
        self._random = random.Random(seed)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        self._stop = threading.Event()
        self._start_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="crazyflie-firmware", daemon=True)

    @property
    def uri(self) -> str:
        return f"udp://127.0.0.1:{self._socket.getsockname()[1]}"

    @property
    def now_s(self) -> float:
        return time.monotonic() - self._start_s

    def __enter__(self) -> "Server":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join(5.0)
        self._socket.close()
        if self.error is not None and error is None:
            raise self.error

    def _run(self) -> None:
        ask_for_priority()  # the model runs in real time, as a vehicle does
        try:
            while not self._stop.is_set():
                select.select((self._socket,), (), (), TICK_S)
                self._receive()
                for packet in self.firmware.step(self.now_s):
                    self._send(packet)
        except BaseException as error:
            self.error = error

    def _receive(self) -> None:
        for _ in range(64):
            try:
                packet, peer = self._socket.recvfrom(64)
            except BlockingIOError:
                return
            except ConnectionRefusedError:
                continue
            if packet == b"\xff":
                continue
            self._peer = peer
            if self.deaf or self._loses():
                continue
            for answer in self.firmware.packet(packet, self.now_s):
                self._send(answer)

    def _send(self, packet: bytes) -> None:
        if self._peer is None or self.mute or self._loses():
            return
        try:
            self._socket.sendto(packet, self._peer)
        except (BlockingIOError, ConnectionRefusedError):
            self.lost += 1

    def _loses(self) -> bool:
        lost = self._random.random() < self.loss
        self.lost += lost
        return lost
