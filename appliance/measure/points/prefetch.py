"""Prefetching for kernels that know better than the processor which memory they will read next.

Chunks of a few hundred columns are too short for the hardware to learn the continuation of a row, and the next row
begins elsewhere.
"""

from __future__ import annotations

from typing import Any, Protocol, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

LINE_BYTES = 64
_BUILDING: Any = cgutils
_READ, _SECOND_LEVEL, _DATA = 0, 2, 1


class _Prefetch(Protocol):
    def __call__(self, array: NDArray[Any], place: int, /) -> None: ...


def _prefetch(_typing: Any, array: Any, _place: Any) -> Any:
    """Type and generate ``prefetch`` for numba."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        data = _BUILDING.create_struct_proxy(kind)(context, builder, value=arguments[0]).data
        address = builder.bitcast(builder.gep(data, [arguments[1]]), ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        ask = builder.module.declare_intrinsic(
            "llvm.prefetch", [address.type], ir.FunctionType(ir.VoidType(), [address.type, number, number, number])
        )
        builder.call(ask, [address, number(_READ), number(_SECOND_LEVEL), number(_DATA)])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


prefetch = cast(_Prefetch, intrinsic(_prefetch))
"""Fetch the cache line of an element of a contiguous one-dimensional array into the second-level cache; for kernels.

It reads no value: an index beyond the array does no harm, and results are the same with and without.
"""
