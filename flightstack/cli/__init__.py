"""The command line: each module contains the commands of one subject."""

from __future__ import annotations

import os
import signal
import sys

# While this command loads, it has no child processes, so Ctrl-C ends it immediately, without a traceback.
if (
    os.path.basename(sys.argv[0]) in ("flightstack", "-m")  # noqa: PTH119
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, signal.SIG_DFL)
