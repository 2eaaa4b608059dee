"""Owns small picture files: PNG with a palette of up to 256 colours, by the standard library (PNG 1.2, ISO 15948)."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
COLOURS, ROUNDS = 256, 6


def reduced(picture: Picture) -> tuple[NDArray[np.uint8], Picture]:
    """(h, w) indices and (n, 3) colours of an RGB picture: its own colours where they are 256 or fewer.

    Else frequent ones and some from all over, each moved a few times to the mean of what it stands for (Lloyd 1982). The same picture
    gives the same palette.
    """
    flat = picture.reshape(-1, 3).astype(np.int64)
    for drop in (0, 2):
        code = (flat[:, 0] >> drop) << 16 | (flat[:, 1] >> drop) << 8 | flat[:, 2] >> drop
        bins, place, number = np.unique(code, return_inverse=True, return_counts=True)
        if len(bins) <= COLOURS:
            break
    means = np.stack([np.bincount(place, flat[:, c], len(bins)) for c in range(3)], axis=1) / number[:, np.newaxis]
    if len(bins) <= COLOURS:
        return place.astype(np.uint8).reshape(picture.shape[:2]), means.round().astype(np.uint8)
    frequent = np.argsort(-number, kind="stable")
    rest = np.sort(frequent[COLOURS // 2 :])  # in the order of their codes: from all over the picture's colours
    spread = rest[np.linspace(0, len(rest) - 1, COLOURS // 2).astype(np.int64)]
    colours = means[np.concatenate([frequent[: COLOURS // 2], spread])]
    for _ in range(ROUNDS):
        nearest = _nearest(means, colours)
        weight = np.bincount(nearest, number, COLOURS)
        total = np.stack([np.bincount(nearest, number * means[:, c], COLOURS) for c in range(3)], axis=1)
        colours = np.where(weight[:, np.newaxis] > 0, total / np.maximum(weight, 1)[:, np.newaxis], colours)
    chosen = colours.round()
    return _nearest(means, chosen)[place].astype(np.uint8).reshape(picture.shape[:2]), chosen.astype(np.uint8)


def _nearest(means: NDArray[np.float64], colours: NDArray[np.float64]) -> NDArray[np.int64]:
    away = (means**2).sum(axis=1)[:, np.newaxis] - 2.0 * means @ colours.T + (colours**2).sum(axis=1)
    return np.asarray(away.argmin(axis=1), np.int64)


def write(path: Path, picture: Picture) -> None:
    """A picture (h, w, 3) uint8 RGB as a file. Raises OSError."""
    indices, colours = reduced(picture)
    height, width = indices.shape
    rows = np.zeros((height, width + 1), np.uint8)  # each row begins with its filter: none
    rows[:, 1:] = indices
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    parts = (
        (b"IHDR", header),
        (b"PLTE", colours.tobytes()),
        (b"IDAT", zlib.compress(rows.tobytes(), 9)),
        (b"IEND", b""),
    )
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))


def read(path: Path) -> Picture:
    """(h, w, 3) uint8 RGB. Raises ValueError for a file that is no picture."""
    picture = cv2.imread(str(path))
    if picture is None:
        raise ValueError(f"{path} cannot be read; draw it again: ./dev run python -m tests.appliance.screens.golden")
    return np.ascontiguousarray(picture[:, :, ::-1], np.uint8)
