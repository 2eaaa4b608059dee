"""The pipeline from two cameras' frames to a cloud.

Push frames as they arrive, then ask for the coarse and the full cloud. All buffers are allocated when the pipeline is
made, none during a scan.

After the last frame only the second direction of both cameras remains to be decoded, then the inverse map and every
eighth row and column: the coarse cloud. The full cloud follows in two blocks of rows, which two threads share
(``crew``). Each row passes through matching and triangulation in chunks of 256 columns, in the first-level cache.
Sixteen neighbours use one node of the right camera's rays, whose second-order series is within 0.1 µm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.calibration.gaps import GapModes
from appliance.measure.calibration.patches import without_veil
from appliance.measure.cloud import CloudLocation
from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.decode.scratch import MAX_WIDTH_PX
from appliance.measure.light.noise import TYPICAL_PAIR, StereoNoise
from appliance.measure.light.patterns import PatternSequence
from appliance.measure.light.rays import ray_lattice
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.light.water import Water
from appliance.measure.points.crew import Crew, WorkList, answers
from appliance.measure.points.match import RightMaps, fill_inverse_map, right_maps
from appliance.measure.points.quality import STILL, GapSampler, QualityLimits, measure_ripple, summarise
from appliance.measure.points.rows import LeftMaps, reconstruct_rows, scratch_rows
from appliance.measure.points.select import PointLimits
from appliance.measure.points.sigma import SigmaFactors, read_between, sigma_factors
from appliance.measure.points.straighten import CoordinateMaps, PhaseBend, measure_bend, take_out
from appliance.measure.points.table import Cloud, PointTable
from appliance.measure.points.triangulate import Rays, rays_of
from appliance.measure.points.veil import VeilFringes, find_veil, looks_veiled, remove_veil

COARSE_POINTS = 30_000
"""Number of left pixels in the grid of the coarse cloud; 20,000 points remain when 70 % of them see the object."""
MIN_COARSE_NEIGHBOURS = 2
"""Least number of neighbours of a coarse point, of eight: they are farther apart, and some lie beyond an edge."""
LOOSE_GAP_MM = np.float32(5.0)
"""Largest gap of the two rays of the same point, seen while it moved."""
VEIL_POINTS = 1_500
"""Number of left pixels from which the backscatter fringes are estimated."""
BLOCKS = 2
"""Number of blocks of rows that are reconstructed side by side.

