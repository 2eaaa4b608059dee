"""Owns the way from two cameras' frames to a cloud: push frames as they arrive, then coarse, then full.

All buffers are allocated when the pipeline is made, none during a scan.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.optics.rays import ray_lattice
from appliance.optics.water import Water
from appliance.patterns.sequence import PatternSequence
from appliance.reconstruct.decode import CameraDecoder, Mask
from appliance.reconstruct.match import fill_inverse_map, match_rows, node_size_px
from appliance.reconstruct.quality import CloudSummary, QualityLimits, select_points, summarise
from appliance.reconstruct.triangulate import triangulate_rows

SIDES = ("left", "right")
COARSE_POINTS = 30_000
THREADS = 2


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points in the left camera frame, with what is known about each. All arrays have the same length n."""

    points_mm: NDArray[np.float32]
    """(n, 3) float32."""
    intensity: NDArray[np.uint8]
    """(n,) uint8, the left camera's bright frame."""
    modulation_dn: NDArray[np.float32]
    ray_gap_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    pixel: NDArray[np.uint32]
    """(n,) uint32: flat index of the left pixel."""
    summary: CloudSummary


class Pipeline:
    """Reconstructs scans of one sequence with one calibration in one water; reusable, not thread-safe."""

    def __init__(
        self, calibration: Calibration, water: Water, sequence: PatternSequence, limits: QualityLimits | None = None
    ) -> None:
        left, right = calibration.rig.left, calibration.rig.right
        self._sequence = sequence
        self._limits = limits or QualityLimits()
        self._decoders = {
            "left": CameraDecoder(sequence, left.width_px, left.height_px),
            "right": CameraDecoder(sequence, right.width_px, right.height_px),
        }
        index = water.index
        plane_z_mm = float(calibration.rig.volume_centre_mm(index)[2])
        self._left_rays = ray_lattice(left, index, plane_z_mm)
        self._right_rays = ray_lattice(right, index, plane_z_mm)
        shape = (left.height_px, left.width_px)
        self._node_px = node_size_px(right.width_px)
        self._inverse_stride = 2 if right.width_px >= 800 else 1
        self._inverse = np.empty(
            (sequence.height_px // self._node_px + 2, sequence.width_px // self._node_px + 2), np.int32
        )
        self._right_u, self._right_v, self._slope, self._gap, self._sigma = (
            np.full(shape, np.nan, np.float32) for _ in range(5)
        )
        self._points = np.full((*shape, 3), np.nan, np.float32)
        self._chosen = np.empty(shape[0] * shape[1], np.uint32)
        self._bright: NDArray[np.uint8] | None = None
        self._pixel_mm = 0.16 * 1600.0 / left.width_px
        self.coarse_stride = max(1, int((shape[0] * shape[1] / COARSE_POINTS) ** 0.5))

    def push(self, side: str, frames: NDArray[np.uint8], index: int) -> None:
        """Work on frame ``index`` of one side's ``frames`` (n, h, w) uint8; in order. Sides may run in two threads."""
        self._decoders[side].push(frames, index)
        if side == "left" and index == self._sequence.bright:
            self._bright = frames[index]

    def reset(self) -> None:
        """Forget a scan that was begun; the next frame is frame 0."""
        for decoder in self._decoders.values():
            decoder.reset()

    def decoded(self, side: str) -> CameraDecoder:
        """The decoder of one side, for its maps."""
        return self._decoders[side]

    def coarse(self) -> Cloud:
        """After the last frame: the coarse cloud. Call once per scan, before ``full``."""
        with ThreadPoolExecutor(THREADS, "kf-decode") as pool:
            list(pool.map(lambda side: self._decoders[side].finish(), SIDES))
        right = self._decoders["right"]
        fill_inverse_map(right.p_px, right.q_px, right.mask, self._inverse_stride, self._node_px, self._inverse)
        return self._cloud(self.coarse_stride)

    def full(self) -> Cloud:
        """The full cloud: every left pixel that has a true correspondence. Call after ``coarse``."""
        return self._cloud(1)

    def _cloud(self, stride: int) -> Cloud:
        left, right = self._decoders["left"], self._decoders["right"]
        if self._bright is None:
            raise ValueError("no bright frame was pushed; push the whole sequence before asking for a cloud")
        bright = self._bright
        rows = bright.shape[0]
        block = -(-rows // (THREADS * stride)) * stride

        def work(start: int) -> None:
            stop = min(start + block, rows)
            match_rows(
                left.p_px,
                left.q_px,
                left.mask,
                right.p_px,
                right.q_px,
                right.mask,
                self._inverse,
                self._node_px,
                start,
                stop,
                stride,
                self._right_u,
                self._right_v,
                self._slope,
            )
            triangulate_rows(
                self._left_rays.nodes,
                self._right_rays.nodes,
                self._left_rays.step_px,
                self._left_rays.plane_z_mm,
                self._right_u,
                self._right_v,
                self._slope,
                right.modulation_dn,
                left.modulation_dn,
                bright,
                float(self._sequence.period_px),
                start,
                stop,
                stride,
                self._points,
                self._gap,
                self._sigma,
            )

        with ThreadPoolExecutor(THREADS, "kf-match") as pool:
            list(pool.map(work, range(0, rows, block)))
        limits = self._limits
        noise_steps = self._sequence.period_px / 16.0
        count = select_points(
            self._points,
            self._gap,
            self._sigma,
            stride,
            limits.max_gap_mm * max(1.0, noise_steps),
            limits.max_sigma_mm * max(1.0, noise_steps),
            limits.min_depth_mm,
            limits.max_depth_mm,
            limits.max_step_mm * self._pixel_mm / 0.16,
            limits.min_neighbours,
            self._chosen,
        )
        pixel = self._chosen[:count].copy()
        points = self._points.reshape(-1, 3)[pixel]
        gap = self._gap.reshape(-1)[pixel]
        sigma = self._sigma.reshape(-1)[pixel]
        lit = int(np.count_nonzero(left.mask[::stride, ::stride] != Mask.SHADOW))
        return Cloud(
            points_mm=points,
            intensity=bright.reshape(-1)[pixel],
            modulation_dn=left.modulation_dn.reshape(-1)[pixel],
            ray_gap_mm=gap,
            sigma_mm=sigma,
            pixel=pixel,
            summary=summarise(lit, points, sigma, gap),
        )
