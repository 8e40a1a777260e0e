"""Access to C functions and C memory by address: compiled code uses them without calling Python.

Plain Python (``NUMBA_DISABLE_JIT=1``) uses ctypes. An address is valid as long as its owner exists.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any, Protocol

from flightstack.compiled.jit import is_off, load_numba


class Doubles(Protocol):
    """Array of C doubles that can be read and written; the index is not checked."""

    def __getitem__(self, index: int) -> float: ...
    def __setitem__(self, index: int, value: float) -> None: ...


if TYPE_CHECKING or is_off():
    _NUMBERS = ctypes.POINTER(ctypes.c_double)

    def doubles(address: int) -> Doubles:
        """Return a pointer to the C doubles at an address."""
        return ctypes.cast(int(address), _NUMBERS)

    def whole(address: int) -> int:
        """Return the C int at an address."""
        return ctypes.c_int.from_address(int(address)).value

    def call(function: int, arguments: tuple[int, ...]) -> int:
        """Call a C function with pointers and integers; return its int, undefined for a ``void`` function."""
        kind = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * len(arguments))
        return int(kind(int(function))(*[int(each) for each in arguments]))

else:
    load_numba()
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils
    from numba.extending import intrinsic

    @intrinsic
    def doubles(_typing: Any, _address: Any) -> Any:
        """Return a pointer to the C doubles at an address."""

        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(types.float64)(types.intp), code

    @intrinsic
    def whole(_typing: Any, _address: Any) -> Any:
        """Return the C int at an address."""

        def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.load(builder.inttoptr(arguments[0], ir.IntType(32).as_pointer()))

        return types.int32(types.intp), code

    @intrinsic
    def call(_typing: Any, _function: Any, arguments: Any) -> Any:
        """Call a C function with pointers and integers; return its int, undefined for a ``void`` function."""

        def code(_context: Any, builder: Any, signature: Any, values: Any) -> Any:
            given = cgutils.unpack_tuple(builder, values[1], len(signature.args[1]))
            kind = ir.FunctionType(ir.IntType(32), [each.type for each in given]).as_pointer()
            return builder.call(builder.inttoptr(values[0], kind), given)

        return types.int32(types.intp, types.UniTuple(types.intp, len(arguments))), code
