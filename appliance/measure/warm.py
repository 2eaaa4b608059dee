"""The warm-up: an empty scan that runs every kernel once, to compile or load them.

Kernels are compiled at installation and loaded at start. ``run_every_kernel`` runs all; ``PIECES`` are the same in
pieces that can be compiled in parallel (``appliance.base.kernel_build``), the longest first. A kernel that a piece
omits is compiled when it is first needed; the tests compare both ways kernel by kernel. The pieces serve stored scans
as well: their frames are arrays of the same type.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
from numba.core import event
from numpy.typing import NDArray

from appliance.base import Piece
from appliance.measure.calibration.design import Design, design_calibration
from appliance.measure.calibration.file import Calibration
from appliance.measure.cloud import CloudLocation, CloudSummary
from appliance.measure.decode.backscatter import warm_up as warm_backscatter
from appliance.measure.decode.specks import warm_up as warm_specks
from appliance.measure.judges import JUDGES, JudgeInput, gather
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.noise import TYPICAL, TYPICAL_PAIR
from appliance.measure.light.patterns import PatternSequence, build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.light.water import Water
from appliance.measure.motion.estimate import estimate
from appliance.measure.motion.redecode import compensate
from appliance.measure.points import straighten
from appliance.measure.points.fuse import fuse
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.register import register_exposures
from appliance.measure.points.surface import surface_of
from appliance.measure.points.table import Cloud
from appliance.measure.points.veil import warm_up as warm_veil
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.identity.judge import judge_identity
from appliance.measure.verdicts.light.fit import warm_up as warm_light
from appliance.measure.verdicts.motion.harm import warm_up as warm_surface
from appliance.measure.verdicts.motion.texture import warm_up as warm_texture
from appliance.measure.verdicts.water.backscatter import warm_up as warm_water

_WATER = Water(20.0, 0.0, 530.0)
_DESIGN = Design(11.5, 112.5, 230.0, 12.41, 30.0, 5.0, 1.77)
_SIZE_PX = (64, 48)
_ALONG_MM = -0.67
"""Displacement per frame along the fringes: a hand of 40 mm/s at 60 Hz."""


def remaining_kernels(
    sequence: PatternSequence,
) -> tuple[Callable[[], object], ...]:
    """Return functions that run the kernels which an empty scan does not run.

    They are those for phase errors of the response, changing light, backscatter, specks, motion and a second exposure;
    otherwise the first scan that needs them would wait for a compiler. Each loads within a fraction of a second; those
    that more scans need come first.
    """
    # Only the types matter, not the sizes: large empty images would only have to be paged in.
    frames = np.zeros((len(sequence), *reversed(_SIZE_PX)), np.uint8)
    return (
        straighten.warm_up, warm_light, warm_water, warm_surface, warm_texture, partial(warm_backscatter, sequence, frames, TYPICAL), warm_veil,
        partial(warm_specks, frames), compensate_wall, _run_pair,
    )  # fmt: skip


def run_remaining_kernels(sequence: PatternSequence) -> None:
    """Run all of them."""
    for run in remaining_kernels(sequence):
        run()


@contextmanager
def watch_compiler() -> Iterator[Callable[[], bool]]:
    """Watch numba inside of the context; yields a function that returns whether it compiled a kernel."""
    with event.install_recorder("numba:compile") as recorder:
        yield lambda: bool(recorder.buffer)


def _run_pair() -> None:
    """Merge a small wall with itself."""
    shape = (48, 64)
    row, column = np.mgrid[0 : shape[0], 0 : shape[1]].reshape(2, -1)
    points = np.stack([0.5 * (column - 32.0), 0.5 * (row - 24.0), np.full(row.size, 500.0)], 1).astype(np.float32)
    ones = np.ones(row.size, np.float32)
    summary = CloudSummary(row.size, 100.0, 500.0, 1.0, 1.0)
    pixel = np.arange(row.size, dtype=np.uint32)
    wall = Cloud(points, np.ones(row.size, np.uint8), ones, ones, ones, pixel, summary)
    surface = surface_of(wall, wall, shape)
    registration = register_exposures(surface, wall)
    if registration is not None:
        fuse(surface, wall, wall, registration, (1.0, 1.0))


POINT_PIECES = (Piece("matching and triangulation", "appliance.measure.warm:find_points"),)
"""The pieces for points of images that were decoded elsewhere."""
PIECES = (
    *POINT_PIECES,
    Piece("motion compensation", "appliance.measure.warm:compensate_wall"),
    Piece("changing light", "appliance.measure.verdicts.light.fit:warm_up"),
    Piece("pattern identity", "appliance.measure.warm:judge_patterns"),
    Piece("motion verdict", "appliance.measure.warm:judge_scan"),
    Piece("backscatter and particles", "appliance.measure.warm:read_through_backscatter"),
    Piece("two exposures", "appliance.measure.warm:merge_walls"),
)
"""The pieces for every scan, just recorded or stored."""


def compensate_wall() -> None:
    """Run the kernels of motion compensation, in the dark, on a flat wall that moves with the fringes."""
    with _nothing() as (pipeline, calibration, frames):
        decoded = {side: pipeline.decoded(side) for side in SIDES}
        v, u = np.mgrid[0 : frames.shape[1], 0 : frames.shape[2]]
        # Dark frames have no coordinates; set some, so that the kernels have pixels to work on.
        for maps in decoded.values():
            maps.p_px[:], maps.q_px[:] = 12.0 * u, 12.0 * v
        images = ScanImages(pipeline.sequence, dict.fromkeys(SIDES, frames), decoded)
        origin, direction = calibration.rig.left.rays(
            np.stack([u, v], -1).reshape(-1, 2).astype(np.float64), _WATER.index
        )
        wall = origin + direction * ((500.0 - origin[:, 2:]) / direction[:, 2:])
        motion = estimate(images, calibration, _WATER, wall, np.arange(u.size, dtype=np.uint32))
        along = np.outer(np.arange(len(frames)), [_ALONG_MM, 0.0, 0.0, 0.0, 0.0, 0.0])
        compensate(images, calibration, _WATER, replace(motion, trajectory_mm=along))


def find_points() -> None:
    """Run the kernels from frames to clouds."""
    with _nothing() as (pipeline, _, frames):
        for side in SIDES:
            for index in range(len(frames)):
                pipeline.push(side, frames, index)
        pipeline.find_coarse()
        pipeline.find_full()
    straighten.warm_up()


def judge_patterns() -> None:
    """Run the kernels of the judge of identity."""
    with _nothing() as (pipeline, _, frames):
        judge_identity(dict.fromkeys(SIDES, frames), pipeline.sequence, TYPICAL_PAIR)


def judge_scan() -> None:
    """Run the kernels of the other verdicts."""
    warm_surface()
    warm_texture()
    with _nothing() as (pipeline, calibration, frames):
        decoded = {side: pipeline.decoded(side) for side in SIDES}
        images = ScanImages(pipeline.sequence, dict.fromkeys(SIDES, frames), decoded)
        cloud = pipeline.table.cloud(CloudLocation(((0, 0),), CloudSummary(0, 0.0, None, None, None)))
        samples = dict.fromkeys(SIDES, gather(frames, pipeline.sequence, TYPICAL))
        identity = Judgement(Verdict("identity", None))
        judge_input = JudgeInput(images, samples, cloud, calibration.rig, _WATER.index, identity, pipeline)
        for judge in JUDGES:
            if judge.name != "sight":  # it needs points, whose kernels are in another piece
                judge.judge(judge_input, dict.fromkeys(judge.needs))
    warm_water()


def read_through_backscatter() -> None:
    """Run the kernels for turbid water and specks."""
    with _nothing() as (pipeline, _, frames):
        warm_backscatter(pipeline.sequence, frames, TYPICAL)
        warm_veil()
        warm_specks(frames)


def merge_walls() -> None:
    """Run the kernels that merge two exposures."""
    _run_pair()


def run_every_kernel() -> None:
    """Run all kernels, with a small nominal instrument."""
    with _nothing() as (pipeline, calibration, frames):
        processor = SequenceProcessor(pipeline, calibration, _WATER)
        processor.process(dict.fromkeys(SIDES, frames), AcquisitionSettings())
        run_remaining_kernels(pipeline.sequence)


@contextmanager
def _nothing() -> Iterator[tuple[Pipeline, Calibration, NDArray[np.uint8]]]:
    """Yield a small nominal instrument, and the dark frames (n, h, w) of a scan."""
    width_px, height_px = _SIZE_PX
    calibration = design_calibration(_DESIGN, "kernels", width_px, height_px, _WATER)
    sequence = build_sequence(16)
    frames = np.zeros((len(sequence), height_px, width_px), np.uint8)
    # Only the types matter to numba, not contents or sizes: a few thousand dark pixels are enough.
    with Pipeline(calibration, _WATER, sequence) as pipeline:
        yield pipeline, calibration, frames
