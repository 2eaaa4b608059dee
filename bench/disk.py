"""Owns what it costs to make a scan durable: raw frames at once, then the cloud, against the disk's own time."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.reconstruct.table import Cloud
from appliance.storage.library import Library
from appliance.storage.record import SequenceInfo
from bench.result import Measured
from bench.scan_frames import ScanFrames
from bench.timing import median_of, wall_ms
from tests.appliance.storage.scenes import record as plain_record


def durable(scan: ScanFrames, cloud: Cloud, parent: Path, rounds: int) -> Iterator[Measured]:
    """In turns with the same bytes written plainly, each time in the other order; on the disk of ``parent``."""
    ours, plain, published = [], [], []
    with tempfile.TemporaryDirectory(dir=parent) as folder:
        library = Library(Path(folder) / "storage")
        library.prepare()
        record = plain_record(sequence=SequenceInfo.of(scan.sequence))
        for k in range(rounds):

            def write(number: int = k) -> None:
                write_plainly(Path(folder), number, scan.frames)

            if k % 2:
                plain.append(wall_ms(write))
            pending = []
            ours.append(wall_ms(lambda into=pending: into.append(library.begin(scan.frames, record))))  # type: ignore[misc]
            if not k % 2:
                plain.append(wall_ms(write))
            published.append(wall_ms(lambda of=pending: of[0].publish(record, cloud)))  # type: ignore[misc]
    yield median_of("the disk's own time for the raw frames", plain, "ms", "disk_ms")
    beyond = [mine - disk for mine, disk in zip(ours, plain, strict=True)]
    yield median_of("raw frames durable, beyond that", beyond, "ms", "raw_durable_ms", at_most=100.0)
    yield median_of("cloud and manifest durable, scan published", published, "ms", "publish_ms")


def write_plainly(folder: Path, number: int, frames: dict[str, NDArray[np.uint8]]) -> None:
    """The same bytes with as little ado as a durable write allows."""
    for side, stack in frames.items():
        with (folder / f"{number}-{side}").open("wb", buffering=0) as file:
            stack.tofile(file)
            os.fsync(file.fileno())
