"""Picture of one real scan in time: recording, load of the worker's processors, and its results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction, PatternSequence
from bench.warm_worker import FRAME_S
from bench.whole_scan.paced import PacedScan

WIDTH_PX, LEFT_PX, RIGHT_PX, ROW_PX, GAP_PX, BUSY_PX = 1400, 190, 60, 30, 8, 120
INK, FAINT, WHITE = (40, 40, 40), (225, 225, 225), (255, 255, 255)
BOTH, ALONG_X, ALONG_Y = (150, 150, 150), (170, 120, 40), (60, 140, 60)
"""Frames of no direction, of the x block and of the y block: grey, blue, green."""
BUSY, CAME, DISK = (40, 110, 220), (60, 60, 60), (150, 60, 150)
LEGEND = (("bright and dark", BOTH), ("x block", ALONG_X), ("y block", ALONG_Y))
"""Meaning of the colours of the recording; other rows have their own labels."""
FONT = cv2.FONT_HERSHEY_SIMPLEX
BEFORE_MS, BEHIND_MS = 25.0, 15.0
"""Margins before the last frame and behind the full cloud, in the panel between them."""
BUSY_BIN_MS = 4.0
"""The worker's time is counted over this long: the kernel's own clock of it moves in steps of a millisecond."""
Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Span:
    """A bar from one time to another, in ms from the last frame on."""

    row: str
    begin_ms: float
    end_ms: float
    colour: tuple[int, int, int]
    note: str = ""


def draw(path: Path, title: str, sequence: PatternSequence, scan: PacedScan) -> None:
    """Write a PNG: all of ``scan``, and below it the time after the last frame. ``scan`` was traced."""
    spans = spans_of(sequence, scan)
    first_ms = -1e3 * FRAME_S * len(sequence)
    end_ms = max(scan.full_ms, scan.durable_ms) + BEHIND_MS
    overview = _panel(f"{title}: the whole scan, ms from the last frame on", spans, scan.trace, first_ms, end_ms)
    near = _panel(
        "from the last frame to the full cloud", spans, scan.trace, -BEFORE_MS, scan.full_ms + BEHIND_MS
    )  # fmt: skip
    cv2.imwrite(str(path), np.vstack([overview, near]))


def typical(scans: Sequence[PacedScan]) -> PacedScan:
    """Return the one of ``scans`` whose answers came nearest to their medians, by ratios. Raises ValueError without scans."""
    if not scans:
        raise ValueError("no scan was traced; trace at least one to draw")
    came = np.log([[scan.coarse_ms, scan.verdict_ms, scan.full_ms, scan.durable_ms] for scan in scans])
    return scans[int(np.abs(came - np.median(came, axis=0)).sum(1).argmin())]


def spans_of(sequence: PatternSequence, scan: PacedScan) -> list[Span]:
    """Return the bars: each frame from its blank to the next one, and each answer from the last frame on."""
    frame_ms, last = 1e3 * FRAME_S, len(sequence) - 1
    colours = [BOTH] * len(sequence)
    for direction, colour in ((Direction.X, ALONG_X), (Direction.Y, ALONG_Y)):
        axis = sequence.axis(direction)
        for index in (*axis.gray, *axis.sine):
            colours[index] = colour
    spans = [
        Span("recording", (k - last - 1) * frame_ms, (k - last) * frame_ms, colours[k]) for k in range(len(sequence))
    ]
    for row, at_ms, colour in (
        ("coarse cloud", scan.coarse_ms, CAME),
        ("verdict", scan.verdict_ms, CAME),
        ("full cloud", scan.full_ms, CAME),
        ("raw durable", scan.durable_ms, DISK),
    ):
        spans.append(Span(row, 0.0, at_ms, colour, f"{at_ms:.0f} ms"))
    return spans


def _panel(
    title: str, spans: Sequence[Span], trace: Sequence[tuple[float, float]], from_ms: float, to_ms: float
) -> Image:
    rows = list(dict.fromkeys(span.row for span in spans))
    top_px = 44
    image: Image = np.full((top_px + BUSY_PX + (len(rows) + 2) * (ROW_PX + GAP_PX), WIDTH_PX, 3), 255, np.uint8)
    bottom_px = image.shape[0] - ROW_PX
    across_px = WIDTH_PX - LEFT_PX - RIGHT_PX

    def x_of(at_ms: float) -> int:
        return LEFT_PX + int(across_px * min(max((at_ms - from_ms) / (to_ms - from_ms), 0.0), 1.0))

    _write(image, title, (12, 26), 0.6)
    legend_px = WIDTH_PX - RIGHT_PX
    for label, colour in reversed(LEGEND):
        (word_px, _), _ = cv2.getTextSize(label, FONT, 0.5, 1)
        legend_px -= word_px + 24
        cv2.rectangle(image, (legend_px, 14), (legend_px + 14, 28), colour, -1)
        _write(image, label, (legend_px + 20, 26))
        legend_px -= 16
    for mark_ms in _marks(from_ms, to_ms):
        cv2.line(image, (x_of(mark_ms), top_px), (x_of(mark_ms), bottom_px), FAINT, 1)
        _write(image, f"{mark_ms:.0f}", (x_of(mark_ms) - 12, bottom_px + 18))
    cv2.line(image, (x_of(0.0), top_px), (x_of(0.0), bottom_px), INK, 1)
    for number, row in enumerate(rows):
        y = top_px + number * (ROW_PX + GAP_PX) + (BUSY_PX + GAP_PX if number else 0)
        _write(image, row, (12, y + ROW_PX - 9))
        for span in spans:
            if span.row != row or span.end_ms <= from_ms or span.begin_ms >= to_ms:
                continue
            cv2.rectangle(image, (x_of(span.begin_ms), y), (x_of(span.end_ms) - 1, y + ROW_PX), span.colour, -1)
            if span.note and span.end_ms <= to_ms:
                # Inside the bar where there is no room behind it.
                inside = x_of(span.end_ms) > WIDTH_PX - 2 * RIGHT_PX
                note_px = (x_of(span.end_ms) - (70 if inside else -6), y + ROW_PX - 9)
                _write(image, span.note, note_px, colour=WHITE if inside else INK)
    _busy(image, top_px + ROW_PX + GAP_PX, trace, x_of, (from_ms, to_ms))
    return image


def _busy(
    image: Image,
    y: int,
    trace: Sequence[tuple[float, float]],
    x_of: Callable[[float], int],
    window_ms: tuple[float, float],
) -> None:
    """Draw how many processors the worker kept busy, over ``BUSY_BIN_MS`` each."""
    _write(image, "worker, processors", (12, y + BUSY_PX // 2))
    height_px = BUSY_PX - 10
    for count in (1, 2):
        line = y + BUSY_PX - count * height_px // 2
        cv2.line(image, (LEFT_PX, line), (WIDTH_PX - RIGHT_PX, line), FAINT, 1)
        _write(image, str(count), (LEFT_PX - 16, line + 5))
    at_ms, used_ms = np.array(trace).T
    edges_ms = np.arange(window_ms[0], window_ms[1], BUSY_BIN_MS)
    busy = np.diff(np.interp(edges_ms, at_ms, used_ms)) / BUSY_BIN_MS
    for begin_ms, share in zip(edges_ms, busy, strict=False):
        high = int(min(share, 2.0) * height_px / 2)
        corner = (x_of(begin_ms), y + BUSY_PX - high)
        cv2.rectangle(image, corner, (x_of(begin_ms + BUSY_BIN_MS), y + BUSY_PX), BUSY, -1)


def _marks(from_ms: float, to_ms: float) -> Sequence[float]:
    """Return round times, some ten of them."""
    step_ms = next(
        step for step in (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 5e3) if (to_ms - from_ms) / step <= 14
    )
    return [float(k * step_ms) for k in range(int(np.ceil(from_ms / step_ms)), int(to_ms // step_ms) + 1)]


def _write(
    image: Image, text: str, position_px: tuple[int, int], size: float = 0.5, colour: tuple[int, int, int] = INK
) -> None:
    cv2.putText(image, text, position_px, FONT, size, colour, 1, cv2.LINE_AA)
