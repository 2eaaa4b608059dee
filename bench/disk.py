"""Cost of making a scan durable: raw frames at once, then the cloud, against the disk's own time."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.measure.points.table import Cloud
from appliance.store.library import Library
from appliance.store.manifest import SequenceInfo
from bench.result import Measurement
from bench.scan_frames import ScanFrames
from bench.timing import median_of
from tests.appliance.store.scenes import ORIGIN
from tests.appliance.store.scenes import record as plain_record


def durable(scan: ScanFrames, cloud: Cloud, parent: Path, rounds: int) -> Iterator[Measurement]:
    """Measure durable writes against plain writes of the same bytes, in alternating order, on one disk."""
    ours, plain, published = [], [], []
    with tempfile.TemporaryDirectory(dir=parent) as folder:
        library = Library(Path(folder) / "storage")
        library.prepare()
        record = plain_record(sequence=SequenceInfo.of(scan.sequence))
        for k in range(rounds):
            plain_first = k % 2 == 0
            if plain_first:
                plain.append(plain_ms(Path(folder) / str(k), scan.frames))
            begun_s = time.monotonic()
            pending = library.begin(scan.frames, record, ORIGIN)
            ours.append((time.monotonic() - begun_s) * 1e3)
            if not plain_first:
                plain.append(plain_ms(Path(folder) / str(k), scan.frames))
            begun_s = time.monotonic()
            pending.publish(record, cloud)
            published.append((time.monotonic() - begun_s) * 1e3)
    yield median_of("the disk's own time for the raw frames", plain, "ms", "disk_ms")
    beyond = [mine - disk for mine, disk in zip(ours, plain, strict=True)]
    yield median_of("raw frames durable, beyond that", beyond, "ms", "raw_durable_ms", at_most=100.0)
    yield median_of("cloud and manifest durable, scan published", published, "ms", "publish_ms")


def plain_ms(folder: Path, frames: dict[str, NDArray[np.uint8]]) -> float:
    """Return the clock time of a minimal durable write of the same bytes."""
    begun_s = time.monotonic()
    folder.mkdir()
    for side, stack in frames.items():
        with (folder / side).open("wb", buffering=0) as file:
            stack.tofile(file)
            os.fsync(file.fileno())
    return (time.monotonic() - begun_s) * 1e3
