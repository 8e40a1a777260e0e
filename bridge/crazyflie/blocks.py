"""Log blocks of one connection: requested at the start, and again when no packet arrives.

The firmware deletes its log blocks when it has received nothing for a second (crtp.c, log.c); cflib does not
check that blocks arrive. cflib requests a long block in two packets and does not check that the second one
arrived; a block without it is too short and is never decoded.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from cflib.crazyflie.log import LogConfig

from bridge.crazyflie.state import BLOCKS, FETCHED_AS, Block
from bridge.crazyflie.types import Event, LogPacket

SILENT_S = 1.0  # time without a packet after which a block is requested again, s


class _Requested:
    def __init__(self, block: Block, put: Callable[[Event], None]) -> None:
        self.block, self._put = block, put
        self.heard_s = self.asked_s = -math.inf
        self._config: Any = None

    def ask(self, crazyflie: Any) -> None:
        """Request the block under a new number; packets with the old number are no longer decoded."""
        if self._config is not None:
            self._config.delete()
            crazyflie.log.log_blocks.remove(self._config)
        self.asked_s = time.monotonic()
        self._config = LogConfig(self.block.name, self.block.period_ms)
        for variable in self.block.variables:
            self._config.add_variable(variable, FETCHED_AS.get(variable))
        crazyflie.log.add_config(self._config)
        self._config.data_received_cb.add_callback(self._take)
        self._config.start()

    def _take(self, time_ms: int, values: dict[str, Any], _config: Any) -> None:
        self.heard_s = time.monotonic()
        self._put(LogPacket(self.block.name, time_ms, values))


class LogBlocks:
    """Keeps the log blocks requested: call ``step`` often. The blocks do not wait for each other."""

    def __init__(self, crazyflie: Any, put: Callable[[Event], None]) -> None:
        """Send no request yet. cflib's thread calls ``put``."""
        self._crazyflie = crazyflie
        known = crazyflie.log.toc.get_element_by_complete_name
        self._requested = []
        for block in BLOCKS:
            there = tuple(name for name in block.variables if known(name) is not None)
            if block.needed and there != block.variables:
                missing = next(name for name in block.variables if name not in there)
                raise ValueError(f"the firmware has no log variable {missing}: update it")
            if there:
                self._requested.append(_Requested(block._replace(variables=there), put))

    def step(self) -> None:
        """Request each block that has sent no packet for a second."""
        since_s = time.monotonic() - SILENT_S
        for requested in self._requested:
            if max(requested.heard_s, requested.asked_s) <= since_s:
                requested.ask(self._crazyflie)

    @property
    def waits_for(self) -> str | None:
        """Name of a required block that has not arrived yet; None: all have arrived."""
        return next(
            (r.block.name for r in self._requested if r.block.needed and r.heard_s == -math.inf), None
        )
