"""Imports everything that flying verbs need, in the process from which the tests' processes are forked."""

import os

from flightstack.cli.main import load

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
for verb in ("record", "world", "vehicle", "target", "onboard", "sitl", "campaign", "px4-sim"):
    load(verb)
