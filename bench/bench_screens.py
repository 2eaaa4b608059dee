"""What drawing costs: patterns once, screens at every refresh, and the copy into scan-out memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from appliance.patterns.draw import draw_sequence
from appliance.patterns.sequence import Direction, PatternSequence, build_sequence
from appliance.ranging.reach import Reach
from appliance.scan.grade import Grade
from appliance.screens.painter import Painter
from appliance.screens.views import AimView, Gauge, ReviewView
from bench.result import Measured
from drivers.output.display import PictureDisplay
from drivers.output.gl import open_gl
from drivers.output.projector import PatternProjector
from drivers.output.surface import Shown

REPEATS = 20


def measure() -> Iterator[Measured]:
    rng = np.random.default_rng(1)
    live = rng.integers(0, 256, (1200, 1600), dtype=np.uint8)
    points = rng.uniform((-120, -90, 460), (120, 90, 540), (1_300_000, 3)).astype(np.float32)
    aim = AimView(
        left=live, right=live, scans_taken=3, scans_left=40, temperature_c=31.0, gauge=Gauge(505.0, 4.0, Reach.OK)
    )
    review = ReviewView(
        points_mm=points, values=points[:, 2].copy(), coarse=False, grade=Grade.GOOD,
        points=len(points), coverage_percent=90.0, noise_mm=0.03, distance_mm=500.0, duration_s=1.0,
    )  # fmt: skip
    sequence = build_sequence(16)
    with open_gl() as gl, Painter(gl, (800, 480)) as painter:
        frames: list[NDArray[np.uint8]] = []
        took_ms = cpu_ms(lambda: frames.extend(draw_sequence(gl, sequence)), repeats=1)
        wrong = sum(
            int(np.count_nonzero(frame != np.broadcast_to(line, frame.shape)))
            for frame, line in zip(frames, lines(sequence), strict=True)
        )
        yield Measured("patterns of period 16, drawn", took_ms, "ms CPU", at_most=600.0)
        yield Measured("pixels unlike their code", wrong, "", at_most=0.0)
        yield Measured("aim screen", cpu_ms(lambda: painter.draw(aim, 0.1)), "ms CPU", at_most=50.0)
        first_ms = cpu_ms(lambda: painter.draw(review, 0.0), repeats=1)
        yield Measured("review screen, first of 1.3 M points", first_ms, "ms CPU", at_most=500.0)
        yield Measured("review screen, turning", cpu_ms(lambda: painter.draw(review, 2.0)), "ms CPU", at_most=100.0)
        picture = painter.draw(aim, 0.2)
        display = PictureDisplay(Memory((800, 480)))
        yield Measured("present, copy", cpu_ms(lambda: display.present(picture, 1.0)), "ms CPU", at_most=3.0)
        projector = PatternProjector(Memory((1024, 768)))
        yield Measured("load all patterns", cpu_ms(lambda: projector.load(frames), repeats=3), "ms CPU", at_most=500.0)


def lines(sequence: PatternSequence) -> Iterator[NDArray[np.uint8]]:
    """Each pattern by NumPy, to be broadcast over the picture."""
    for pattern in sequence.patterns:
        codes = pattern.codes()
        yield codes[np.newaxis, :] if pattern.direction is Direction.X else codes[:, np.newaxis]


def cpu_ms(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """CPU time of all threads per call, the least of five rounds; the first call is not counted unless it is all."""
    if repeats == 1:
        begun_s = time.process_time()
        work()
        return 1e3 * (time.process_time() - begun_s)
    work()
    rounds = []
    for _ in range(5):
        begun_s = time.process_time()
        for _ in range(repeats):
            work()
        rounds.append(1e3 * (time.process_time() - begun_s) / repeats)
    return min(rounds)


class MemoryPicture:
    """What a scan-out buffer is to the driver: rows of words."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.pixels = np.zeros((size_px[1], size_px[0], 4), np.uint8)

    def write(self, pixels: NDArray[np.uint8]) -> None:
        self.pixels[...] = pixels


class Memory:
    """A surface without hardware: every flip is at once, so that only the copying is measured."""

    device = "memory"
    refresh_hz = 60.0

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        self._blanks = 0

    def create_picture(self) -> MemoryPicture:
        return MemoryPicture(self.size_px)

    def flip(self, picture: MemoryPicture, timeout_s: float) -> Shown:
        self._blanks += 1
        return Shown(self._blanks, self._blanks * 16_666_667)

    def check_connection(self) -> None:
        """Nobody unplugs memory."""

    def describe(self) -> tuple[str, Mapping[str, str]]:
        return "memory", {}

    def close(self) -> None:
        """Nothing to give back."""
