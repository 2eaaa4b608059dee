"""Owns the distance to the object, measured from the two laser dots in one stereo pair of live images.

    Ranger                finds the laser dots, and gives the distance and, with both dots, the tilt
    OtherCamera           for a dot that one camera sees: whether the other has anything as bright along that ray
    shines_in_the_dark    names the pointers whose dot is in the dark frame of a sequence, though lasers must be off

Both cameras see a dot: it counts if their refracted rays meet, and meet on the pointer's beam. One camera sees it: the
ray is intersected with the beam. Such a dot counts beside the other pointer's dot on the same surface. Alone, it must
be bright, stay where it is, and the other camera must see nothing like it along the ray: a lit corner, a print or a
speck near the cameras would be seen there, too. Ambiguous dots do not count.

In a dark frame, print may look like a dot. The projector's light makes print brighter in the bright frame; a laser dot
stays as it is. Positions are in the rig frame.
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
"""Depth, of the standard housing, in the rig frame from which the ray is searched; what is nearer is out of focus and
before one camera alone."""
_NEAR_MM, _FAR_MM = 330.0, 620.0
"""Depths, of the standard housing, between which the other camera must see the ray; nearer and farther, as far as its
picture goes."""
_STEP_MM = 4.0
HALF_PX = 3
"""Half width of the band that is looked at along the ray's image, coarse px: a calibration's error, and the size of
what is looked for."""
LIKE = 0.25
"""Share of the contrast from which a spot is like the dot."""


class OtherCamera:
    """Asks one camera of a rig about what the other one sees."""

    def __init__(self, rig: StereoRig, frame: RigFrame, water_index: float) -> None:
        self._cameras, self._frame, self._index = (rig.left, rig.right), frame, water_index
        volume = rig.volume
        farthest_mm = dot_range_mm(volume)[1]
        self._depths_mm = np.arange(volume.scaled(_BEGIN_MM), farthest_mm, volume.scaled(_STEP_MM))
        self._in_volume = (self._depths_mm >= volume.scaled(_NEAR_MM)) & (self._depths_mm <= volume.scaled(_FAR_MM))

    def sees_nothing_like(
        self,
        side: int,
        start_mm: Array,
        ahead: Array,
        images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        contrast_dn: float,
    ) -> bool:
        """Tell whether the camera that is not ``side`` (0 left, 1 right) looks all along the ray from ``start_mm`` in
        the direction ``ahead`` (3,), rig frame, as far as the volume goes, and sees nothing of ``LIKE`` times the
        contrast."""
        camera, image = self._cameras[1 - side], images[1 - side]
        z_mm = self._depths_mm
        way = start_mm + ((z_mm - start_mm[2]) / ahead[2])[:, None] * ahead
        step = max(1, camera.width_px // COARSE_PX)
        seen = (camera.project(self._frame.to_left(way), self._index) + 0.5) / step - 0.5
        h, w = camera.height_px // step, camera.width_px // step
        inside = np.asarray(np.isfinite(seen).all(axis=1))
        inside &= ((seen >= EDGE_PX) & (seen <= (w - 1 - EDGE_PX, h - 1 - EDGE_PX))).all(axis=1)
        if not inside[self._in_volume].all():
            return False
        seen = seen[inside]
        x0, y0 = (int(v) for v in np.floor(seen.min(axis=0)) - EDGE_PX)
        x1, y1 = (int(v) for v in np.ceil(seen.max(axis=0)) + EDGE_PX + 1)
        part = image[y0 * step : y1 * step, x0 * step : x1 * step]
        coarse = cv2.resize(part, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA) if step > 1 else part
        along = np.zeros(coarse.shape, np.uint8)
        line = np.rint(seen - (x0, y0)).astype(np.int32)
        cv2.polylines(along, [line], False, (1,), 2 * HALF_PX + 1)
        return not bool((contrast_of(coarse)[along > 0] > LIKE * contrast_dn).any())


Images = tuple[NDArray[np.uint8], NDArray[np.uint8]]
"""Left and right (h, w) uint8, exposed at the same time."""

CENTRE_SD_PX = 0.12
"""Standard deviation of a dot's centre, in px of an image 400 px wide: grain, noise and texture."""
MOST_SIGMAS = 3.5
LIKE_IN_BOTH = 0.2
"""A dot has at least so much of its contrast in one camera in the other: a surface is not a mirror."""
SURFACE_SD_MM = 0.3
"""Standard deviation of a dot's depth, from speckle and texture."""
CUT_SLOPE = 1.7
"""An edge that cuts a dot, or a change of albedo in it, moves its middle off the beam; on a surface as steep as 60° its
depth is off by so much for each mm."""
GAP_MM = 0.6
"""Rays of one dot pass each other so near with a measured calibration: texture moves its centre differently."""
DRAWN_GAP_MM, DRAWN_SD_MM, DRAWN_SHARE = 8.0, 4.0, 0.015
"""Allowances for a calibration that was never measured: how far rays may pass, what places across the axis are
uncertain by, and what share of themselves distances are (15 mm of 600 was the worst of eight instruments)."""
LIKE_THE_OTHER, MOST_SLOPE_DEG = 0.4, 45.0
"""A dot that only one camera sees has so much of the contrast of the other pointer's, and is so near it in depth."""
ALONE_DN = 50.0
"""Contrast of a dot that only one camera sees, where there is no other dot."""
STEADY_PAIRS, STEADY_MM = 4, 8.0
"""Number of pairs in a row that must show a dot, each as near to the one before: specks drift by, and hands and objects
do not jump."""
LONE_DN, FAINT_DN, FAINT_MM = 7.0, 15.0, 2.5
"""Contrast of a dot that is believed without the other; below ``FAINT_DN`` only if its depth is as certain as
``FAINT_MM``. Two faint ones on one surface bear each other out."""
DRAWN_LEAST_DN = 20.0
"""Contrast of a dot with a calibration that was never measured: rays meet nearly everywhere then."""
MOST_SIGMA_MM = 5.0
"""A distance that is less certain is not told."""
AMBIGUOUS = 0.5
"""Another place on the beam with so much of the best one's contrast makes both doubtful …"""
SAME_MM = 4.0
"""Distance below which two places are the same dot."""
MOST_STEP_DEG = 60.0
"""Two dots that would make a surface more oblique than this lie on two surfaces."""
REBUILD_MM = 0.3
CLEARLY = 0.6
"""A pair lies clearly nearer to the beam with so much of another's distance from it."""
SAME_RAY = 2e-3
"""Sine of an angle: a px of an image 400 px wide."""
OTHERS_MM = 3.0
"""Distance from the other pointer's dot within which what one camera sees is that dot."""


