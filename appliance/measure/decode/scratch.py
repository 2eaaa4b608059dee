"""The scratch row: one float32 buffer in which a row's quantities lie at constant distances.

LLVM vectorises a loop only if it knows that its outputs do not overlap its inputs. Separate arrays need a test at run
time for each pair, and beyond eight pairs it gives up. Within one array, at constant distances, no test is needed, so
that a loop may have as many inputs and outputs as the formula.

``s[GAP + x]`` stands for ``gap[x]``. A row that needs those above it has a scratch row of its own: they are used in
turns, and nothing is copied from one to the next. Quantities of the current chunk are in one more such buffer, always
at its beginning: it stays in the first-level cache, while the rows' quantities of all columns fit into the second one.

``borrowed`` gives arrays without reference counts. numba counts a reference for each view, also inside a kernel: two
atomic instructions on one number in memory that both threads of a reconstruction share, whose cache line they take from
each other. A row cut into its chunks has dozens of views; they took a sixth of the full cloud's time. A borrowed array
has no count. The caller's reference, which holds until the kernel returns, keeps its memory alive.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeVar, cast

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

Arrays = TypeVar("Arrays")
_BUILDING: Any = cgutils


class _Borrowed(Protocol):
    def __call__(self, arrays: Arrays, /) -> Arrays: ...


def _borrowed(_typing: Any, arrays: Any) -> Any:
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

    return arrays(arrays), generate


borrowed = cast(_Borrowed, intrinsic(_borrowed))
"""Return an array, or a named tuple of arrays, whose views count no references; inside of kernels only.

It is for a kernel's arguments: an array that the kernel allocates is freed when its name is last used. A borrowed array
must not leave the kernel, since it keeps no memory alive.
"""


MAX_WIDTH_PX = 4096
_SLOT = MAX_WIDTH_PX + 272
"""Number of elements between two quantities: 17 cache lines more than a multiple of 4096 bytes.

The same elements of different slots must not compete for the same lines, nor may a load have the last 12 address bits
of a recent store.
"""
_NAMES = 44
(
    P, Q,  # left coordinates
    U, V, U_START, V_START,  # right image point, and the pixel at which its Newton step begins
    UP, UQ, VQ, VP,  # inverse derivatives: px of the right image per px of the pattern
    PC, PL, PR, PT, PB, QC, QL, QR, QT, QB,  # right coordinates: centre, left, right, top, bottom
    SLOPE, MODULATION, MODULATION_RIGHT, OFFSET,
    BEND_RIGHT, RIGHT_SHARE, POINT_VARIANCE,  # towards sigma
    PHASE_VARIANCE, PHASE_VARIANCE_RIGHT,  # px² of the pattern, where maps carry it
    X1, Y1, SX1, SY1, X2, Y2, SX2, SY2, SHIFT, SHIFT_SLOPE,  # rays
    X, Y, Z, GAP, SIGMA,
) = (k * _SLOT + 8 for k in range(_NAMES))  # fmt: skip
"""First elements of the quantities, eight after a slot's start, so that neighbours of a row's ends are in the slot."""
SIZE = _NAMES * _SLOT
"""Number of elements in a scratch row."""

COORDINATE, MODULATION_HALF_DN = (k * _SLOT + 8 for k in range(2))
DECODING_SIZE = 2 * _SLOT
"""Number of elements in the scratch row of a row that is being decoded."""
