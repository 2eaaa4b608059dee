"""Memory for a scan's raw frames: one shared block that camera threads fill and the worker reads.

The second of two sequences is another exposure of the same scene: 2 · 2 · 24 frames of 1600 × 1200 are 184 MB, all
memory of a scan. The first sequence's frames stay while the second one is recorded, so that a failure costs only the
second.
"""

from __future__ import annotations

from contextlib import suppress
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from appliance.measure import SIDES


class FrameStore:
    """Slots for one or more sequences of both cameras, allocated once.

    A context manager; the creator frees the memory. Frames go straight from the USB transfer into these slots, and are
    not copied afterwards.
    """

    def __init__(
        self, frames: int, height_px: int, width_px: int, attach_to: str | None = None, sequences: int = 1
    ) -> None:
        """Allocate memory for ``sequences``, or open that of another process (``attach_to``).

        Both must have the same size of frames. Raises OSError.
        """
        self.shape = (frames, height_px, width_px)
        sequence_bytes = 2 * frames * height_px * width_px
        self._owner = attach_to is None
        self._memory = SharedMemory(create=self._owner, size=sequences * sequence_bytes, name=attach_to)
        # The number of sequences follows from the block's size, which may be rounded up by less than one.
        self.sequences = sequences if self._owner else self._memory.size // sequence_bytes
        """Number of sequences that there is room for."""
        block = np.ndarray((self.sequences, 2, *self.shape), np.uint8, buffer=self._memory.buf)
        if self._owner:
            block.fill(0)  # touch every page now, not during the first scan
        self._views: dict[tuple[str, int], NDArray[np.uint8]] = {
            (side, k): block[k, number] for k in range(self.sequences) for number, side in enumerate(SIDES)
        }

    @property
    def name(self) -> str:
        """Name for ``attach_to``."""
        return self._memory.name

    def frames(self, side: str, *, second: bool = False) -> NDArray[np.uint8]:
        """Return all slots of one side in the first or the ``second`` sequence.

        (frames, height, width) uint8, a view.
        """
        return self._views[side, int(second)]

    def close(self) -> None:
        """Free the memory. Views must no longer be used. Idempotent."""
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