@dataclass(frozen=True, slots=True)
class Dot:
    """One pointer's dot on the object."""

    place_mm: tuple[float, float, float]
    """Rig frame."""
    sigma_mm: float
    """Standard deviation of the dot's depth."""
    contrast_dn: float
    cameras: int
    """Number of cameras that saw it."""


@dataclass(frozen=True, slots=True)
class Dots:
    """Dots found of both pointers."""

    left: Dot | None
    right: Dot | None

    @property
    def found(self) -> tuple[Dot, ...]:
        return tuple(dot for dot in (self.left, self.right) if dot is not None)


@dataclass(frozen=True, slots=True, eq=False)
class _Sighted:
    """A candidate's ray in the rig frame."""

    side: int
    """Camera that saw it: left (0) or right (1)."""
    start_mm: Array
    ahead: Array
    contrast_dn: float


@dataclass(frozen=True, slots=True)
class _Found:
    """Candidates for one pointer's dot: what both cameras agree on, and what one of them sees."""

    met: list[Dot]
    alone: list[tuple[Dot, _Sighted]]


@dataclass(frozen=True, slots=True)
class _Steady:
    """A bright spot that one camera saw on a beam, and in how many pairs in a row."""

    side: int
    z_mm: float
    pairs: int


class Ranger:
    """Measures with one calibration in one water. Not for two threads at once; images may have any content."""

    def __init__(
        self, rig: StereoRig, water_index: float, beams: tuple[PointerBeam, PointerBeam], measured: bool = True
    ) -> None:
        """Prepare the search; ``measured`` tells that the calibration is one, not the drawing."""
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
        self._steady: list[_Steady | None] = [None, None]
        """Sightings of each pointer by one camera alone in the latest pair."""

    @property
    def beams(self) -> tuple[PointerBeam, PointerBeam]:
        """The beams as known now."""
        return self._beams[0], self._beams[1]

    def marks(self) -> Marks:
        """Return the places where the dots are going to be seen in the live pictures."""
        return marks_of(self._rig, self.frame, self._index, self.beams)

    def measure(self, images: Images) -> Range | None:
        """Return the distance, from whichever dots are sure; what both cameras saw teaches the beams."""
        dots = self.find(images)
        self.learn(dots)
        return self.range_of(dots)

    def find(self, images: Images, lit: tuple[bool, bool] = (True, True)) -> Dots:
        """Return both dots, as far as they are there beyond doubt; only of the pointers that are ``lit``."""
        seen = [self._find(number, images) if lit[number] else _Found([], []) for number in (0, 1)]
        met = [_unambiguous(found.met) for found in seen]
        dots: list[Dot | None] = []
        for number, found in enumerate(seen):
            other = met[1 - number]
            # From the surest to the least sure: both cameras; one camera beside the other pointer's dot; one camera
            # alone.
            alone = self._lone(number, seen, images) if other is None and not found.met else None
            dots.append(met[number] if found.met else alone if other is None else self._beside(found.alone, other))
        return Dots(dots[0], dots[1])

    def pixel_of(self, side: int, dot: Dot) -> tuple[float, float]:
        """Compute where the left (0) or right (1) camera sees a dot, px."""
        camera = (self._rig.left, self._rig.right)[side]
        u, v = camera.project(self.frame.to_left(np.array([dot.place_mm])), self._index)[0]
        return float(u), float(v)

    def learn(self, dots: Dots) -> None:
        """Let what both cameras saw teach the beams; only rays of a measured calibration meet where the light is."""
        for number, dot in enumerate((dots.left, dots.right)):
            if dot is None or dot.cameras < 2 or not self._measured:
                continue
            beam = self._beams[number] = self._beams[number].taught(np.array(dot.place_mm))
            before, z = self._seen_by[number], np.array(self._range_mm)
            # A lane costs far more than a dot: it is made anew only when the beam has moved, or narrowed, by a
            # noticeable amount.
            moved = np.abs(beam.at(z) - before.at(z)).max() > REBUILD_MM
            if moved or (beam.sd_mm(z) < before.sd_mm(z) - REBUILD_MM).any():
                self._seen_by[number], self._lanes[number] = beam, self._lanes_of(beam)

    def range_of(self, dots: Dots) -> Range | None:
        """Compute distance and tilt from dots."""
        if not dots.found:
            return None
        measured = _told(dots)
        if measured is None or measured.sigma_mm > MOST_SIGMA_MM:
            return None
        # An unmeasured calibration is wrong by a share of the distance, on top of the noise.
        drawn_mm = 0.0 if self._measured else DRAWN_SHARE * measured.distance_mm
        return replace(measured, sigma_mm=math.hypot(measured.sigma_mm, drawn_mm))

    # ------------------------------------------------------------------------------------------ one beam

    def _lanes_of(self, beam: PointerBeam) -> tuple[Lane, Lane]:
        rig, frame, index = self._rig, self.frame, self._index
        return (
            Lane(rig.left, frame, index, beam, rig.volume),
            Lane(rig.right, frame, index, beam, rig.volume),
        )

    def _find(self, number: int, images: Images) -> _Found:
        """Return candidates for one pointer's dot."""
        beam = self._beams[number]
        seen = [
            self._sighted(side, lane.candidates(image))
            for side, (lane, image) in enumerate(zip(self._lanes[number], images, strict=True))
        ]
        pairs = [(dot, a, b) for a in seen[0] for b in seen[1] if (dot := self._met(beam, a, b)) is not None]
        met = [dot for dot, _, _ in pairs] if self._measured else _best_fitting(beam, pairs)
        alone = [(dot, one) for found in seen for one in found if (dot := self._single(beam, one)) is not None]
        return _Found(met, alone)

    def _beside(self, found: list[tuple[Dot, _Sighted]], other: Dot) -> Dot | None:
        """Return a dot that one camera sees, borne out by the other pointer's dot on the same surface."""
        # The other's dot may be seen on this beam's curve, too, as if it were at another depth.
        place = np.array(other.place_mm)
        best = _unambiguous([dot for dot, seen in found if _off_mm(place, seen) > OTHERS_MM])
        return best if best is not None and _borne_out(best, other) else None

    def _lone(self, number: int, seen: list[_Found], images: Images) -> Dot | None:
        """Return a dot that one camera sees, without any other. It may be anything bright beside the dark of the live
        light: it must be bright itself, on no other beam, without anything like it on its ray for the other camera,
        and stay for a while."""
        before, self._steady[number] = self._steady[number], None
        best = _unambiguous([dot for dot, _ in seen[number].alone])
        if best is None or best.contrast_dn < ALONE_DN or not self._measured:
            return None
        ray = next(one for dot, one in seen[number].alone if dot is best)
        if any(_same_ray(ray, one) for _, one in seen[1 - number].alone):
            return None
        if not self._other_camera.sees_nothing_like(ray.side, ray.start_mm, ray.ahead, images, best.contrast_dn):
            return None
        stays = before is not None and before.side == ray.side and abs(before.z_mm - best.place_mm[2]) < STEADY_MM
        now = _Steady(ray.side, best.place_mm[2], before.pairs + 1 if before is not None and stays else 1)
        self._steady[number] = now
        return best if now.pairs >= STEADY_PAIRS else None

    def _sighted(self, side: int, found: list[Candidate]) -> list[_Sighted]:
        """Return the candidates of one camera with the rays, in the rig frame, that they lie on."""
        if not found:
            return []
        camera = (self._rig.left, self._rig.right)[side]
        at = np.array([[one.u_px, one.v_px] for one in found])
        origins, directions = camera.rays(at, self._index)
        start, ahead = self.frame.from_left(origins), self.frame.turn_from_left(directions)
        return [_Sighted(side, start[k], ahead[k], one.contrast_dn) for k, one in enumerate(found)]

    def _met(self, beam: PointerBeam, a: _Sighted, b: _Sighted) -> Dot | None:
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
        # A dot looks about alike in both cameras; a highlight does not.
        if min(a.contrast_dn, b.contrast_dn) < LIKE_IN_BOTH * max(a.contrast_dn, b.contrast_dn):
            return None
        # Depth of two rays at angle α: σ_z = √2 σ_lateral / sin α; on top the surface's own scatter, and the slope by
        # which a cut dot wanders.
        lateral_mm = self._centre_sd_mm(place - a.start_mm)
        aside_mm = off_mm if sd_mm < DOT_SD_MM else DOT_SD_MM  # a beam that was not learned does not tell
        sigma_mm = math.hypot(math.sqrt(2.0) * lateral_mm / sine, SURFACE_SD_MM, CUT_SLOPE * aside_mm)
        return Dot((float(place[0]), float(place[1]), z), sigma_mm, min(a.contrast_dn, b.contrast_dn), 2)

    def _single(self, beam: PointerBeam, one: _Sighted) -> Dot | None:
        """Return the point where the ray of one camera meets the beam."""
        ends = beam.at(np.array(self._range_mm))
        # One ray and the beam, which takes the place of the other camera: the same intersection with the beam's
        # uncertainty in it.
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        place, gap_mm, sine = _nearest(ends[0], along, one.start_mm, one.ahead)
        z = float(place[2])
        if not self._range_mm[0] <= z <= self._range_mm[1]:
            return None
        sd_mm = float(beam.sd_mm(np.array(z)))
        if gap_mm > MOST_SIGMAS * math.hypot(sd_mm, DOT_SD_MM):
            return None
        sigma_mm = math.hypot(sd_mm, DOT_SD_MM, self._centre_sd_mm(place - one.start_mm)) / sine
        if sigma_mm > MOST_SIGMA_MM:
            return None
        return Dot((float(place[0]), float(place[1]), z), sigma_mm, one.contrast_dn, 1)

    def _centre_sd_mm(self, way: Array) -> float:
        """Return the centre's standard deviation at the end of ``way``."""
        # Under water the principal distance in px grows by the index.
        f_px = self._rig.left.lens.f_px[0] * self._index
        return CENTRE_SD_PX * self._step * float(np.linalg.norm(way)) / f_px


