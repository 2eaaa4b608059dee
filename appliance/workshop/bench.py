"""The instrument on the bench: it plays and records pictures through the shipped drivers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from appliance.instrument import CaptureReport, Devices, FrameStore, Grabber, ScanRecorder, ScanSettings, open_devices
from appliance.measure import SIDES, Fault
from appliance.store import Rig, hold_lock
from appliance.workshop.finding import BringupError
from drivers import rig as drivers_rig
from drivers.api import Board, Flip, Projector, Wires

Image = NDArray[np.uint8]
MOST_FRAMES = 64
"""Largest number of frames of one take: as many pulses as the board fires."""
TRIES = 3
"""Attempts to record one take: a single late flip or lost frame is chance, three faults in a row are not."""


@dataclass(frozen=True, slots=True)
class Shot:
    """Trigger and exposure of a take."""

    delay_us: int
    """Time from a vertical blank to the exposure, 0..15000."""
    exposure_us: int
    gain_db: float = 0.0
    blanks: int = 0
    """Number of blanks from the first picture's flip to that of the first exposure, 0..6."""


class Bench(Protocol):
    """An instrument on the bench, before a white surface."""

    @property
    def refresh_hz(self) -> float: ...

    @property
    def size_px(self) -> tuple[int, int]:
        """The projector's raster, (width, height)."""

    def load(self, pictures: Sequence[Image], *, all_channels: bool) -> None:
        """Take pictures (height, width) uint8 into the projector's memory, numbered from 0.

        Raises BringupError, DeviceError.
        """

    def take(self, order: Sequence[int], shot: Shot) -> Mapping[str, Image]:
        """Play the pictures ``order``, one per vertical blank, then dark, and return images (n, h, w) by side.

        Raises BringupError where it cannot be recorded, DeviceError where a device is lost.
        """


def flat_pictures(size_px: tuple[int, int], codes: Sequence[int]) -> list[Image]:
    """Return one uniform picture (h, w) for each code."""
    width, height = size_px
    return [np.full((height, width), code, np.uint8) for code in codes]


def lit_part(white: Image, black: Image, share: float = 0.5, max_dn: float = 240.0) -> NDArray[np.bool_]:
    """Return the pixels (h, w) that the projector lights well.

    They have at least ``share`` of the brightest light and are below ``max_dn``, where saturation is near.
    """
    # Signed: where a reflection moves, black may be the brighter one.
    light = white.astype(np.float32) - black
    usable = white < max_dn
    # The brightest hundredth: a glint or a hot pixel must not set the scale.
    top = float(np.quantile(light[usable], 0.99)) if usable.any() else 0.0
    is_lit: NDArray[np.bool_] = usable & (light > max(share * top, 1.0))
    return is_lit


