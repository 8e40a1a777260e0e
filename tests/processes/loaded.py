"""Loads what the verbs that fly need: imported by the process from which those of the tests begin."""

import os

from flightstack.cli.main import load

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
for verb in ("record", "world", "vehicle", "target", "onboard", "sitl", "campaign", "px4-sim"):
    load(verb)
