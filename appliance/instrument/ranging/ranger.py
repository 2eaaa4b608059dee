"""Distance of the object from the two laser dots in one stereo pair of live images.

    Ranger                finds the laser dots, and computes the distance and, with both dots, the tilt
    OtherCamera           for a dot that one camera sees: whether the other has an equally bright spot along that ray
    shines_in_the_dark    names the pointers whose dot is in the dark frame of a sequence, though lasers must be off

If both cameras see a dot, it counts if their refracted rays meet, and meet on the pointer's beam. If one camera sees
it, its ray is intersected with the beam. Such a dot counts beside the other pointer's dot on the same surface. Alone,
it must be bright and stay where it is, and the other camera must see no similar spot along the ray: an illuminated
corner, a print or a speck near the cameras would be seen there, too. Ambiguous dots do not count.

In a dark frame, print may look like a dot. The projector's light makes print brighter in the bright frame, but not a
laser dot. Positions are in the rig frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.beams import DOT_SD_MM, PointerBeam, RigFrame
from appliance.instrument.ranging.dots import COARSE_PX, EDGE_PX, Candidate, Lane, contrast_of, dot_range_mm
from appliance.instrument.ranging.reach import Marks, Range, marks_of
from appliance.measure import StereoRig

Array = NDArray[np.float64]

_BEGIN_MM = 150.0
"""Depth in the rig frame, for the standard housing, at which the search along the ray begins.

Nearer objects are out of focus and before one camera alone.
"""
_NEAR_MM, _FAR_MM = 330.0, 620.0
"""Depths, for the standard housing, between which the other camera must see the complete ray."""
_STEP_MM = 4.0
HALF_PX = 3
"""Half width of the band along the ray's image, in coarse px: the calibration's error, and the size of a spot."""
LIKE = 0.25
"""Share of the dot's contrast from which a spot counts as similar."""


