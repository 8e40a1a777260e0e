"""``mj_step`` for compiled code: the C function itself, and the contacts where MuJoCo keeps them.

Called this way a step costs no more than it does in C. Unlike under the Python binding, an internal error of
MuJoCo ends the process instead of raising.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, cast

import mujoco
import numpy as np
from llvmlite import binding
from numba import types

from sim.compiled.jit import is_off
from sim.world.raw_memory import address_of


class Contacts(NamedTuple):
    """Addresses of the contacts of the last step; the last three are of the first contact."""

    number: int  # one int
    stride: int  # bytes from one contact to the next
    geoms: int  # two ints
    place: int  # three doubles, world, m
    frame: int  # nine doubles, the normal first


def _library() -> str:
    """File of the MuJoCo library that the Python package has loaded.

    Raises:
        RuntimeError: it is not where the package should have it.
    """
    found = [p for p in Path(mujoco.__file__).parent.glob("*mujoco.*") if p.suffix != ".py"]
    if len(found) != 1:
        raise RuntimeError(f"MuJoCo's library: found {found}, one file is needed; install mujoco anew")
    return str(found[0])


def _load() -> Callable[[int, int], None]:
    """Make ``mj_step(address of mjModel, address of mjData)``, callable from compiled code."""
    path = _library()
    if is_off():
        function = ctypes.CDLL(path).mj_step
        function.argtypes, function.restype = (ctypes.c_void_p, ctypes.c_void_p), None
        return lambda model, data: function(int(model), int(data))  # numpy's whole numbers are not taken
    binding.load_library_permanently(path)  # now compiled code finds its symbols
    signature = types.void(types.intp, types.intp)
    return cast("Callable[[int, int], None]", types.ExternalFunction("mj_step", signature))


mj_step = _load()


def contacts(model: mujoco.MjModel, data: mujoco.MjData) -> Contacts:
    """Where ``data.ncon`` and ``data.contact`` stand; they never move.

    In mjdata.h ``ncon`` follows the array ``timer``, whose elements end in an int and four bytes of padding.
    The Python binding shows the array's memory but not that of ``ncon``; so this is checked on two states.
    ``contact`` is at the beginning of the arena, which is made once.

    Raises:
        RuntimeError: ``ncon`` is not there, as another MuJoCo might have it.
    """
    last = data.timer.number[-1:]
    address = address_of(last) + 2 * ctypes.sizeof(ctypes.c_int)
    count = np.ctypeslib.as_array((ctypes.c_int * 1).from_address(address))
    counts, found = [], []  # of both states; the arrays of the first, which has contacts
    scratch = (data.qpos.copy(), data.qvel.copy())
    for height_m in (0.0, 100.0):  # the vehicle in the floor, and in the air
        data.qpos[:] = 0.0
        data.qpos[2:4] = height_m, 1.0
        mujoco.mj_forward(model, data)
        counts.append((data.ncon, int(count[0])))
        found.append([getattr(data.contact, name) for name in ("geom", "pos", "frame")])
    data.qpos[:], data.qvel[:] = scratch
    mujoco.mj_resetData(model, data)
    if any(a != b for a, b in counts) or counts[0][0] == counts[1][0]:
        raise RuntimeError(
            f"MuJoCo {mujoco.__version__}: number of contacts and what stands in memory: {counts}, "
            "equal pairs are needed; this MuJoCo keeps ncon elsewhere, see mjdata.h"
        )
    return Contacts(address, found[0][0].strides[0], *map(address_of, found[0]))
