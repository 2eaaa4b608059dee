"""Owns the scratch row: one float32 buffer in which a row's quantities lie at constant distances.

LLVM turns a loop into vector instructions only when it knows that what is written is not what is read next. Separate
arrays need a test at run time for each pair, and beyond eight pairs it gives up. Within one array, at distances that
are constants, it needs none, so that a loop may have as many inputs and outputs as the formula has.

``s[GAP + x]`` is then what ``gap[x]`` would be. A row that needs those above it has a scratch row of its own: they take
turns, and nothing is copied from one to the next. What only the chunk in work needs lies in one more such buffer,
always at its beginning: it stays in the first-level cache, while the rows' own quantities, of all columns, fit into the
second one.

It also owns arrays without reference counts: what a kernel cuts views of by the thousand.

numba counts a reference for each view, also inside a kernel: two atomic instructions on one number in memory that both
threads of a reconstruction share, whose cache line they take from each other. A row cut into its chunks has dozens of
views; they took a sixth of the full cloud's time. An array that is borrowed has no number to count in. The caller's own
reference, which holds until the kernel returns, keeps its memory alive.
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

To be asked of a kernel's arguments: what a kernel allocates is freed when its own name is last used. Nothing that is
borrowed may leave the kernel: it keeps no memory alive.
"""


MAX_WIDTH_PX = 4096
_SLOT = MAX_WIDTH_PX + 272
"""Places between two quantities: 17 cache lines more than a multiple of 4096 bytes.

Equal places in different slots must not compete for the same lines, nor may a load look, by its last 12 bits, like a
store that has just been made.
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
"""First places of the quantities, eight before the first column: the neighbours of a row's ends are inside the slot."""
SIZE = _NAMES * _SLOT
"""Number of places in a scratch row."""

COORDINATE, MODULATION_HALF_DN = (k * _SLOT + 8 for k in range(2))
DECODING_SIZE = 2 * _SLOT
"""Number of places in the scratch row of a row that is being decoded."""
