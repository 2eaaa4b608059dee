"""Owns the memory of a scan's raw frames: one shared block that camera threads fill and the worker process reads."""

from __future__ import annotations

from contextlib import suppress
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

SIDES = ("left", "right")


class FrameStore:
    """Slots for one sequence of both cameras, allocated once. A context manager; the creator frees the memory.

    Frames go straight from the USB transfer into these slots; nothing copies them afterwards.
    """

    def __init__(self, frames: int, height_px: int, width_px: int, attach_to: str | None = None) -> None:
        """Allocate, or with ``attach_to`` open another process's store of the same shape. Raises OSError."""
        self.shape = (frames, height_px, width_px)
        size = 2 * frames * height_px * width_px
        self._owner = attach_to is None
        self._memory = SharedMemory(create=self._owner, size=size, name=attach_to)
        block = np.ndarray((2, *self.shape), np.uint8, buffer=self._memory.buf)
        if self._owner:
            block.fill(0)  # touch every page now, not during the first scan
        self._views: dict[str, NDArray[np.uint8]] = {"left": block[0], "right": block[1]}

    @property
    def name(self) -> str:
        """Name for ``attach_to``."""
        return self._memory.name

    def frames(self, side: str) -> NDArray[np.uint8]:
        """All slots of one side: (frames, height, width) uint8, a view."""
        return self._views[side]

    def close(self) -> None:
        """Give the memory back. Views taken before must not be used any more. Idempotent."""
        self._views.clear()
        with suppress(BufferError):  # a view is still referenced; the mapping goes with it
            self._memory.close()
        if self._owner:
            self._owner = False
            self._memory.unlink()

    def __enter__(self) -> FrameStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
