"""Tests of an image set description that need both cameras, or camera and projector.

``examine`` runs two kinds of tests. ``assumptions.py`` tests the images of each camera alone. This module makes a
coarse cloud along epipolar curves as described, and one for each alternative: R transposed, left and right exchanged,
another fringe period, and so on. Three quantities can contradict a cloud:

    share        of the left pixels with coordinates, how many have a point. Low if the cameras look elsewhere.
    same side    how much of the surface both see from the same side. Low if the pattern runs the other way.
    offset       across the disparity, in px: where the other direction or the texture shows a point in the right
                 image, minus where the point is projected to. Large if the poses are wrong.

Each statement of the description is then
    FITS         if the description is not contradicted, but all alternatives are,
    WRONG        if an alternative is clearly better, or the description is contradicted,
    UNCHECKED    if an alternative is as good, or no quantity decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.assumptions import (
    ExaminedAssumption,
    Outcome,
    check_extent,
    contradiction,
    examine_axis,
    examine_references,
    fits_or_unchecked,
)
from appliance.desk.foreign.camera import DecodedCamera, place_again
from appliance.desk.foreign.cameras import ForeignRig
from appliance.desk.foreign.decode import Reason, place
from appliance.desk.foreign.description import AxisConvention, Description
from appliance.desk.foreign.phase import Floats
from appliance.desk.foreign.points import depths_of, pixel_coordinates
from appliance.desk.foreign.texture import Offset, Textures, texture_offset, textures_of
from appliance.measure import (
    CurveError,
    HousedCamera,
    NoPoint,
    OneDirectionLimits,
    StereoRig,
    match_along_curves,
    matrix3,
)

COARSE_PX, LEAST_NEIGHBOURS = 160, 3
"""Largest width of the reduced coordinate maps, and the least number of neighbours of a point there."""
POOR, NONE = 0.25, 0.02
"""Share of the left pixels with coordinates that have a point: below the first the description is doubtful, below the
second it is wrong."""
CLEARLY = 2.0
"""A hypothesis is better from so many times as many points, or from an offset so many times smaller."""
SAME_SIDE = 0.8
MOST_ASIDE_PX, MOST_ASIDE_PERIODS, SURE_PX = 2.0, 0.06, 1.0
"""Largest offset of a right description in px, and with a projector also in fringe periods, for the error of its phase;
and the least offset that contradicts."""
FOUND_SHARE, PATCHES = 0.15, 1200
OTHER_INDEX = 0.03
SCALES, SHIFTS = (0.5, 0.8, 1.25, 2.0), (-0.125, 0.125)
"""Alternative fringe periods over the described one, and alternative starts over the size of the projector."""
CENTRED, NEARLY_CENTRED = 0.12, 0.06
"""Largest distance of a principal point from the middle of its image, over its size: for a whole sensor, and for an
image size that was corrected by a factor."""
POSE, TURN, TURN_DEG = "cameras: rotation and translation", "cameras: a rotation about the columns", 0.3
WHICH_IS_LEFT = "cameras: which is left"
REMEDIES = (
    "check that the calibration is of this setting and of images of this size, cameras.unit, water and ports, and range"
)
NO_OFFSET = Offset(0, 0, 0.0, 0.0, 0.0)
Maps = Mapping[str, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class _Geometry:
    """Both cameras, or camera and projector, with their pattern coordinates, as one hypothesis has them."""

    left: HousedCamera
    right: HousedCamera
    index: float
    left_px: Maps
    right_px: Maps
    """The coordinates of its own pixels, if it is a projector."""
    textures: Textures | None
    """``None`` where the other direction is compared instead, or there is no second image."""
    projector: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """An alternative meaning of one statement of the description."""

    subject: str
    text: str
    changes: Mapping[str, Any]
    """Other values of fields of ``_Geometry``."""
    corrections: Mapping[str, Any] = field(default_factory=dict)
    """Other values of keys of the description."""


@dataclass(frozen=True, slots=True)
class _Evidence:
    """Points that were made with one geometry, with their numbers that can contradict it."""

    share: float = 0.0
    same_side: float = 1.0
    depth_mm: float = 0.0
    offset: Offset = NO_OFFSET
    remark: str = ""

    @property
    def holds(self) -> bool:
        """True if the points do not contradict the geometry."""
        return self.share >= POOR and self.same_side >= SAME_SIDE and (self.offset.fits or not self.offset.tells)

    def better(self, rival: _Evidence) -> bool:
        """Return whether this is clearly better than ``other``.

        Offsets decide where both have them, else the share of points.
        """
        if rival.offset.tells and self.holds:
            return self.offset.fits and rival.offset.size_px > max(SURE_PX, CLEARLY * self.offset.size_px)
        return self.holds and (not rival.holds or self.share > CLEARLY * rival.share)

    def __str__(self) -> str:
        parts = [f"{100 * self.share:.0f} % have a point{self.remark}"]
        if self.same_side < SAME_SIDE:
            parts.append(f"{100 - 100 * self.same_side:.0f} % of the surface would face away from the camera")
        return ", ".join([*parts, str(self.offset)] if self.offset.searched else parts)


def examine(
    description: Description, cameras: Mapping[str, DecodedCamera], rig: ForeignRig | None
) -> tuple[ExaminedAssumption, ...]:
    """Test a description on decoded images, and on ``rig`` where it is known.

    Images may be thinned by a whole number. A statement that one test leaves open does not fit because of another
    test.
    """
    tested = [
        assumption for side, camera in cameras.items() for assumption in examine_images(side, camera, description)
    ]
    return examine_rays(description, cameras, rig, tested)


def examine_images(side: str, camera: DecodedCamera, description: Description) -> list[ExaminedAssumption]:
    """Return the tests of the description on the images of one camera."""
    tested = examine_references(camera)
    for axis in description.axes:
        tested += examine_axis(camera, axis)
    return [replace(assumption, subject=f"{side}: {assumption.subject}") for assumption in tested]


def examine_rays(
    description: Description,
    cameras: Mapping[str, DecodedCamera],
    rig: ForeignRig | None,
    tested: list[ExaminedAssumption],
) -> tuple[ExaminedAssumption, ...]:
    """Return ``tested``, the tests of each camera alone, with the tests by rays added."""
    if any(assumption.outcome is Outcome.WRONG for assumption in tested):
        # Wrong coordinates tell nothing about the cameras.
        tested.append(ExaminedAssumption("cameras", Outcome.UNCHECKED, "the order of the images is wrong"))
    elif rig is not None:
        tested += examine_cameras(description, rig, cameras)
    open_ = {assumption.subject.split(": ")[-1] for assumption in tested if assumption.outcome is not Outcome.FITS}
    return tuple(
        assumption
        for assumption in tested
        if assumption.outcome is not Outcome.FITS or assumption.subject.split(": ")[-1] not in open_
    )


def examine_cameras(
    description: Description, rig: ForeignRig, cameras: Mapping[str, DecodedCamera]
) -> list[ExaminedAssumption]:
    """Test the description of ``cameras``: ``left`` and, unless the right one is a projector, ``right``."""
    left, right = cameras["left"], cameras.get("right")
    size = _check_image_size(rig.rig, right is None)
    if size.outcome is Outcome.WRONG:
        return [size]
    textures = textures_of(left.grey, right.grey) if right is not None and description.one_direction else None
    right_px = pixel_coordinates(rig.rig.right) if right is None else _maps(right)
    geometry = _Geometry(rig.rig.left, rig.rig.right, rig.index, _maps(left), right_px, textures, right is None)
    described = _collect_evidence(geometry, description)
    hypotheses = _pose_hypotheses(geometry, rig)
    hypotheses += (
        _exchange_hypotheses(geometry) if right is not None else _pattern_hypotheses(geometry, description, left)
    )
    tested = [
        (hypothesis, _collect_evidence(replace(geometry, **hypothesis.changes), description))
        for hypothesis in hypotheses
    ]
    results = _compare(described, tested)
    if right is None and not any(result.outcome is Outcome.WRONG for result in results):
        results += _check_projector_size(description, rig, left, results)
    if any(result.outcome is Outcome.WRONG for result in results):
        return results
    if rig.calibration is None and rig.scale_known:
        apart_mm = float(np.linalg.norm(rig.rig.right.translation_mm))
        text = (
            f"images do not show lengths: with this unit the baseline is {apart_mm:.4g} mm, and the object is "
            f"{described.depth_mm:.4g} mm away"
        )
        results.append(fits_or_unchecked("cameras.unit", False, text))
    return [*results, size]


def _compare(described: _Evidence, tested: list[tuple[_Hypothesis, _Evidence]]) -> list[ExaminedAssumption]:
    """Return the test results that follow from the hypotheses, for each statement that they concern."""
    better = [(hypothesis, evidence) for hypothesis, evidence in tested if evidence.better(described)]
    if better:
        hypothesis, evidence = min(
            better, key=lambda pair: (-pair[1].offset.tells, pair[1].offset.size_px, -pair[1].share)
        )
        # Without an offset several may fit: name all of them to the user, not the first alone.
        rivals = [
            candidate.text for candidate, rival in better if candidate is not hypothesis and not evidence.better(rival)
        ]
        return [
            contradiction(
                hypothesis.subject,
                f"{described}; {evidence} if {' or '.join([hypothesis.text, *rivals])}",
                **hypothesis.corrections,
            )
        ]
    if not described.holds:
        offset = described.offset
        sure = offset.spread_px <= offset.allowed_px or offset.matched > FOUND_SHARE * offset.searched
        contradicted = described.share <= NONE or described.same_side < SAME_SIDE or (described.share >= POOR and sure)
        text = f"{described}, and exchanging cameras, R or T is no better: {REMEDIES}"
        return [contradiction(POSE, text) if contradicted else fits_or_unchecked(POSE, False, text)]
    results = []
    for subject in dict.fromkeys(hypothesis.subject for hypothesis, _ in tested):
        tests = [(hypothesis, evidence) for hypothesis, evidence in tested if hypothesis.subject == subject]
        as_good = [
            (hypothesis, evidence)
            for hypothesis, evidence in tests
            if evidence.holds and not described.better(evidence)
        ]
        hypothesis, evidence = max(as_good or tests, key=lambda pair: pair[1].share)
        text = f"{evidence} if {hypothesis.text}"
        if as_good:
            text += f", {evidence.depth_mm:.0f} mm away in place of {described.depth_mm:.0f} mm"
        elif subject == POSE:
            text = f"{described}, and {text}" + ("" if described.offset.tells else ", but their values are not checked")
        # Where no test checks the values of the pose, a turn is not tested apart from it.
        if subject != TURN or described.offset.tells:
            results.append(
                fits_or_unchecked(subject, not as_good and (subject != POSE or described.offset.tells), text)
            )
    return results


# ------------------------------------------------------------------------------------------------- hypotheses


def _pose_hypotheses(geometry: _Geometry, rig: ForeignRig) -> list[_Hypothesis]:
    """Return the alternative meanings of R and T, of windows and of water."""
    left, right = geometry.left, geometry.right
    R = np.asarray(right.rotation).T
    T = -R @ np.asarray(right.translation_mm)
    # Rotation about the axis across the disparity, which two cameras hardly detect.
    tilt = np.asarray(cv2.Rodrigues(np.deg2rad(TURN_DEG) * np.eye(3)[1 if abs(T[0]) >= abs(T[1]) else 0])[0])
    hypotheses = []
    for subject, text, other_R, other_T in (
        (POSE, "they are R and T of right to left", R.T, -R.T @ T),
        (POSE, "R is transposed", R.T, T),
        (POSE, "T is negated", R, -T),
        (POSE, "R is transposed and T negated", R.T, -T),
        (TURN, f"it is {TURN_DEG:g}° more", tilt @ R, T),
        (TURN, f"it is {TURN_DEG:g}° less", tilt.T @ R, T),
    ):
        x, y, z = (float(value) for value in -other_R.T @ other_T)
        right_camera = replace(right, rotation=matrix3(other_R.T), translation_mm=(x, y, z))
        hypotheses.append(_Hypothesis(subject, text, {"right": right_camera}))
    if right.lens_in_water:
        return hypotheses
    for word in ("distance_mm", "thickness_mm") if rig.calibration is None else ():
        half = {
            side: replace(camera, port=replace(camera.port, **{word: 0.5 * getattr(camera.port, word)}))
            for side, camera in (("left", left), ("right", right))
        }
        hypotheses.append(_Hypothesis(f"ports.{word}", "it is half as much", half))
    indices = 1.0, geometry.index + OTHER_INDEX
    return hypotheses + [_Hypothesis("water.index", f"it is {index:.4g}", {"index": index}) for index in indices]


def _exchange_hypotheses(geometry: _Geometry) -> list[_Hypothesis]:
    """Return the hypothesis of left and right exchanged, if both have images of one size."""
    if next(iter(geometry.left_px.values())).shape != next(iter(geometry.right_px.values())).shape:
        return []
    textures = geometry.textures and (geometry.textures[1], geometry.textures[0], geometry.textures[2])
    changes = {"left_px": geometry.right_px, "right_px": geometry.left_px, "textures": textures}
    return [_Hypothesis(WHICH_IS_LEFT, "left and right are exchanged", changes)]


def _pattern_hypotheses(geometry: _Geometry, description: Description, left: DecodedCamera) -> list[_Hypothesis]:
    """Return other patterns on the projector that make the same images."""
    u_px, v_px = geometry.right_px.values()
    hypotheses = [_Hypothesis("images.order: x and y", "they are exchanged", {"right_px": {"x": v_px, "y": u_px}})]
    choices = []
    for axis in description.axes:
        size_px = axis.size_px
        start, period = "code_offset_px" if axis.bits else "start_deg", "period_px" if axis.periods_px else "stripe_px"
        sign, backwards = (
            ("code", "its sign is the other one") if axis.bits else ("sign", f'it is "{"+-"[axis.sign > 0]}"')
        )
        for word, text, scale, shift_px in (
            (sign, backwards, -1.0, size_px),
            *((period, f"it is {scale:g} times as much", scale, 0.0) for scale in SCALES),
            *((start, f"the pattern begins {share * size_px:+.0f} px aside", 1.0, share * size_px) for share in SHIFTS),
        ):
            subject = f"{axis.name}.{word}"
            moved = np.float32(scale) * (geometry.left_px[axis.name] + np.float32(0.5)) + np.float32(shift_px - 0.5)
            corrections: dict[str, Any] = {subject: -axis.sign} if word == "sign" else {}
            hypotheses.append(
                _Hypothesis(subject, text, {"left_px": {**geometry.left_px, axis.name: moved}}, corrections)
            )
        # A code of 2ⁿ stripes is wider than the projector: programs use its first stripes or those in the middle.
        beyond_px = axis.stripe_px * 2**axis.bits - size_px if axis.bits else 0.0
        other_px = 0.0 if axis.code_offset_px else -0.5 * beyond_px
        choices.append([axis, *([replace(axis, code_offset_px=other_px)] if beyond_px > 0.0 else [])])
    if len(description.axes) == 2 and not any(axis.bits for axis in description.axes):
        # A projector that is mounted upside down.
        corrections = {f"{axis.name}.sign": -axis.sign for axis in description.axes}
        rotated = {axis.name: np.float32(axis.size_px - 1) - geometry.left_px[axis.name] for axis in description.axes}
        hypotheses.append(_Hypothesis("x.sign", "both signs are the other ones", {"left_px": rotated}, corrections))
    for axes in list(product(*choices))[1:]:
        corrections = {f"{convention.name}.code_offset_px": convention.code_offset_px for convention in axes}
        changed = [
            f"{convention.name}.code_offset_px = {convention.code_offset_px:g}"
            for convention in axes
            if convention not in description.axes
        ]
        moved_px = _maps(place_again(left, replace(description, axes=axes)))
        hypotheses.append(
            _Hypothesis(changed[0].split(" ")[0], " and ".join(changed), {"left_px": moved_px}, corrections)
        )
    return hypotheses


# ---------------------------------------------------------------------------------------------------------- sizes


def _check_projector_size(
    description: Description, rig: ForeignRig, left: DecodedCamera, earlier: list[ExaminedAssumption]
) -> list[ExaminedAssumption]:
    """Test the size of the projector by the coordinates, its calibration and its fringe period."""
    for axis in description.axes:
        if axis.bits and np.any(left.placed[axis.name].reason == Reason.OUTSIDE):
            placed = place(left.measured[axis.name], axis, axis.covered_px)
            if larger := check_extent(axis, placed.coordinate_px):
                return larger
    results = []
    fitting = {assumption.subject for assumption in earlier if assumption.outcome is Outcome.FITS}
    stated = rig.stated_px.get("right") == description.projector_px
    for axis_name, word, size_px, centre_px in zip(
        "xy", ("width", "height"), description.projector_px, rig.rig.right.lens.c_px, strict=True
    ):
        checked = stated or bool(fitting & {f"{axis_name}.period_px", f"{axis_name}.stripe_px"})
        text = f"the projector's principal point is at {100 * centre_px / size_px:.0f} % of {size_px} px"
        results.append(fits_or_unchecked(f"projector.{word}_px", checked, text))
    return results


def _check_image_size(rig: StereoRig, of_projector: bool) -> ExaminedAssumption:
    """Test by the principal points whether the camera numbers are for images of this size."""
    subject, sides = "cameras: size of their images", (rig.left,) if of_projector else (rig.left, rig.right)
    centres = [
        c / size
        for camera in sides
        for c, size in zip(camera.lens.c_px, (camera.width_px, camera.height_px), strict=True)
    ]
    off_centre = {scale: max(abs(scale * centre - 0.5) for centre in centres) for scale in (1.0, 2.0, 0.5)}
    text = (
        f"their principal points are at {', '.join(f'{100 * centre:.0f} %' for centre in centres)} of width and height"
    )
    if off_centre[1.0] <= CENTRED:
        return fits_or_unchecked(subject, True, text)
    for scale, factor in ((2.0, "half"), (0.5, "twice")):
        if off_centre[scale] <= NEARLY_CENTRED:
            return contradiction(
                subject,
                f"{text}: the calibration is of images of {factor} the size, multiply the matrices by {scale:g}",
            )
    return fits_or_unchecked(
        subject, False, f"{text}: the images are parts of a sensor, or the calibration is for other images"
    )


# ----------------------------------------------------------------------------------------------------- points


def _collect_evidence(geometry: _Geometry, description: Description) -> _Evidence:
    """Make points along the first direction whose fringes cross the epipolar curves, and test them."""
    depths_mm = depths_of(description, StereoRig(geometry.left, geometry.right), geometry.index)
    limits = OneDirectionLimits(min_neighbours=LEAST_NEIGHBOURS)
    remark = ""
    for axis in description.axes:
        left_camera, left_px, step = _thin_out(geometry.left, geometry.left_px[axis.name])
        right_camera, right_px, right_step = _thin_out(geometry.right, geometry.right_px[axis.name])
        try:
            points = match_along_curves(
                left_px, right_px, StereoRig(left_camera, right_camera), geometry.index, depths_mm, limits=limits
            )
        except CurveError as error:
            remark = f" ({error})"
            continue
        has_point = points.mask
        share = float(np.count_nonzero(has_point) / np.count_nonzero(np.isfinite(left_px)))
        if share < POOR:
            reason = max(list(NoPoint)[NoPoint.OUT_OF_VIEW :], key=points.count)
            return _Evidence(share, remark=f" (most others: {reason.name.lower().replace('_', ' ')})")
        y, x = (places[:: max(1, np.count_nonzero(has_point) // PATCHES)] for places in np.nonzero(has_point))
        places_px = right_step * right_camera.project(points.points_mm[y, x].astype(np.float64), geometry.index)
        left_pixels = step * np.stack([x, y], axis=1)
        offset = NO_OFFSET
        if geometry.textures is not None:
            along, down = _slopes(right_px)
            offset = texture_offset(geometry.textures, left_pixels, places_px, along >= down)
        for second_axis in description.axes:
            if second_axis.name != axis.name:
                offset = _offset_by_other_direction(geometry, second_axis, left_pixels, places_px, right_step)
        depth_mm = float(np.median(points.points_mm[..., 2][has_point]))
        return _Evidence(share, _same_side(points.points_mm, right_camera), depth_mm, offset)
    return _Evidence(remark=remark)


def _offset_by_other_direction(
    geometry: _Geometry, axis: AxisConvention, left_pixels: NDArray[np.int64], places_px: NDArray[np.float64], step: int
) -> Offset:
    """Return how far points lie beside the right px that have the other coordinate of their left pixels."""
    right_map_px = geometry.right_px[axis.name]
    u, v = np.ascontiguousarray(places_px.T[:, None], np.float32)
    seen_px = cv2.remap(right_map_px, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    slope = max(*_slopes(right_map_px[::step, ::step]), 1e-6) / step
    offset_px = (geometry.left_px[axis.name][left_pixels[:, 1], left_pixels[:, 0]] - seen_px[0]) / slope
    error_px = MOST_ASIDE_PERIODS * axis.period_px if geometry.projector else 0.0
    return Offset.of(offset_px[np.isfinite(offset_px)].astype(np.float64), len(offset_px), MOST_ASIDE_PX + error_px)


def _slopes(coordinate_px: Floats) -> tuple[float, float]:
    """Return the median change of a coordinate between neighbouring pixels along the rows and the columns."""
    along, down = (np.abs(np.diff(coordinate_px, axis=axis)) for axis in (1, 0))
    return float(np.nanmedian(along)), float(np.nanmedian(down))


def _same_side(points_mm: NDArray[np.float32], right: HousedCamera) -> float:
    """Return the share of the surface that both sides see from the same side."""
    normal = np.cross(points_mm[1:-1, 2:] - points_mm[1:-1, :-2], points_mm[2:, 1:-1] - points_mm[:-2, 1:-1])
    middle = points_mm[1:-1, 1:-1]
    from_left, from_right = (
        (normal * (middle - np.array(centre_mm))).sum(-1) for centre_mm in ((0, 0, 0), right.translation_mm)
    )
    finite = np.isfinite(from_left)
    return float(np.mean((from_left * from_right)[finite] > 0.0)) if finite.any() else 1.0


def _maps(camera: DecodedCamera) -> Maps:
    return {name: placed.coordinate_px for name, placed in camera.placed.items()}


def _thin_out(camera: HousedCamera, map_px: Floats) -> tuple[HousedCamera, Floats, int]:
    """Return the camera reduced to every step-th pixel, its reduced coordinate map, and the step.

    The step counts pixels of ``map_px``, which may itself hold only every so many pixels of the camera.
    """
    step = -(-map_px.shape[1] // COARSE_PX)
    reduced_px = map_px[::step, ::step]
    scale = step * round(camera.width_px / map_px.shape[1])
    (fu, fv), (cu, cv) = camera.lens.f_px, camera.lens.c_px
    lens = replace(camera.lens, f_px=(fu / scale, fv / scale), c_px=(cu / scale, cv / scale))
    height_px, width_px = reduced_px.shape
    # Image corrections are hundredths of a pixel: too little to tell one geometry from another.
    reduced = replace(camera, width_px=width_px, height_px=height_px, lens=lens, correction=None, ray_shift=None)
    return reduced, reduced_px, step
