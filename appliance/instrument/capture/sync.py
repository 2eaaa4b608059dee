"""Owns the bridge between three clocks: which of the board's vertical syncs is which flip of the projector."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.api import Board, Flip, Vsync

MAX_PHASE_ERROR = 0.3
"""Largest distance, in periods, between a vertical sync as the board dates it and as the kernel does."""
MAX_QUERIES = 10


class SyncError(Exception):
    """The board's vertical sync does not follow the projector's; the text says by how much."""


@dataclass(frozen=True, slots=True)
class SyncMap:
    """Board vsync ``count`` is the blank of ``flip``; board time converts to host time around it."""

    flip: Flip
    count: int
    host_minus_board_ns: int
    phase_error: float
    """Phase error in periods, signed: board's vertical sync minus the kernel's flip time."""

    def host_ns(self, board_time_us: int) -> int:
        """Return the host time of a board time near the query (clock drift of 50 ppm makes 25 µs in half a second)."""
        return board_time_us * 1000 + self.host_minus_board_ns


def map_vsync(flip: Flip, vsync: Vsync, period_ns: float) -> SyncMap | None:
    """Return the map that one query supports; ``None`` when the query took too long or the phase does not fit."""
    # The board read its clock somewhere within the query: half of it is the error of the middle, here a quarter of a
    # period, of which 0.3 are allowed.
    if vsync.host_received_ns - vsync.host_sent_ns > 0.5 * period_ns:
        return None
    middle_ns = (vsync.host_sent_ns + vsync.host_received_ns) // 2
    host_minus_board_ns = middle_ns - vsync.board_now_us * 1000
    blanks = (vsync.board_time_us * 1000 + host_minus_board_ns - flip.time_ns) / period_ns
    whole = round(blanks)
    if abs(blanks - whole) > MAX_PHASE_ERROR:
        return None
    return SyncMap(flip, vsync.count - whole, host_minus_board_ns, blanks - whole)


def synchronise(board: Board, flip: Flip, period_ns: float) -> SyncMap:
    """Ask the board until two queries agree (at most ten). Raises SyncError, and the board's DeviceError."""
    counts: list[int] = []
    for _ in range(MAX_QUERIES):
        found = map_vsync(flip, board.vsync(), period_ns)
        if found is not None:
            # Two that agree, wherever they come among the ten: a late answer may be wrong by a whole period, but hardly
            # twice by the same.
            if found.count in counts:
                return found
            counts.append(found.count)
    raise SyncError(
        f"{MAX_QUERIES} queries gave the vertical sync numbers {counts} for one flip; two must agree; "
        "check the board's tap of the projector's video"
    )
