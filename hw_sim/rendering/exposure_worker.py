"""The threads that render images: exposures in, images out, one thread per camera, in order."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from hw_sim.timing.world_time import WorldTime

Image = NDArray[np.uint8]
MOST_WAITING = 40
"""Largest number of images under way for a camera, more than its memory holds."""


class PendingImage:
    """One image that is being rendered. Used with the world's lock held."""

    def __init__(self) -> None:
        self._image: Image | None = None
        self._waiting: list[Callable[[], None]] = []

    @property
    def ready(self) -> bool:
        """True if the image is ready."""
        return self._image is not None

    @property
    def image(self) -> Image:
        """The image (h, w) uint8. Raises RuntimeError before it is ready."""
        if self._image is None:
            raise RuntimeError("the image is not made yet")
        return self._image

    def when_ready(self, action: Callable[[], None]) -> None:
        """Call ``action`` now, or when the image is ready."""
        if self.ready:
            action()
        else:
            self._waiting.append(action)

    def finish(self, image: Image) -> None:
        """Set the image and call the waiting actions."""
        self._image = image
        waiting, self._waiting = self._waiting, []
        for action in waiting:
            action()


class ExposureWorker:
    """Renders images; an error goes to ``failed``, with the lock held."""

    def __init__(self, time: WorldTime, cameras: tuple[str, ...], failed: Callable[[BaseException], None]) -> None:
        self._time, self._failed = time, failed
        self._threads = {name: ThreadPoolExecutor(1, f"exposure-{name}") for name in cameras}
        self._pending = dict.fromkeys(cameras, 0)

    def make(self, camera: str, render: Callable[[], Image]) -> PendingImage | None:
        """Begin an image and return it, still pending; ``None`` if too many are under way.

        The caller holds the lock.
        """
        if self._pending[camera] >= MOST_WAITING:
            return None
        self._pending[camera] += 1
        pending_image = PendingImage()

        def done(pending: Future[Image]) -> None:
            with self._time.condition:
                self._pending[camera] -= 1
                if pending.cancelled() or self._time.closed:
                    return
                error = pending.exception()
                if error is not None:
                    self._failed(error)
                    return
                pending_image.finish(pending.result())
                self._time.condition.notify_all()

        self._threads[camera].submit(render).add_done_callback(done)
        return pending_image

    def close(self) -> None:
        """End the threads; the images under way are dropped."""
        for thread in self._threads.values():
            thread.shutdown(wait=True, cancel_futures=True)
