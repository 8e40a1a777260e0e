"""Imports all modules of subcommands that fly; the processes of the tests are forked from this process."""

import os
from importlib import import_module

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
for module in (
    "flightstack.cli.campaign", "flightstack.cli.flight", "flightstack.cli.logs", "flightstack.cli.main",
    "flightstack.launch.sitl", "logs.recorder.recorder", "sim.px4.process", "sim.runners.published_robot",
    "sim.runners.world_process",
):  # fmt: skip
    import_module(module)
import_module("logs.schema.schemas").typestore()


def first(numbers):
    return numbers[0]


import_module("flightstack.compiled.jit").jitted(first)(import_module("numpy").zeros(1))  # loads the compiler