class OtherCamera:
    """Checks in one camera's image a dot that only the other camera sees."""

    def __init__(self, rig: StereoRig, frame: RigFrame, water_index: float) -> None:
        self._cameras, self._frame, self._index = (rig.left, rig.right), frame, water_index
        volume = rig.volume
        farthest_mm = dot_range_mm(volume)[1]
        self._depths_mm = np.arange(volume.scaled(_BEGIN_MM), farthest_mm, volume.scaled(_STEP_MM))
        self._in_volume = (self._depths_mm >= volume.scaled(_NEAR_MM)) & (self._depths_mm <= volume.scaled(_FAR_MM))

    def sees_no_match(
        self,
        side: int,
        start_mm: Array,
        ahead: Array,
        images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        contrast_dn: float,
    ) -> bool:
        """Return True if the other camera sees the complete ray and no similar spot on it.

        ``side``: the camera that sees the dot, left (0) or right (1). The ray begins at ``start_mm`` and has the
        direction ``ahead`` (3,), both in the rig frame; it must be in the image throughout the volume. A spot of
        ``LIKE`` times ``contrast_dn`` is similar.
        """
        camera, image = self._cameras[1 - side], images[1 - side]
        z_mm = self._depths_mm
        points_mm = start_mm + ((z_mm - start_mm[2]) / ahead[2])[:, None] * ahead
        step = max(1, camera.width_px // COARSE_PX)
        track_px = (camera.project(self._frame.to_left(points_mm), self._index) + 0.5) / step - 0.5
        h, w = camera.height_px // step, camera.width_px // step
        inside = np.asarray(np.isfinite(track_px).all(axis=1))
        inside &= ((track_px >= EDGE_PX) & (track_px <= (w - 1 - EDGE_PX, h - 1 - EDGE_PX))).all(axis=1)
        if not inside[self._in_volume].all():
            return False
        track_px = track_px[inside]
        x0, y0 = (int(v) for v in np.floor(track_px.min(axis=0)) - EDGE_PX)
        x1, y1 = (int(v) for v in np.ceil(track_px.max(axis=0)) + EDGE_PX + 1)
        part = image[y0 * step : y1 * step, x0 * step : x1 * step]
        coarse = cv2.resize(part, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA) if step > 1 else part
        along = np.zeros(coarse.shape, np.uint8)
        line = np.rint(track_px - (x0, y0)).astype(np.int32)
        cv2.polylines(along, [line], False, (1,), 2 * HALF_PX + 1)
        return not bool((contrast_of(coarse)[along > 0] > LIKE * contrast_dn).any())


Images = tuple[NDArray[np.uint8], NDArray[np.uint8]]
"""Left and right (h, w) uint8, exposed at the same time."""

CENTRE_SD_PX = 0.12
"""Standard deviation of a dot's centre, in px of an image 400 px wide: grain, noise and texture."""
MOST_SIGMAS = 3.5
LIKE_IN_BOTH = 0.2
"""Least ratio of a dot's contrasts in both cameras: a surface is not a mirror."""
SURFACE_SD_MM = 0.3
"""Standard deviation of a dot's depth, from speckle and texture."""
CUT_SLOPE = 1.7
"""Depth error for each mm by which an edge or a change of albedo moves a dot's centre off the beam.

For a surface as steep as 60°.
"""
GAP_MM = 0.6
"""Largest ray gap of a dot with a measured calibration: texture moves its centre differently in each image."""
DRAWN_GAP_MM, DRAWN_SD_MM, DRAWN_SHARE = 8.0, 4.0, 0.015
"""Allowances for a nominal calibration: ray gap, position across the axis, and relative error of distances.

The last is 15 mm of 600, the worst of eight instruments.
"""
LIKE_THE_OTHER, MOST_SLOPE_DEG = 0.4, 45.0
"""Limits of a dot that only one camera sees, against the other pointer's: ratio of contrasts, and slope."""
ALONE_DN = 50.0
"""Least contrast of a dot that only one camera sees, if there is no other dot."""
STEADY_PAIRS, STEADY_MM = 4, 8.0
"""Number of consecutive stereo pairs that must show a dot, and its largest step between them.

Specks drift by; hands and objects do not jump.
"""
LONE_DN, FAINT_DN, FAINT_MM = 7.0, 15.0, 2.5
"""Least contrast of a dot without the other; below ``FAINT_DN`` its depth must be as certain as ``FAINT_MM``.

Two faint dots on one surface confirm each other.
"""
DRAWN_LEAST_DN = 20.0
"""Least contrast of a dot with a nominal calibration, by which rays meet nearly everywhere."""
MOST_SIGMA_MM = 5.0
"""Largest standard uncertainty of a distance that is reported."""
AMBIGUOUS = 0.5
"""Share of the best contrast from which a second position on the beam makes both ambiguous."""
SAME_MM = 4.0
"""Distance below which two positions are the same dot."""
MOST_STEP_DEG = 60.0
"""Steepest surface through two dots; steeper ones are two surfaces."""
REBUILD_MM = 0.3
CLEARLY = 0.6
"""Ratio of distances from the beam at which one stereo match is clearly nearer than another."""
SAME_RAY = 2e-3
"""Sine of the angle below which rays are the same: a px of an image 400 px wide."""
OTHERS_MM = 3.0
"""Distance from the other pointer's dot within which a spot of one camera is that dot."""


@dataclass(frozen=True, slots=True)
class Dot:
    """One pointer's dot on the object."""

    position_mm: tuple[float, float, float]
    """Position in the rig frame."""
    sigma_mm: float
    """Standard deviation of the dot's depth."""
    contrast_dn: float
    cameras: int
    """Number of cameras that see it."""


@dataclass(frozen=True, slots=True)
class Dots:
    """Dots of both pointers, as far as they were found."""

    left: Dot | None
    right: Dot | None

    @property
    def present(self) -> tuple[Dot, ...]:
        return tuple(dot for dot in (self.left, self.right) if dot is not None)


@dataclass(frozen=True, slots=True, eq=False)
class _CandidateRay:
    """A candidate's ray in the rig frame."""

    side: int
    """Camera that sees it: left (0) or right (1)."""
    start_mm: Array
    ahead: Array
    contrast_dn: float


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Candidates for one pointer's dot: from both cameras, and from one camera alone."""

    stereo: list[Dot]
    single: list[tuple[Dot, _CandidateRay]]


@dataclass(frozen=True, slots=True)
class _LoneSighting:
    """A bright spot that one camera sees on a beam, with the number of consecutive stereo pairs."""

    side: int
    z_mm: float
    pairs: int


class Ranger:
    """Measures the distance with one calibration in one water.

    Not for two threads at once; images may have any content.
    """

    def __init__(
        self, rig: StereoRig, water_index: float, beams: tuple[PointerBeam, PointerBeam], measured: bool = True
    ) -> None:
        """Prepare the search; ``measured``: the calibration was measured and is not the nominal one."""
        self._rig, self._index = rig, water_index
        self.frame = RigFrame.of(rig)
        self._measured = measured
        self._gap_mm = GAP_MM if measured else DRAWN_GAP_MM
        self._step = max(1.0, rig.left.width_px / 400.0)
        self._range_mm = dot_range_mm(rig.volume)
        self._beams = list(beams)
        self._lanes = [self._lanes_of(beam) for beam in beams]
        self._other_camera = OtherCamera(rig, self.frame, water_index)
        self._seen_by = list(beams)
        """The beams that the lanes were made for."""
        self._steady: list[_LoneSighting | None] = [None, None]
        """Sightings of each pointer by one camera alone in the latest pair."""

    @property
    def beams(self) -> tuple[PointerBeam, PointerBeam]:
        """The beams after all updates."""
        return self._beams[0], self._beams[1]

    def marks(self) -> Marks:
        """Return where the dots will appear in the live images."""
        return marks_of(self._rig, self.frame, self._index, self.beams)

    def measure(self, images: Images) -> Range | None:
        """Return the distance from the certain dots; dots that both cameras see update the beams."""
        dots = self.find(images)
        self.learn(dots)
        return self.range_of(dots)

    def find(self, images: Images, is_on: tuple[bool, bool] = (True, True)) -> Dots:
        """Return both dots, as far as they are certain, of the pointers that are on (``is_on``)."""
        candidates = [self._find(number, images) if is_on[number] else _Candidates([], []) for number in (0, 1)]
        stereo_dots = [_unambiguous(own_candidates.stereo) for own_candidates in candidates]
        dots: list[Dot | None] = []
        for number, own_candidates in enumerate(candidates):
            other_dot = stereo_dots[1 - number]
            # In order of certainty: both cameras; one camera beside the other pointer's dot; one camera alone.
            lone_dot = (
                self._lone_dot(number, candidates, images) if other_dot is None and not own_candidates.stereo else None
            )
            dots.append(
                stereo_dots[number]
                if own_candidates.stereo
                else lone_dot
                if other_dot is None
                else self._confirmed_dot(own_candidates.single, other_dot)
            )
        return Dots(dots[0], dots[1])

    def pixel_of(self, side: int, dot: Dot) -> tuple[float, float]:
        """Return where the left (0) or right (1) camera sees a dot, px."""
        camera = (self._rig.left, self._rig.right)[side]
        u, v = camera.project(self.frame.to_left(np.array([dot.position_mm])), self._index)[0]
        return float(u), float(v)

    def learn(self, dots: Dots) -> None:
        """Update the beams by the dots that both cameras see, if the calibration was measured.

        Only then do rays meet at the true position.
        """
        for number, dot in enumerate((dots.left, dots.right)):
            if dot is None or dot.cameras < 2 or not self._measured:
                continue
            beam = self._beams[number] = self._beams[number].updated(np.array(dot.position_mm))
            before, z = self._seen_by[number], np.array(self._range_mm)
            # A lane costs far more than a dot: it is rebuilt only when the beam has noticeably moved or narrowed.
            moved = np.abs(beam.at(z) - before.at(z)).max() > REBUILD_MM
            if moved or (beam.sd_mm(z) < before.sd_mm(z) - REBUILD_MM).any():
                self._seen_by[number], self._lanes[number] = beam, self._lanes_of(beam)

    def range_of(self, dots: Dots) -> Range | None:
        """Return distance and tilt from dots."""
        if not dots.present:
            return None
        measured = _range_from_dots(dots)
        if measured is None or measured.sigma_mm > MOST_SIGMA_MM:
            return None
        # A nominal calibration adds an error in proportion to the distance.
        drawn_mm = 0.0 if self._measured else DRAWN_SHARE * measured.distance_mm
        return replace(measured, sigma_mm=math.hypot(measured.sigma_mm, drawn_mm))

    # ------------------------------------------------------------------------------------------ one beam

    def _lanes_of(self, beam: PointerBeam) -> tuple[Lane, Lane]:
        rig, frame, index = self._rig, self.frame, self._index
        return (
            Lane(rig.left, frame, index, beam, rig.volume),
            Lane(rig.right, frame, index, beam, rig.volume),
        )

    def _find(self, number: int, images: Images) -> _Candidates:
        """Return the candidates for one pointer's dot."""
        beam = self._beams[number]
        rays_by_side = [
            self._rays_of(side, lane.candidates(image))
            for side, (lane, image) in enumerate(zip(self._lanes[number], images, strict=True))
        ]
        pairs = [
            (dot, a, b)
            for a in rays_by_side[0]
            for b in rays_by_side[1]
            if (dot := self._stereo_dot(beam, a, b)) is not None
        ]
        stereo_dots = [dot for dot, _, _ in pairs] if self._measured else _best_fitting(beam, pairs)
        single_dots = [
            (dot, ray) for rays in rays_by_side for ray in rays if (dot := self._single_dot(beam, ray)) is not None
        ]
        return _Candidates(stereo_dots, single_dots)

    def _confirmed_dot(self, singles: list[tuple[Dot, _CandidateRay]], other_dot: Dot) -> Dot | None:
        """Return a dot of one camera that the other pointer's dot on the same surface confirms."""
        # The other pointer's dot may lie on this beam's curve, too, as if it were at another depth.
        other_mm = np.array(other_dot.position_mm)
        best = _unambiguous([dot for dot, ray in singles if _off_mm(other_mm, ray) > OTHERS_MM])
        return best if best is not None and _confirms(best, other_dot) else None

    def _lone_dot(self, number: int, candidates: list[_Candidates], images: Images) -> Dot | None:
        """Return a dot that one camera sees, without any other dot.

        It may be any bright spot beside the dark of the live light. So it must be bright itself, on no other beam,
        without a similar spot on its ray in the other camera, and stay for a while.
        """
        before, self._steady[number] = self._steady[number], None
        best = _unambiguous([dot for dot, _ in candidates[number].single])
        if best is None or best.contrast_dn < ALONE_DN or not self._measured:
            return None
        ray = next(other_ray for dot, other_ray in candidates[number].single if dot is best)
        if any(_same_ray(ray, other_ray) for _, other_ray in candidates[1 - number].single):
            return None
        if not self._other_camera.sees_no_match(ray.side, ray.start_mm, ray.ahead, images, best.contrast_dn):
            return None
        is_steady = (
            before is not None and before.side == ray.side and abs(before.z_mm - best.position_mm[2]) < STEADY_MM
        )
        sighting = _LoneSighting(
            ray.side, best.position_mm[2], before.pairs + 1 if before is not None and is_steady else 1
        )
        self._steady[number] = sighting
        return best if sighting.pairs >= STEADY_PAIRS else None

    def _rays_of(self, side: int, candidates: list[Candidate]) -> list[_CandidateRay]:
        """Return the rays, in the rig frame, of one camera's candidates."""
        if not candidates:
            return []
        camera = (self._rig.left, self._rig.right)[side]
        pixels = np.array([[candidate.u_px, candidate.v_px] for candidate in candidates])
        origins, directions = camera.rays(pixels, self._index)
        start, ahead = self.frame.from_left(origins), self.frame.turn_from_left(directions)
        return [
            _CandidateRay(side, start[k], ahead[k], candidate.contrast_dn) for k, candidate in enumerate(candidates)
        ]

    def _stereo_dot(self, beam: PointerBeam, a: _CandidateRay, b: _CandidateRay) -> Dot | None:
        """Return the point where the rays of both cameras meet, if they do, and on the beam."""
        place, gap_mm, sine = _nearest(a.start_mm, a.ahead, b.start_mm, b.ahead)
        z = float(place[2])
        if not self._measured and min(a.contrast_dn, b.contrast_dn) < DRAWN_LEAST_DN:
            return None
        if gap_mm > self._gap_mm or not self._range_mm[0] <= z <= self._range_mm[1]:
            return None
        off_mm, sd_mm = float(np.linalg.norm((beam.at(np.array(z)) - place)[:2])), float(beam.sd_mm(np.array(z)))
        own_mm = DOT_SD_MM if self._measured else DRAWN_SD_MM
        if off_mm > MOST_SIGMAS * math.hypot(sd_mm, own_mm):
            return None
        # A dot has a similar contrast in both cameras; a highlight does not.
        if min(a.contrast_dn, b.contrast_dn) < LIKE_IN_BOTH * max(a.contrast_dn, b.contrast_dn):
            return None
        # Depth of two rays at angle α: σ_z = √2 σ_lateral / sin α; in addition the surface's own noise, and the error
        # of a dot that is cut by an edge.
        lateral_mm = self._centre_sd_mm(place - a.start_mm)
        aside_mm = off_mm if sd_mm < DOT_SD_MM else DOT_SD_MM  # a beam without updates is too uncertain
        sigma_mm = math.hypot(math.sqrt(2.0) * lateral_mm / sine, SURFACE_SD_MM, CUT_SLOPE * aside_mm)
        return Dot((float(place[0]), float(place[1]), z), sigma_mm, min(a.contrast_dn, b.contrast_dn), 2)

    def _single_dot(self, beam: PointerBeam, ray: _CandidateRay) -> Dot | None:
        """Return the point where the ray of one camera meets the beam."""
        ends = beam.at(np.array(self._range_mm))
        # The beam takes the place of the other camera's ray: the same intersection, with the beam's uncertainty.
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        place, gap_mm, sine = _nearest(ends[0], along, ray.start_mm, ray.ahead)
        z = float(place[2])
        if not self._range_mm[0] <= z <= self._range_mm[1]:
            return None
        sd_mm = float(beam.sd_mm(np.array(z)))
        if gap_mm > MOST_SIGMAS * math.hypot(sd_mm, DOT_SD_MM):
            return None
        sigma_mm = math.hypot(sd_mm, DOT_SD_MM, self._centre_sd_mm(place - ray.start_mm)) / sine
        if sigma_mm > MOST_SIGMA_MM:
            return None
        return Dot((float(place[0]), float(place[1]), z), sigma_mm, ray.contrast_dn, 1)

    def _centre_sd_mm(self, path_mm: Array) -> float:
        """Return the standard deviation of a dot's centre at the distance ``path_mm`` from the camera."""
        # Under water the focal length in px grows by the refractive index.
        f_px = self._rig.left.lens.f_px[0] * self._index
        return CENTRE_SD_PX * self._step * float(np.linalg.norm(path_mm)) / f_px


def _confirms(dot: Dot, other_dot: Dot) -> bool:
    """Return True if a dot is about as bright as the other pointer's, and on the same surface."""
    across_mm = abs(dot.position_mm[0] - other_dot.position_mm[0])
    is_near = abs(dot.position_mm[2] - other_dot.position_mm[2]) < math.tan(math.radians(MOST_SLOPE_DEG)) * across_mm
    return is_near and dot.contrast_dn > max(FAINT_DN, LIKE_THE_OTHER * other_dot.contrast_dn)


def _range_from_dots(dots: Dots) -> Range | None:
    """Return distance and tilt from dots, at least one."""
    if dots.left is None or dots.right is None:
        dot = dots.present[0]
        if dot.contrast_dn < LONE_DN or (dot.contrast_dn < FAINT_DN and dot.sigma_mm > FAINT_MM):
            return None
        return Range(dot.position_mm[2], None, dot.sigma_mm, 1)
    a, b = dots.left, dots.right
    across_mm, behind_mm = b.position_mm[0] - a.position_mm[0], b.position_mm[2] - a.position_mm[2]
    if across_mm <= 0.0 or abs(behind_mm) > math.tan(math.radians(MOST_STEP_DEG)) * across_mm:
        nearer, _ = sorted((a, b), key=lambda dot: dot.position_mm[2])
        clear, faint = sorted((a, b), key=lambda dot: -dot.contrast_dn)
        if faint.contrast_dn < LIKE_THE_OTHER * clear.contrast_dn:
            # One of them may be no dot; the distance is unknown unless one is certain.
            is_certain = clear.cameras == 2 and clear.contrast_dn >= ALONE_DN and faint.contrast_dn < FAINT_DN
            return Range(clear.position_mm[2], None, clear.sigma_mm, 1) if is_certain else None
        return Range(nearer.position_mm[2], None, nearer.sigma_mm, 2)
    # The surface between both dots is assumed plane: distance and error at the axis, x = 0, by linear interpolation.
    share = -a.position_mm[0] / across_mm
    z = a.position_mm[2] + share * behind_mm
    sigma_mm = math.hypot((1.0 - share) * a.sigma_mm, share * b.sigma_mm)
    tilt_deg = math.degrees(math.atan2(behind_mm, across_mm))
    return Range(z, tilt_deg, sigma_mm, 2)


def _best_fitting(beam: PointerBeam, pairs: list[tuple[Dot, _CandidateRay, _CandidateRay]]) -> list[Dot]:
    """Return, of stereo matches that share a spot, those that lie clearly nearer to the beam.

    With a nominal calibration the left dot in one image and the right one in the other meet as well, some way beside
    both beams.
    """

    def off_mm(dot: Dot) -> float:
        return float(np.linalg.norm(beam.at(np.array(dot.position_mm[2])) - np.array(dot.position_mm)))

    return [
        dot
        for dot, a, b in pairs
        if not any((a is c or b is d) and off_mm(rival) < CLEARLY * off_mm(dot) for rival, c, d in pairs)
    ]


def _same_ray(a: _CandidateRay, b: _CandidateRay) -> bool:
    """Return True if both are the same spot of the same image."""
    return a.side == b.side and float(np.linalg.norm(np.cross(a.ahead, b.ahead))) < SAME_RAY


def _off_mm(position_mm: Array, ray: _CandidateRay) -> float:
    """Return the distance of a position from a ray."""
    return float(np.linalg.norm(np.cross(position_mm - ray.start_mm, ray.ahead)))


def _unambiguous(dots: list[Dot]) -> Dot | None:
    """Return the dot with the highest contrast, unless another one elsewhere is nearly as high."""
    if not dots:
        return None
    # By contrast, not by the ray gap: the rays of two edges of a texture can meet on the beam, too.
    dots = sorted(dots, key=lambda dot: -dot.contrast_dn)
    best = dots[0]
    for rival in dots[1:]:
        if (
            abs(rival.position_mm[2] - best.position_mm[2]) > SAME_MM
            and rival.contrast_dn > AMBIGUOUS * best.contrast_dn
        ):
            return None
    return best


def _nearest(p: Array, d: Array, q: Array, e: Array) -> tuple[Array, float, float]:
    """Return the point half way between two lines, their gap, and the sine of the angle between them."""
    cosine = float(d @ e)
    # Parallel lines have no nearest points; the floor keeps the quotients finite.
    sine2 = max(1.0 - cosine * cosine, 1e-12)
    between = q - p
    s = (float(d @ between) - cosine * float(e @ between)) / sine2
    t = (cosine * float(d @ between) - float(e @ between)) / sine2
    a, b = p + s * d, q + t * e
    return 0.5 * (a + b), float(np.linalg.norm(a - b)), math.sqrt(sine2)


SURELY_A_DOT_DN = 15.0
"""Contrast from which a dot counts as evidence."""
EXPLAINED = 3.0
"""A dot is print if its contrast is at most this multiple of what ambient light makes of print."""
AROUND_PX = 10
"""Half width of the surroundings, px of an image 400 px wide."""


def shines_in_the_dark(ranger: Ranger, bright: Images, dark: Images) -> tuple[str, ...]:
    """Return ``left`` and ``right`` for the pointers whose dots are in both cameras' dark frames.

    ``bright``, ``dark``: frames (h, w) uint8 of the same view.
    """
    dots = ranger.find(dark)
    return tuple(
        side
        for side, dot in (("left", dots.left), ("right", dots.right))
        if dot is not None
        and dot.cameras == 2
        and dot.contrast_dn >= SURELY_A_DOT_DN
        and not _print_explains(ranger, dot, bright, dark)
    )


def _print_explains(ranger: Ranger, dot: Dot, bright: Images, dark: Images) -> bool:
    """Return True if the dot is print in ambient light, by a camera without saturation."""
    for number, (bright_frame, dark_frame) in enumerate(zip(bright, dark, strict=True)):
        u, v = ranger.pixel_of(number, dot)
        step = max(1, bright_frame.shape[1] // 400)
        row, column, half = round(v), round(u), AROUND_PX * step
        part = np.s_[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]
        a, b = bright_frame[part].astype(np.float64), dark_frame[part].astype(np.float64)
        if a.size == 0 or np.mean(a >= 255.0) > 0.1:
            continue
        height_lit, height_dark = _height(a, step), _height(b, step)
        ratio = max(float(np.median(b)), 1.0) / max(float(np.median(a - b)), 1.0)
        if height_dark <= EXPLAINED * max(height_lit - height_dark, 0.0) * ratio:
            return True
    return False


def _height(part: NDArray[np.float64], step: int) -> float:
    """Return by how much the centre is brighter than the surroundings."""
    y, x = part.shape[0] // 2, part.shape[1] // 2
    return float(part[y - step : y + step + 1, x - step : x + step + 1].mean() - np.median(part))