def _borne_out(dot: Dot, other: Dot) -> bool:
    """Tell whether a dot that one camera sees is about as bright as the other pointer's, and on the same surface as
    it."""
    across_mm = abs(dot.place_mm[0] - other.place_mm[0])
    near = abs(dot.place_mm[2] - other.place_mm[2]) < math.tan(math.radians(MOST_SLOPE_DEG)) * across_mm
    return near and dot.contrast_dn > max(FAINT_DN, LIKE_THE_OTHER * other.contrast_dn)


def _told(dots: Dots) -> Range | None:
    """Compute distance and tilt from dots, at least one."""
    if dots.left is None or dots.right is None:
        dot = dots.found[0]
        if dot.contrast_dn < LONE_DN or (dot.contrast_dn < FAINT_DN and dot.sigma_mm > FAINT_MM):
            return None
        return Range(dot.place_mm[2], None, dot.sigma_mm, 1)
    a, b = dots.left, dots.right
    across_mm, behind_mm = b.place_mm[0] - a.place_mm[0], b.place_mm[2] - a.place_mm[2]
    if across_mm <= 0.0 or abs(behind_mm) > math.tan(math.radians(MOST_STEP_DEG)) * across_mm:
        near, _ = sorted((a, b), key=lambda dot: dot.place_mm[2])
        clear, faint = sorted((a, b), key=lambda dot: -dot.contrast_dn)
        if faint.contrast_dn < LIKE_THE_OTHER * clear.contrast_dn:
            # One of them may be no dot, and nobody knows which, unless one is beyond doubt.
            sure = clear.cameras == 2 and clear.contrast_dn >= ALONE_DN and faint.contrast_dn < FAINT_DN
            return Range(clear.place_mm[2], None, clear.sigma_mm, 1) if sure else None
        return Range(near.place_mm[2], None, near.sigma_mm, 2)
    # The surface between both dots is taken for a plane: distance and error at the axis, x = 0, by linear
    # interpolation.
    share = -a.place_mm[0] / across_mm
    z = a.place_mm[2] + share * behind_mm
    own_mm = math.hypot((1.0 - share) * a.sigma_mm, share * b.sigma_mm)
    tilt_deg = math.degrees(math.atan2(behind_mm, across_mm))
    return Range(z, tilt_deg, own_mm, 2)


