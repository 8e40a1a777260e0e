"""Arrays on the memory of a C library, made from an address, at no cost in compiled code.

An array handed to compiled code costs 0.2 us a call instead, and a tuple of them twice that. Nothing looks
after the memory: who passes an address on must keep its owner alive.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic

from sim.compiled.jit import is_off, jitted
from sim.compiled.records import F64

I32 = npt.NDArray[np.int32]


def address_of(array: npt.NDArray[Any]) -> int:
    """Address of an array's first element."""
    return int(array.__array_interface__["data"][0])


@intrinsic  # type: ignore[untyped-decorator]
def _pointer(typing_context: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        return builder.inttoptr(args[0], cgutils.voidptr_t)

    del typing_context
    return types.voidptr(address), generate


@jitted
def doubles(address: int, count: int) -> F64:
    """Array of the doubles at an address."""
    return carray(_pointer(address), (count,), np.float64)  # type: ignore[no-any-return]


@jitted
def ints(address: int, count: int) -> I32:
    """Array of the 32-bit integers at an address."""
    return carray(_pointer(address), (count,), np.int32)  # type: ignore[no-any-return]


if is_off():

    def doubles(address: int, count: int) -> F64:
        """The same in plain Python."""
        return np.ctypeslib.as_array((ctypes.c_double * count).from_address(int(address)))

    def ints(address: int, count: int) -> I32:
        """The same in plain Python."""
        return np.ctypeslib.as_array((ctypes.c_int32 * count).from_address(int(address)))
