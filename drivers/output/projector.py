"""Playing patterns: resident frames, one per vertical blank, starting at a blank agreed beforehand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from drivers.api import DeviceError, Flip, Health
from drivers.output.surface import FlipStamp, P, Surface

FLIP_TIMEOUT_S, FLIP_PERIODS = 1.0, 6
"""Longest time of a flip, in s and in periods, whichever is longer: after that the projector counts as lost."""
COUNTER_TRIES = 3
"""Flips after which a counter that still reads zero does not exist."""
MAX_LEAD_BLANKS = 600
"""A start farther ahead than ten seconds is a mistake in counting."""
LATE_FRACTION = 1.5
"""Lateness in periods after its predecessor from which a flip missed a blank, where there is no counter."""
GREEN = 1


class PatternProjector(Generic[P]):
    """``drivers.api.Projector`` on any surface.

    Frames lie in its memory, so that playing copies no pixels.
    """

    def __init__(self, surface: Surface[P], *, all_channels: bool = False) -> None:
        """Play on ``surface`` in green, or with ``all_channels`` the same in blue, green and red.

        The latter is for a projector that makes three sub-frames of one colour out of them.
        """
        self._surface = surface
        self._channels = slice(0, 3) if all_channels else slice(GREEN, GREEN + 1)
        self._timeout_s = max(FLIP_TIMEOUT_S, FLIP_PERIODS / surface.refresh_hz)
        self._black = surface.create_picture()
        self._frames: list[P] = []
        self._loaded = 0

    @property
    def size_px(self) -> tuple[int, int]:
        return self._surface.size_px

    def load(self, frames: Sequence[NDArray[np.uint8]]) -> None:
        """Copy frames, (height, width) uint8 each, into scan-out buffers 0..n-1.

        Shows black from then on, so that no frame changes while it lights the scene. Red and blue stay 0, unless all
        channels are drawn into. Raises ValueError on a frame of another shape or type, DeviceError.
        """
        width, height = self._surface.size_px
        for index, frame in enumerate(frames):
            if frame.shape != (height, width) or frame.dtype != np.uint8:
                raise ValueError(
                    f"projector frame {index} is {frame.shape} {frame.dtype}; it must be ({height}, {width}) uint8"
                )
        self._surface.flip(self._black, self._timeout_s)
        self._loaded = 0
        while len(self._frames) < len(frames):
            self._frames.append(self._surface.create_picture())
        pixels = np.zeros((height, width, 4), np.uint8)
        for picture, frame in zip(self._frames, frames, strict=False):
            pixels[:, :, self._channels] = frame[:, :, None]
            picture.write(pixels)
        self._loaded = len(frames)

    def show(self, index: int) -> Flip:
        """Flip to one frame and stay there. Raises IndexError, DeviceGone."""
        picture = self._frame(index)
        self._surface.check_connection()
        return _flip(index, self._surface.flip(picture, self._timeout_s))

    def play(
        self,
        indices: Sequence[int],
        idle: int,
        start: Callable[[Flip], int | None],
        abort: Callable[[], bool],
    ) -> list[Flip]:
        """See ``drivers.api.Projector.play``. In any case ``idle`` stays on at the end.

        Without a counter of vertical blanks, ``start`` gets a flip without a sequence number: its result counts periods
        of the clock from that flip, and lateness is judged by time stamps alone. Raises IndexError for a frame that was
        not loaded, ValueError for an impossible start, DeviceGone.
        """
        frames = [(index, self._frame(index)) for index in indices]
        idle_picture = self._frame(idle)
        self._surface.check_connection()
        shown = self._settle(idle_picture)
        agreed = shown
        first = start(_flip(idle, agreed))
        if first is not None:
            ahead = first - (agreed.sequence or 0)
            self._require_reachable(ahead)
            while self._blanks_between(agreed, shown) + 1 < ahead:
                if abort():
                    return []
                shown = self._surface.flip(idle_picture, self._timeout_s)
        if agreed.sequence is None:
            first = None  # from here on each flip is compared with the one before it
        flips: list[Flip] = []
        try:
            for index, picture in frames:
                if abort():
                    break
                before, shown = shown, self._surface.flip(picture, self._timeout_s)
                if first is None:
                    first = shown.sequence  # as soon as possible is now
                late = self._is_late(len(flips), first, before, shown)
                flips.append(_flip(index, shown))
                if late:
                    break
        finally:
            self._surface.flip(idle_picture, self._timeout_s)
        return flips

    def health(self) -> Health:
        """Return the projector's entry in ``kingfisher check``."""
        return surface_health(self._surface)

    def close(self) -> None:
        """Switch the output off. Idempotent."""
        self._surface.close()

    def _settle(self, idle: P) -> FlipStamp:
        """Flip ``idle`` until its report shows whether blanks are counted."""
        shown = self._surface.flip(idle, self._timeout_s)
        for _ in range(COUNTER_TRIES - 1):
            if shown.sequence is not None:
                break
            shown = self._surface.flip(idle, self._timeout_s)
        return shown

    def _blanks_between(self, before: FlipStamp, now: FlipStamp) -> int:
        if before.sequence is not None and now.sequence is not None:
            return now.sequence - before.sequence
        return round((now.time_ns - before.time_ns) * 1e-9 * self._surface.refresh_hz)

    def _require_reachable(self, ahead: int) -> None:
        if ahead > MAX_LEAD_BLANKS:
            raise ValueError(f"play starts {ahead} blanks ahead; allowed are 2..{MAX_LEAD_BLANKS}")

    def _is_late(self, number: int, first: int | None, before: FlipStamp, shown: FlipStamp) -> bool:
        if first is not None:
            return shown.sequence != first + number
        return number > 0 and (shown.time_ns - before.time_ns) * 1e-9 > LATE_FRACTION / self._surface.refresh_hz

    def _frame(self, index: int) -> P:
        if not 0 <= index < self._loaded:
            raise IndexError(f"projector frame {index}; {self._loaded} are loaded, counted from 0")
        return self._frames[index]


def surface_health(surface: Surface[P]) -> Health:
    """Return a surface's entry in ``kingfisher check``: its mode, and the properties that were set."""
    summary, details = surface.describe()
    try:
        surface.check_connection()
    except DeviceError as error:
        return Health(surface.device, False, f"{error.message}. {error.remedy}", details)
    return Health(surface.device, True, summary, details)


def _flip(index: int, shown: FlipStamp) -> Flip:
    return Flip(index, shown.sequence, shown.time_ns)