def _best_fitting(beam: PointerBeam, pairs: list[tuple[Dot, _Sighted, _Sighted]]) -> list[Dot]:
    """Keep, of pairs that have a spot in common, those that lie clearly nearer to the beam. With a calibration that was
    never measured the left dot in one picture and the right one in the other meet as well, some way beside both
    beams."""

    def off_mm(dot: Dot) -> float:
        return float(np.linalg.norm(beam.at(np.array(dot.place_mm[2])) - np.array(dot.place_mm)))

    return [
        dot
        for dot, a, b in pairs
        if not any((a is c or b is d) and off_mm(other) < CLEARLY * off_mm(dot) for other, c, d in pairs)
    ]


def _same_ray(a: _Sighted, b: _Sighted) -> bool:
    """Tell whether both are one spot of one picture."""
    return a.side == b.side and float(np.linalg.norm(np.cross(a.ahead, b.ahead))) < SAME_RAY


def _off_mm(place_mm: Array, seen: _Sighted) -> float:
    """Return the distance of a place from a ray."""
    return float(np.linalg.norm(np.cross(place_mm - seen.start_mm, seen.ahead)))


def _unambiguous(dots: list[Dot]) -> Dot | None:
    """Return the clearest, unless another is nearly as clear elsewhere."""
    if not dots:
        return None
    # By contrast, not by how well the rays meet: two edges of a texture can meet on the beam as well as a dot does.
    dots = sorted(dots, key=lambda dot: -dot.contrast_dn)
    best = dots[0]
    for other in dots[1:]:
        if abs(other.place_mm[2] - best.place_mm[2]) > SAME_MM and other.contrast_dn > AMBIGUOUS * best.contrast_dn:
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
"""Contrast of a dot that counts as evidence."""
EXPLAINED = 3.0
"""A dot is print where projected light would make so much of its contrast at this ratio of the lights."""
AROUND_PX = 10
"""Half width of the surroundings, px of an image 400 px wide."""


