"""Owns a scan of nothing, which runs every kernel once: at installation to compile them, at start to load them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.design import Design, design_calibration
from appliance.compensation.warm import run_every_kernel as run_compensation
from appliance.optics.water import Water
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.noise import TYPICAL
from appliance.reconstruct.pipeline import SIDES, Pipeline
from appliance.reconstruct.specks import mask_specks
from appliance.reconstruct.veiled import warm_up
from appliance.verdict.light_fit import fit_blocks
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


def run_light_fit() -> None:
    """The kernels of changing light, which an empty scan does not reach; else the first scan would wait for their compiler."""
    some = np.ones(4)
    fit_blocks(np.eye(4), some, some, some, np.arange(4), np.array([4]))


def run_every_kernel() -> None:
    """With an instrument of its own; also for frames that cannot be written, as they come from the disk."""
    width_px, height_px = _SIZE_PX
    water = Water(20.0, 0.0, 530.0)
    calibration = design_calibration(_DESIGN, "kernels", width_px, height_px, water)
    sequence = build_sequence(16)
    run_compensation()
    run_light_fit()
    with Pipeline(calibration, water, sequence) as pipeline:
        for writable in (True, False):
            frames = np.zeros((len(sequence), height_px, width_px), np.uint8)
            frames.flags.writeable = writable
            run_empty_scan(ScanWork(pipeline, calibration, water), frames)
            decoded = pipeline.decoded("left")
            decoded.mask.fill(0)
            mask_specks(sequence, frames, decoded, TYPICAL)
            warm_up(sequence, frames, TYPICAL)
