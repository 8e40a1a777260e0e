"""The command line: each module contains the commands of one subject."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def _end(number: int, frame: FrameType | None) -> None:
    del number, frame
    os._exit(1)


if os.path.basename(sys.argv[0]) in ("flightstack", "-m"):  # noqa: PTH119
    # While only this command starts, no other process runs yet: a signal may end it without a traceback.
    for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT, signal.SIGHUP):
        if signal.getsignal(_number) is not signal.SIG_IGN:
            signal.signal(_number, _end)