def shines_in_the_dark(ranger: Ranger, bright: Images, dark: Images) -> tuple[str, ...]:
    """Return ``left`` and ``right`` pointer, as far as their dots are in both cameras' dark frames (h, w) uint8;
    ``bright`` are the same views in full light."""
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
    """Tell whether the dot is what ambient light makes of a print, in the camera where the projector's light is least
    saturated."""
    for number, (lit, unlit) in enumerate(zip(bright, dark, strict=True)):
        u, v = ranger.pixel_of(number, dot)
        step = max(1, lit.shape[1] // 400)
        row, column, half = round(v), round(u), AROUND_PX * step
        part = np.s_[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]
        a, b = lit[part].astype(np.float64), unlit[part].astype(np.float64)
        if a.size == 0 or np.mean(a >= 255.0) > 0.1:
            continue
        height_lit, height_dark = _height(a, step), _height(b, step)
        ratio = max(float(np.median(b)), 1.0) / max(float(np.median(a - b)), 1.0)
        if height_dark <= EXPLAINED * max(height_lit - height_dark, 0.0) * ratio:
            return True
    return False


def _height(part: NDArray[np.float64], step: int) -> float:
    """Return how much brighter the middle is than the surroundings."""
    y, x = part.shape[0] // 2, part.shape[1] // 2
    return float(part[y - step : y + step + 1, x - step : x + step + 1].mean() - np.median(part))