Points depend on it a little: a block's first row has none above it.
"""
__all__ = ["Cloud", "Pipeline"]


class Pipeline:
    """Reconstructs scans of one sequence with one calibration in one water; reusable, not thread-safe.

    Points are left in ``table``, by default one of its own. Their standard deviations follow from ``noise``.
    ``helpers`` threads work beside the caller's; the results do not depend on their number. Raises ValueError for
    cameras wider than 4096 px and for a table that is too small.
    """

    def __init__(
        self,
        calibration: Calibration,
        water: Water,
        sequence: PatternSequence,
        limits: QualityLimits | None = None,
        table: PointTable | None = None,
        noise: StereoNoise = TYPICAL_PAIR,
        helpers: int = 1,
    ) -> None:
        left, right = calibration.rig.left, calibration.rig.right
        if max(left.width_px, right.width_px) > MAX_WIDTH_PX:
            raise ValueError(
                f"a camera is {max(left.width_px, right.width_px)} px wide; allowed are up to {MAX_WIDTH_PX} px"
            )
        self.table = table or PointTable(left.width_px * left.height_px)
        if self.table.capacity < left.width_px * left.height_px:
            raise ValueError(
                f"the table has room for {self.table.capacity} points; needed is one per left pixel, "
                f"{left.width_px * left.height_px}"
            )
        self._sequence = sequence
        self._decoders = {
            "left": CameraDecoder(sequence, left.width_px, left.height_px),
            "right": CameraDecoder(sequence, right.width_px, right.height_px),
        }
        self._rays, self._rig, self._index = _rays(calibration, water), calibration.rig, water.index
        right_decoder = self._decoders["right"]
        self._right = right_maps(
            right_decoder.p_px,
            right_decoder.q_px,
            right_decoder.modulation_half_dn,
            sequence.width_px,
            sequence.height_px,
        )
        self._gaps = _sampler(calibration, water)
        # A second one with another buffer, since ``matches`` may run beside the full cloud.
        self._match_sampler = _sampler(calibration, water)
        # Every second pixel fills the inverse map of a large image; a small one needs all.
        self._inverse_stride = 2 if right.width_px >= 800 else 1
        self._noise, self._ripple = noise, STILL
        self._factors = sigma_factors(sequence.period_px, noise)
        self._straight = False
        """This scan's coordinates were corrected for the response, or need no correction."""
        self._bend: PhaseBend | None = None
        """The phase error of this scan's coordinates; ``None``: not measured yet."""
        self._noisier = np.float32(1.0)
        """Factor by which the response correction multiplied the variance of the scan's coordinates."""
        volume = calibration.rig.volume
        self._limits = (limits or QualityLimits()).of(volume)
        self._pixel_mm = volume.scaled(0.16) * 1600.0 / left.width_px
        self._veil: VeilFringes | None = None
        self._frames: dict[str, NDArray[np.uint8]] = {}
        self._bright: NDArray[np.uint8] | None = None
        self._scratch = [scratch_rows() for _ in range(BLOCKS)]
        self._sampled = scratch_rows()
        """Scratch rows of ``sample``, which may run beside the full cloud."""
        self.crew = Crew(helpers)
        """The threads that work on the scans."""
        self.coarse_stride = coarse_stride_px(left.width_px, left.height_px)

    def __enter__(self) -> Pipeline:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the threads; otherwise they end with the process."""
        self.crew.close()

    def push(self, side: str, frames: NDArray[np.uint8], index: int) -> None:
        """Decode frame ``index`` of one side's ``frames`` (n, h, w) uint8, in order; one thread for each side."""
        self._decoders[side].push(frames, index)
        self._frames[side] = frames
        if side == "left" and index == self._sequence.bright:
            self._bright = frames[index]

    @property
    def limits(self) -> QualityLimits:
        """The limits that points must keep."""
        return self._limits

    @property
    def sequence(self) -> PatternSequence:
        """The sequence of the scans."""
        return self._sequence

    def expect(self, noise: StereoNoise) -> None:
        """Use this noise for the standard deviations of points from now on."""
        self._noise = noise
        self._factors = sigma_factors(self._sequence.period_px, noise, self._ripple)

    def reset(self) -> None:
        """Forget a scan that was begun; the next frame is frame 0."""
        for decoder in self._decoders.values():
            decoder.reset()

    def decoded(self, side: str) -> CameraDecoder:
        """Return the decoder of one side, for its maps."""
        return self._decoders[side]

    def recalibrate(self, calibration: Calibration, water: Water) -> None:
        """Use another calibration of cameras of the same size, or other water, from now on.

        A scan whose ``coarse`` was called stays decoded: ``full`` gives its points with the new calibration. Raises
        ValueError for cameras of another size.
        """
        for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
            height_px, width_px = self._decoders[side].p_px.shape
            if (camera.width_px, camera.height_px) != (width_px, height_px):
                raise ValueError(
                    f"the calibration's {side} camera has {camera.width_px} x {camera.height_px} px, this pipeline's "
                    f"{width_px} x {height_px} px; make another pipeline"
                )
        self._rays, self._rig, self._index = _rays(calibration, water), calibration.rig, water.index
        modes = GapModes(calibration.rig, water.index)
        self._gaps, self._match_sampler = GapSampler(modes), GapSampler(modes)

    def coarse(self) -> Cloud:
        """Return the coarse cloud. Call once per scan, after the last frame and before ``full``."""
        return self.table.cloud(self.find_coarse())

    def full(self) -> Cloud:
        """Return the full cloud: every left pixel with a valid correspondence. Call after ``coarse``."""
        return self.table.cloud(self.find_full())

    def find_coarse(self) -> CloudLocation:
        """Compute the coarse cloud, as ``coarse`` does, and leave the points in the table."""
        for decoder in self._decoders.values():
            decoder.finish()
        self._read_through_backscatter()
        self._veil = self._bend = None
        self._straight, self._noisier = False, np.float32(1.0)
        self._prepare()
        self._take_veil_out()
        return self._find(self.coarse_stride)

    def find_changed(
        self, bright: NDArray[np.uint8] | None = None, variance_px2: Mapping[str, NDArray[np.float32]] | None = None
    ) -> CloudLocation:
        """Compute the full cloud again, after ``coarse`` and a change of the decoders' maps.

        ``bright`` (h, w) uint8 is the left image for the points' grey values, in place of the sequence's bright frame.
        ``variance_px2`` holds for each side the variance (h, w) float32 of the changed coordinates, in px² of the
        pattern; without it, the variance follows from modulation, light and camera noise.
        """
        self._bright = self._bright if bright is None else bright
        # Merged maps are of two scans, each of which has had its response correction.
        self._straight = True
        self._prepare()
        if variance_px2 is None:
            return self.find_full()
        left = self._left_maps()._replace(variance_px2=variance_px2["left"])
        right = self._right._replace(variance_px2=variance_px2["right"])
        limits = self._kernel_limits(1)
        return self._with_gaps(self._find_in(left, right, self._factors, 1, limits, self.table))

    def _prepare(self) -> None:
        # The inverse map and the ripple are the scan's; sigma needs the latter.
        fill_inverse_map(self._right, self._inverse_stride)
        left, period_px = self._decoders["left"], self._sequence.period_px
        self._ripple = measure_ripple(left.p_px, left.illuminated_columns, period_px)
        factors = sigma_factors(period_px, self._noise, self._ripple)
        self._factors = factors._replace(scale2_px2=factors.scale2_px2 * self._noisier)

    def _read_through_backscatter(self) -> None:
        noises = {side: of_side(self._noise, side) for side in SIDES}

        def work(side: str) -> None:
            self._decoders[side].read_again_through_backscatter(self._frames[side], noises[side])

        self.crew.each(work, self._frames)

    def _take_veil_out(self) -> None:
        """Find the backscatter fringes along the rows, and remove them where they are strong."""
        if self._gaps is None or len(self._frames) < len(SIDES):
            return
        maps = {side: (decoder.p_px, decoder.q_px) for side, decoder in self._decoders.items()}
        if not looks_veiled(self._sequence, self._frames["left"], *maps["left"]):
            return
        stride = max(1, int((maps["left"][0].size / VEIL_POINTS) ** 0.5))
        self._veil = find_veil(self._sequence, self._frames, maps, self.sample(stride), self._rig, self._index)
        if self._veil is None or not self._veil.removable:
            return
        for side, decoder in self._decoders.items():
            veil = self._veil.sides[side]
            decoder.backscatter_pixels += remove_veil(
                veil, self._sequence.period_px, decoder.q_px, decoder.p_px, decoder.modulation_half_dn, decoder.mask
            )
        self._veil = self._veil.removed()
        self._prepare()

    def find_full(self, *, straightened: bool = True) -> CloudLocation:
        """Compute the full cloud, as ``full`` does, and leave the points in the table.

        ``straightened``: the response correction is applied to the decoders' maps first, if it is needed. A caller that
        will compare the maps with the frames needs them uncorrected.
        """
        if straightened and not self._straight:
            self._straighten()
        return self._with_gaps(self._find(1))

    def begin_full(self, tasks: WorkList) -> Callable[[], CloudLocation]:
        """Add the tasks of the full cloud to ``tasks`` and return a function that waits for it.

        Until then the maps must not change, and the table must not be used for anything else.
        """
        blocks = self._blocks(
            self._left_maps(), self._right, self._factors, 1, self._kernel_limits(1), self.table, self._scratch
        )
        added = [tasks.add(block) for block in blocks]
        return lambda: self._with_gaps(self._collect(answers(added), 1, self.table))

    def bend(self) -> PhaseBend:
        """Return the phase error of the decoded coordinates by the response.

        Call it between ``coarse`` and the full cloud.
        """
        if self._bend is None:
            self._bend = measure_bend(list(self._decoders.values()), self._sequence.period_px)
        return self._bend

    def masked(self) -> None:
        """Note that pixels were masked since ``bend``: the full cloud's phase error is measured without them."""
        self._bend = None

    def _straighten(self) -> None:
        self._straight = True
        bend = self.bend()
        if bend.counts:
            self._take_out(list(self._decoders.values()), bend)
            factor = bend.variance_factor(self._sequence.period_px)
            self._noisier = np.float32(factor)
            for decoder in self._decoders.values():
                decoder.variance_factor = factor
            self._prepare()

    def _take_out(self, cameras: Sequence[CoordinateMaps], bend: PhaseBend) -> None:
        """Subtract the phase error by the response from both cameras' coordinates."""
        self.crew.each(lambda camera: take_out(camera, bend, self._sequence.period_px), cameras)

    def _with_gaps(self, cloud: CloudLocation) -> CloudLocation:
        if self._gaps is None:
            return cloud
        decoder = self._decoders["left"]
        gaps = self._gaps.measure(decoder.p_px, decoder.q_px, self._right, self._rays)
        gaps = replace(gaps, pattern_size_px=(self._sequence.width_px, self._sequence.height_px))
        if self._veil is not None:
            gaps = without_veil(gaps, self._veil.gaps, (decoder.p_px.shape[1], decoder.p_px.shape[0]))
        return replace(cloud, gaps=gaps)

    def matches(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a sample of matched pixels (n, 2) of both cameras, also without a point; after ``coarse``."""
        if self._match_sampler is None:
            return np.empty((0, 2)), np.empty((0, 2))
        decoder = self._decoders["left"]
        return self._match_sampler.matches(decoder.p_px, decoder.q_px, self._right, self._rays)

    def sample(self, stride: int, any_depth: bool = False) -> Cloud:
        """Return every ``stride``-th left pixel's point, also with a large ray gap; call after ``coarse``.

        With ``any_depth``, points outside of the depth limits are included, for judges of their cause. The table does
        not change.
        """
        height_px, width_px = self._decoders["left"].p_px.shape
        table = PointTable(-(-width_px // stride) * -(-height_px // stride))
        limits = self._kernel_limits(stride)._replace(max_gap_mm=LOOSE_GAP_MM, max_sigma_mm=np.float32(np.inf))
        if any_depth:
            limits = limits._replace(min_depth_mm=np.float32(0.0), max_depth_mm=np.float32(np.inf))
        # Few points, by the caller alone: helpers may be busy with the full cloud and its scratch rows.
        rows = [self._sampled] * BLOCKS
        blocks = self._blocks(self._left_maps(), self._right, self._factors, stride, limits, table, rows)
        return table.cloud(self._collect([block() for block in blocks], stride, table))

    def find_replaced(self, left: LeftMaps, right: LeftMaps) -> CloudLocation:
        """Compute the full cloud of other maps than the decoded ones and leave the points in the table.

        These maps were interpolated between pixels. They get the response correction, if it is needed. Gaps are not
        sampled and are NaN: the rows come from a model of both cameras, so that the rays always meet. The decoded maps
        do not change. Raises ValueError for maps without variances: after interpolation the noise does not follow from
        the modulation.
        """
        if not (left.variance_px2.size and right.variance_px2.size):
            raise ValueError("maps read between pixels came without variances; give both sides' variance_px2")
        shown = self._sequence
        factors, bend = self._factors, measure_bend((left, right), shown.period_px)
        if bend.counts:
            self._take_out((left, right), bend)
            ripple = measure_ripple(left.p_px, left.illuminated_columns, shown.period_px)
            factors = sigma_factors(shown.period_px, self._noise, ripple)
            noisier = np.float32(bend.variance_factor(shown.period_px))
            left, right = (
                maps_of_camera._replace(variance_px2=maps_of_camera.variance_px2 * noisier)
                for maps_of_camera in (left, right)
            )
        maps = right_maps(
            right.p_px, right.q_px, right.modulation_half_dn, shown.width_px, shown.height_px, right.variance_px2
        )
        fill_inverse_map(maps, self._inverse_stride)
        # Cameras and projector have the same field of view.
        fringe_px = self._sequence.period_px / self._sequence.width_px * left.p_px.shape[1]
        factors = read_between(factors, fringe_px)
        cloud = self._find_in(left, maps, factors, 1, self._kernel_limits(1), self.table)
        for first, stop in cloud.pieces:
            self.table.points.gap_mm[first:stop] = np.nan
        return replace(cloud, summary=replace(cloud.summary, gap_mm=None))

    def _find(self, stride: int, limits: PointLimits | None = None, table: PointTable | None = None) -> CloudLocation:
        limits = limits or self._kernel_limits(stride)
        return self._find_in(self._left_maps(), self._right, self._factors, stride, limits, table or self.table)

    def _left_maps(self) -> LeftMaps:
        if self._bright is None:
            raise ValueError("no bright frame was pushed; push the whole sequence before asking for a cloud")
        decoder = self._decoders["left"]
        return LeftMaps(
            decoder.p_px,
            decoder.q_px,
            decoder.modulation_half_dn,
            self._bright,
            decoder.gray_threshold,
            decoder.illuminated_columns,
            np.float32(decoder.offset_per_threshold),
        )

    def _find_in(
        self,
        left: LeftMaps,
        right: RightMaps,
        factors: SigmaFactors,
        stride: int,
        limits: PointLimits,
        table: PointTable,
    ) -> CloudLocation:
        blocks = self._blocks(left, right, factors, stride, limits, table, self._scratch)
        return self._collect(self.crew.each(lambda block: block(), blocks), stride, table)

    def _blocks(
        self,
        left: LeftMaps,
        right: RightMaps,
        factors: SigmaFactors,
        stride: int,
        limits: PointLimits,
        table: PointTable,
        scratch: Sequence[NDArray[np.float32]],
    ) -> list[Callable[[], tuple[int, int]]]:
        """Return a function for each block of rows that finds its points, with scratch rows of its own."""
        points = table.points
        rows, columns = left.p_px.shape
        # Blocks begin at a row of the coarse grid.
        block = -(-rows // (BLOCKS * stride)) * stride
        columns = -(-columns // stride)

        def work(start: int) -> tuple[int, int]:
            # Each block has room for all of its pixels; what it does not need stays empty.
            first = start // stride * columns
            stop = min(start + block, rows)
            count = reconstruct_rows(
                left, right, self._rays, limits, factors, start, stop, stride, scratch[start // block], points, first
            )
            return first, first + int(count)

        return [partial(work, start) for start in range(0, rows, block)]

    def _collect(self, pieces: Sequence[tuple[int, int]], stride: int, table: PointTable) -> CloudLocation:
        illuminated = self._decoders["left"].illuminated_pixels // stride**2
        return CloudLocation(tuple(pieces), summarise(illuminated, table.points, tuple(pieces)))

    def _kernel_limits(self, stride: int) -> PointLimits:
        limits = self._limits
        # The limits grow with the noise; coordinates of coarse fringes are noisier.
        noise = max(1.0, self._sequence.period_px / 16.0)
        # The uncertainty of the backscatter fringes widens gaps along the rows without moving a point. Two standard
        # deviations, in mm.
        veil_mm = 2.0e-3 * self._veil.doubt_um if self._veil is not None and self._veil.removable else 0.0
        return PointLimits(
            max_gap_mm=np.float32(limits.max_gap_mm * noise + veil_mm),
            max_sigma_mm=np.float32(limits.max_sigma_mm * noise),
            min_depth_mm=np.float32(limits.min_depth_mm),
            max_depth_mm=np.float32(limits.max_depth_mm),
            max_step_mm=np.float32(limits.max_step_mm * self._pixel_mm / 0.16 * stride),
            min_neighbours=np.float32(limits.min_neighbours if stride == 1 else MIN_COARSE_NEIGHBOURS),
        )


def coarse_stride_px(width_px: int, height_px: int) -> int:
    """Return the distance of a coarse cloud's points in a left image of that size."""
    return max(1, int((width_px * height_px / COARSE_POINTS) ** 0.5))


def _rays(calibration: Calibration, water: Water) -> Rays:
    left, right = calibration.rig.left, calibration.rig.right
    index = water.index
    plane_z_mm = float(calibration.rig.volume_centre_mm(index)[2])
    return rays_of(ray_lattice(left, index, plane_z_mm), ray_lattice(right, index, plane_z_mm), left.width_px)


def _sampler(calibration: Calibration, water: Water) -> GapSampler | None:
    """Return the sampler of ray gaps; ``None`` for a calibration too extreme for meaningful gaps."""
    try:
        return GapSampler(GapModes(calibration.rig, water.index))
    except ValueError:
        return None