def mean_levels(frames: Image, part: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the mean grey value of each frame (n, h, w) over ``part`` (h, w), (n,)."""
    return np.array([float(frame[part].mean()) for frame in frames])


class _ReorderedProjector:
    """A projector that plays its pictures in another order than they were loaded in; the last is dark."""

    def __init__(self, projector: Projector, order: Sequence[int]) -> None:
        self._projector, self._order = projector, order

    @property
    def size_px(self) -> tuple[int, int]:
        return self._projector.size_px

    def load(self, frames: Sequence[NDArray[np.uint8]]) -> None:
        self._projector.load(frames)

    def show(self, index: int) -> Flip:
        return self._projector.show(self._order[index])

    def play(
        self, indices: Sequence[int], idle: int, start: Callable[[Flip], int | None], abort: Callable[[], bool]
    ) -> list[Flip]:
        flips = self._projector.play([self._order[k] for k in indices], self._order[idle], start, abort)
        # Indices of the sequence, since the ledger counts frames, not pictures.
        return [replace(flip, index=k) for k, flip in enumerate(flips)]


class LightBench:
    """``Bench`` on the devices of a rig."""

    def __init__(self, rig: Rig, wires: Wires, store: FrameStore) -> None:
        self._rig, self._wires, self._store = rig, wires, store
        self._stack: ExitStack | None = None
        self._all_channels: bool | None = None
        self._devices: tuple[dict[str, Grabber], Board, Projector] | None = None
        self._loaded = 0

    @property
    def refresh_hz(self) -> float:
        return self._rig.projector.refresh_hz

    @property
    def size_px(self) -> tuple[int, int]:
        return self._rig.projector.width_px, self._rig.projector.height_px

    def load(self, pictures: Sequence[Image], *, all_channels: bool) -> None:
        """See ``Bench.load``. All devices are opened again where the channels change."""
        if self._devices is None or all_channels is not self._all_channels:
            self.close()
            self._open(all_channels)
        assert self._devices is not None
        dark = np.zeros((self._rig.projector.height_px, self._rig.projector.width_px), np.uint8)
        self._devices[2].load([*pictures, dark])
        self._loaded = len(pictures)

    def take(self, order: Sequence[int], shot: Shot) -> Mapping[str, Image]:
        """See ``Bench.take``. Images are views into the frame store: the next take overwrites them."""
        fault: Fault | None = None
        for _ in range(TRIES):
            fault = self.record(order, shot).fault
            if fault is None:
                return {side: self.frames(side, len(order)) for side in SIDES}
        assert fault is not None
        raise BringupError(
            f"{TRIES} recordings in a row failed: {fault.code.value}: {fault.detail}; run `kingfisher setup "
            "measure trigger`"
        )

    def record(self, order: Sequence[int], shot: Shot) -> CaptureReport:
        """Record the loaded pictures in ``order`` once and return the report, with or without a fault."""
        assert self._devices is not None, "pictures are loaded first"
        grabbers, board, projector = self._devices
        played = _ReorderedProjector(projector, [*order, self._loaded])
        settings = ScanSettings(self.refresh_hz, shot.exposure_us, shot.delay_us, shot.blanks)
        recorder = ScanRecorder(grabbers, board, played, self._wires.clock, settings)
        # The cameras apply it at their next start, which comes with each recording.
        for grabber in grabbers.values():
            grabber.expose(float(shot.exposure_us), shot.gain_db)
        return recorder.record(order, self._store, lambda _side, _index: None, lambda: None)

    def frames(self, side: str, count: int) -> Image:
        """Return ``count`` images (count, h, w) of the last recording, a view that the next one overwrites."""
        return self._store.frames(side)[:count]

    def close(self) -> None:
        """Close the devices. Idempotent."""
        if self._stack is not None:
            self._stack.close()
        self._stack, self._devices = None, None

    def _open(self, all_channels: bool) -> None:
        projector = replace(self._rig.projector, channels="all" if all_channels else "green")
        self._stack, self._all_channels = ExitStack(), all_channels
        devices = self._stack.enter_context(Devices(replace(self._rig, projector=projector), self._wires, _nothing))
        self._devices = open_devices(devices, self._wires.clock)


def _nothing(_projector: Projector) -> None:
    """Load no pictures: each measurement brings its own."""


@contextmanager
def light_bench(rig: Rig) -> Iterator[LightBench]:
    """Yield the bench on the rig's devices, which no instrument may be using.

    Raises DeviceError, BringupError, StorageError.
    """
    with (
        hold_lock(rig.storage.root),
        drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options) as wires,
        bench_on(rig, wires) as bench,
    ):
        yield bench


@contextmanager
def bench_on(rig: Rig, wires: Wires) -> Iterator[LightBench]:
    """Yield the bench to a caller that has the instrument's lock and its wires already.

    Raises DeviceError, BringupError.
    """
    left = rig.camera.left
    with FrameStore(MOST_FRAMES, left.height_px, left.width_px) as store:
        bench = LightBench(rig, wires, store)
        try:
            yield bench
        finally:
            bench.close()
