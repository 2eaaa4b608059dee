"""Owns arrays without reference counts: what a kernel cuts views of by the thousand.

numba counts a reference for each view, also inside a kernel: two atomic instructions on one number in memory that both threads of
a reconstruction share, whose cache line they take from each other. A row cut into its chunks has dozens of views; they took a
sixth of the full cloud's time. An array that is borrowed has no number to count in. The caller's own reference, which holds until
the kernel returns, keeps its memory alive.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeVar, cast

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

Arrays = TypeVar("Arrays")
_BUILDING: Any = cgutils


class _Borrowed(Protocol):
    def __call__(self, given: Arrays, /) -> Arrays: ...


def _borrowed(_typing: Any, given: Any) -> Any:
    """Type and generate ``borrowed`` for numba."""

    def without_counts(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.BaseTuple):
            members: Any = kind
            for place, member in enumerate(members):
                part = without_counts(context, builder, member, builder.extract_value(value, place))
                value = builder.insert_value(value, part, place)
            return value
        if not isinstance(kind, types.Array):
            return value
        array = _BUILDING.create_struct_proxy(kind)(context, builder, value=value)
        array.meminfo, array.parent = (
            _BUILDING.get_null_value(array.meminfo.type),
            _BUILDING.get_null_value(array.parent.type),
        )
        return array._getvalue()

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return without_counts(context, builder, signature.args[0], arguments[0])

    return given(given), generate


borrowed = cast(_Borrowed, intrinsic(_borrowed))
"""Returns an array, or a named tuple with all of its arrays, whose views count no references; inside of kernels only.

To be asked of a kernel's arguments: what a kernel allocates is freed when its own name is last used. Nothing that is borrowed may leave
the kernel: it keeps no memory alive.
"""
