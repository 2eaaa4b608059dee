"""Owns a scan of nothing, which runs every kernel once: at installation to compile them, at start to load them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.design import Design, design_calibration
from appliance.compensation.warm import run_every_kernel as run_compensation
from appliance.optics.water import Water
from appliance.patterns.sequence import PatternSequence, build_sequence
from appliance.reconstruct.fuse import fuse
from appliance.reconstruct.noise import TYPICAL
from appliance.reconstruct.pipeline import SIDES, Pipeline
from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.register import register
from appliance.reconstruct.specks import mask_specks
from appliance.reconstruct.surface import surface_of
from appliance.reconstruct.table import Cloud
from appliance.reconstruct.veiled import warm_up as read_veiled
from appliance.verdict.light_fit import warm_up as warm_light
from appliance.worker.scan_work import ScanWork, Taking

_DESIGN = Design(11.5, 112.5, 230.0, 12.41, 30.0, 5.0, 1.77)
_SIZE_PX = (64, 48)


def run_empty_scan(work: ScanWork, frames: NDArray[np.uint8]) -> None:
    """Push the same dark ``frames`` (n, h, w) for both sides, and ask for everything."""
    work.begin(Taking())
    for side in SIDES:
        for index in range(len(frames)):
            work.push(side, frames, index)
    work.identify()
    work.find_coarse()
    work.judge()
    work.find_full()


def run_what_an_empty_scan_does_not(sequence: PatternSequence, frames: NDArray[np.uint8]) -> None:
    """Kernels for motion, changing light, veil and a second exposure; else the first scan that has some would wait for a compiler."""
    run_compensation()
    warm_light()
    read_veiled(sequence, frames, TYPICAL)
    _run_pair()


def _run_pair() -> None:
    """A small wall, merged with itself."""
    shape = (48, 64)
    row, column = np.mgrid[0 : shape[0], 0 : shape[1]].reshape(2, -1)
    points = np.stack([0.5 * (column - 32.0), 0.5 * (row - 24.0), np.full(row.size, 500.0)], 1).astype(np.float32)
    ones = np.ones(row.size, np.float32)
    summary = CloudSummary(row.size, 100.0, 500.0, 1.0, 1.0)
    pixel = np.arange(row.size, dtype=np.uint32)
    wall = Cloud(points, np.ones(row.size, np.uint8), ones, ones, ones, pixel, summary)
    surface = surface_of(wall, wall, shape)
    found = register(surface, wall)
    if found is not None:
        fuse(surface, wall, wall, found, (1.0, 1.0))


def run_every_kernel() -> None:
    """With an instrument of its own; also for frames that cannot be written, as they come from the disk."""
    width_px, height_px = _SIZE_PX
    water = Water(20.0, 0.0, 530.0)
    calibration = design_calibration(_DESIGN, "kernels", width_px, height_px, water)
    sequence = build_sequence(16)
    with Pipeline(calibration, water, sequence) as pipeline:
        for writable in (True, False):
            frames = np.zeros((len(sequence), height_px, width_px), np.uint8)
            frames.flags.writeable = writable
            run_empty_scan(ScanWork(pipeline, calibration, water), frames)
            decoded = pipeline.decoded("left")
            decoded.mask.fill(0)
            mask_specks(sequence, frames, decoded, TYPICAL)
            run_what_an_empty_scan_does_not(sequence, frames)
