"""Owns the tests of an image set description: whether the images agree with what it says of cameras and projector.

``examine`` does two kinds of test. ``assumptions.py`` tests the images of each camera alone. This module tests cameras,
or camera and projector, together. It makes a coarse cloud along epipolar curves as described, and one for each
alternative: R transposed, left and right exchanged, another fringe period, and so on. Three quantities can contradict a
cloud:

    share        of the left pixels with coordinates, how many have a point. Low if the cameras look elsewhere.
    same side    how much of the surface both see from the same side. Low if the pattern runs the other way.
    aside        across the disparity, in px: where the other direction or the texture shows a point in the right
                 image, less where the point is projected to. Large if the poses are wrong.

Each statement of the description is then
    FITS         if the description is not contradicted, but all alternatives are,
    WRONG        if an alternative is clearly better, or the description is contradicted,
    UNCHECKED    if an alternative is as good, or nothing tells.
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
    beyond,
    examine_axis,
    examine_references,
    told,
    wrong,
)
from appliance.desk.foreign.camera import DecodedCamera, placed_again
from appliance.desk.foreign.cameras import ForeignRig
from appliance.desk.foreign.decode import Reason, place
from appliance.desk.foreign.description import AxisConvention, Description
from appliance.desk.foreign.phase import Floats
from appliance.desk.foreign.points import depths_of, own_px
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
"""Largest width of what points are made of, and neighbours that a point has there."""
POOR, NONE = 0.25, 0.02
"""Share of the left pixels with coordinates that have a point: what is said is doubtful with fewer, and wrong with next
to none."""
CLEARLY = 2.0
"""Another hypothesis is better by so many times more points, or a smaller offset."""
SAME_SIDE = 0.8
MOST_ASIDE_PX, MOST_ASIDE_PERIODS, SURE_PX = 2.0, 0.06, 1.0
"""Offset that right numbers leave: of two cameras, and of a projector besides by the error of its phase; and the least
that contradicts."""
FOUND_SHARE, PATCHES = 0.15, 1200
OTHER_INDEX = 0.03
SCALES, SHIFTS = (0.5, 0.8, 1.25, 2.0), (-0.125, 0.125)
"""Other periods of a projector, over the one that was said, and other starts, over its size."""
CENTRED, NEARLY_CENTRED = 0.12, 0.06
"""Distance of a principal point from the middle of its image, over its size: of a whole sensor, and after another size
was put right."""
POSE, TURN, TURN_DEG = "cameras: rotation and translation", "cameras: a turn about the columns", 0.3
WHICH_IS_LEFT = "cameras: which is left"
REMEDIES = (
    "check that the calibration is of this setting and of images of this size, cameras.unit, water and ports, and range"
)
NOTHING = Offset(0, 0, 0.0, 0.0, 0.0)
Maps = Mapping[str, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class _Setting:
    """Both sides as they may stand, and what each pixel of theirs sees of the pattern."""

    left: HousedCamera
    right: HousedCamera
    index: float
    left_px: Maps
    right_px: Maps
    """A projector has its own coordinates."""
    textures: Textures | None
    """``None`` where the other direction tells, or there is no second picture."""
    projector: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """Something that may be meant otherwise."""

    about: str
    text: str
    changed: Mapping[str, Any]
    """Fields of the setting."""
    instead: Mapping[str, Any] = field(default_factory=dict)
    """Words of the description."""


@dataclass(frozen=True, slots=True)
class _Found:
    """Points that were made of a setting, and what contradicts them."""

    share: float = 0.0
    same_side: float = 1.0
    depth_mm: float = 0.0
    aside: Offset = NOTHING
    why: str = ""

    @property
    def holds(self) -> bool:
        """True if nothing contradicts it."""
        return self.share >= POOR and self.same_side >= SAME_SIDE and (self.aside.fits or not self.aside.tells)

    def better(self, other: _Found) -> bool:
        """Tell whether this is clearly better: by what both have across the disparity, else by their points."""
        if other.aside.tells and self.holds:
            return self.aside.fits and other.aside.size_px > max(SURE_PX, CLEARLY * self.aside.size_px)
        return self.holds and (not other.holds or self.share > CLEARLY * other.share)

    def __str__(self) -> str:
        said = [f"{100 * self.share:.0f} % have a point{self.why}"]
        if self.same_side < SAME_SIDE:
            said.append(f"{100 - 100 * self.same_side:.0f} % of the surface would be seen from behind")
        return ", ".join([*said, str(self.aside)] if self.aside.asked else said)


def examine(
    description: Description, cameras: Mapping[str, DecodedCamera], rig: ForeignRig | None
) -> tuple[ExaminedAssumption, ...]:
    """Test all that is said of decoded images, and of ``rig`` where it is known; images may be thinned by a whole
    number.

    A word that one test leaves open does not fit because of another one.
    """
    tested = [one for side, camera in cameras.items() for one in examine_images(side, camera, description)]
    return examine_rays(description, cameras, rig, tested)


def examine_images(side: str, camera: DecodedCamera, description: Description) -> list[ExaminedAssumption]:
    """Return what one camera's images say of the description."""
    found = examine_references(camera)
    for axis in description.axes:
        found += examine_axis(camera, axis)
    return [replace(one, about=f"{side}: {one.about}") for one in found]


def examine_rays(
    description: Description,
    cameras: Mapping[str, DecodedCamera],
    rig: ForeignRig | None,
    tested: list[ExaminedAssumption],
) -> tuple[ExaminedAssumption, ...]:
    """Return what the images say of themselves, ``tested``, and what rays say of the cameras."""
    if any(one.outcome is Outcome.WRONG for one in tested):
        # Of coordinates that are wrong, nothing could be told about the cameras.
        tested.append(ExaminedAssumption("cameras", Outcome.UNCHECKED, "what the images show is described wrongly"))
    elif rig is not None:
        tested += examine_cameras(description, rig, cameras)
    open_ = {one.about.split(": ")[-1] for one in tested if one.outcome is not Outcome.FITS}
    return tuple(one for one in tested if one.outcome is not Outcome.FITS or one.about.split(": ")[-1] not in open_)


def examine_cameras(
    description: Description, rig: ForeignRig, cameras: Mapping[str, DecodedCamera]
) -> list[ExaminedAssumption]:
    """Test what is said of ``cameras``, which are ``left`` and, unless the right one is a projector, ``right``."""
    left, right = cameras["left"], cameras.get("right")
    size = _size(rig.rig, right is None)
    if size.outcome is Outcome.WRONG:
        return [size]
    textures = textures_of(left.grey, right.grey) if right is not None and description.one_direction else None
    right_px = own_px(rig.rig.right) if right is None else _maps(right)
    setting = _Setting(rig.rig.left, rig.rig.right, rig.index, _maps(left), right_px, textures, right is None)
    here = _found(setting, description)
    hypotheses = _standing(setting, rig)
    hypotheses += _exchanged(setting) if right is not None else _patterns(setting, description, left)
    tried = [(one, _found(replace(setting, **one.changed), description)) for one in hypotheses]
    said = _judged(here, tried)
    if right is None and not any(one.outcome is Outcome.WRONG for one in said):
        said += _extent(description, rig, left, said)
    if any(one.outcome is Outcome.WRONG for one in said):
        return said
    if rig.calibration is None and rig.scale_known:
        apart_mm = float(np.linalg.norm(rig.rig.right.translation_mm))
        text = f"no image tells lengths: with it both are {apart_mm:.4g} mm apart, and the object is {here.depth_mm:.4g} mm away"
        said.append(told("cameras.unit", False, text))
    return [*said, size]


def _judged(here: _Found, tried: list[tuple[_Hypothesis, _Found]]) -> list[ExaminedAssumption]:
    """Return what the hypotheses say of the words that they are about."""
    better = [(one, found) for one, found in tried if found.better(here)]
    if better:
        one, found = min(better, key=lambda two: (-two[1].aside.tells, two[1].aside.size_px, -two[1].share))
        # Without anything across the disparity several may do; the user is not sent after the first one alone.
        rivals = [other.text for other, theirs in better if other is not one and not found.better(theirs)]
        return [wrong(one.about, f"{here}; {found} if {' or '.join([one.text, *rivals])}", **one.instead)]
    if not here.holds:
        aside = here.aside
        sure = aside.spread_px <= aside.allowed_px or aside.found > FOUND_SHARE * aside.asked
        contradicted = here.share <= NONE or here.same_side < SAME_SIDE or (here.share >= POOR and sure)
        text = f"{here}, and no better if cameras, R or T are exchanged: {REMEDIES}"
        return [wrong(POSE, text) if contradicted else told(POSE, False, text)]
    said = []
    for about in dict.fromkeys(one.about for one, _ in tried):
        mine = [(one, found) for one, found in tried if one.about == about]
        as_good = [(one, found) for one, found in mine if found.holds and not here.better(found)]
        one, found = max(as_good or mine, key=lambda two: two[1].share)
        text = f"{found} if {one.text}"
        if as_good:
            text += f", {found.depth_mm:.0f} mm away in place of {here.depth_mm:.0f} mm"
        elif about == POSE:
            text = f"{here}, and {text}" + ("" if here.aside.tells else ", but nothing checks their values")
        # A turn is no other thing than a pose where nothing checks its values.
        if about != TURN or here.aside.tells:
            said.append(told(about, not as_good and (about != POSE or here.aside.tells), text))
    return said


# ------------------------------------------------------------------------------------------------- hypotheses


def _standing(setting: _Setting, rig: ForeignRig) -> list[_Hypothesis]:
    """Return the ways in which R and T, windows and water may be meant otherwise."""
    left, right = setting.left, setting.right
    R = np.asarray(right.rotation).T
    T = -R @ np.asarray(right.translation_mm)
    # About the axis across the disparity, which of two cameras hardly anything sees.
    turn = np.asarray(cv2.Rodrigues(np.deg2rad(TURN_DEG) * np.eye(3)[1 if abs(T[0]) >= abs(T[1]) else 0])[0])
    found = []
    for about, text, other_R, other_T in (
        (POSE, "they are R and T of right to left", R.T, -R.T @ T),
        (POSE, "R is transposed", R.T, T),
        (POSE, "T is negated", R, -T),
        (POSE, "R is transposed and T negated", R.T, -T),
        (TURN, f"it is {TURN_DEG:g}° more", turn @ R, T),
        (TURN, f"it is {TURN_DEG:g}° less", turn.T @ R, T),
    ):
        x, y, z = (float(one) for one in -other_R.T @ other_T)
        other = replace(right, rotation=matrix3(other_R.T), translation_mm=(x, y, z))
        found.append(_Hypothesis(about, text, {"right": other}))
    if right.lens_in_water:
        return found
    for word in ("distance_mm", "thickness_mm") if rig.calibration is None else ():
        half = {
            side: replace(one, port=replace(one.port, **{word: 0.5 * getattr(one.port, word)}))
            for side, one in (("left", left), ("right", right))
        }
        found.append(_Hypothesis(f"ports.{word}", "it is half as much", half))
    others = 1.0, setting.index + OTHER_INDEX
    return found + [_Hypothesis("water.index", f"it is {index:.4g}", {"index": index}) for index in others]


def _exchanged(setting: _Setting) -> list[_Hypothesis]:
    """Return left for right, where the lenses of one fit images of the other's size."""
    if next(iter(setting.left_px.values())).shape != next(iter(setting.right_px.values())).shape:
        return []
    textures = setting.textures and (setting.textures[1], setting.textures[0], setting.textures[2])
    changed = {"left_px": setting.right_px, "right_px": setting.left_px, "textures": textures}
    return [_Hypothesis(WHICH_IS_LEFT, "left and right are exchanged", changed)]


def _patterns(setting: _Setting, description: Description, left: DecodedCamera) -> list[_Hypothesis]:
    """Return other patterns on the projector that make the same images."""
    u_px, v_px = setting.right_px.values()
    found = [_Hypothesis("images.order: x and y", "they are exchanged", {"right_px": {"x": v_px, "y": u_px}})]
    choices = []
    for axis in description.axes:
        size_px = axis.size_px
        start, period = "code_offset_px" if axis.bits else "start_deg", "period_px" if axis.periods_px else "stripe_px"
        sign, backwards = ("code", "it runs the other way") if axis.bits else ("sign", f'it is "{"+-"[axis.sign > 0]}"')
        for word, text, scale, shift_px in (
            (sign, backwards, -1.0, size_px),
            *((period, f"it is {scale:g} times as much", scale, 0.0) for scale in SCALES),
            *((start, f"the pattern begins {share * size_px:+.0f} px aside", 1.0, share * size_px) for share in SHIFTS),
        ):
            about = f"{axis.name}.{word}"
            moved = np.float32(scale) * (setting.left_px[axis.name] + np.float32(0.5)) + np.float32(shift_px - 0.5)
            instead: dict[str, Any] = {about: -axis.sign} if word == "sign" else {}
            found.append(_Hypothesis(about, text, {"left_px": {**setting.left_px, axis.name: moved}}, instead))
        # Of 2ⁿ stripes on a projector of fewer px, programs use the first ones or those in the middle.
        beyond_px = axis.stripe_px * 2**axis.bits - size_px if axis.bits else 0.0
        other_px = 0.0 if axis.code_offset_px else -0.5 * beyond_px
        choices.append([axis, *([replace(axis, code_offset_px=other_px)] if beyond_px > 0.0 else [])])
    if len(description.axes) == 2 and not any(axis.bits for axis in description.axes):
        # A projector that stands on its head.
        instead = {f"{axis.name}.sign": -axis.sign for axis in description.axes}
        turned = {axis.name: np.float32(axis.size_px - 1) - setting.left_px[axis.name] for axis in description.axes}
        found.append(_Hypothesis("x.sign", "both signs are the other way", {"left_px": turned}, instead))
    for axes in list(product(*choices))[1:]:
        instead = {f"{one.name}.code_offset_px": one.code_offset_px for one in axes}
        changed = [f"{one.name}.code_offset_px = {one.code_offset_px:g}" for one in axes if one not in description.axes]
        moved_px = _maps(placed_again(left, replace(description, axes=axes)))
        found.append(_Hypothesis(changed[0].split(" ")[0], " and ".join(changed), {"left_px": moved_px}, instead))
    return found


# --------------------------------------------------------------------------------------- what else is said of them


def _extent(
    description: Description, rig: ForeignRig, left: DecodedCamera, said: list[ExaminedAssumption]
) -> list[ExaminedAssumption]:
    """Say whether the projector's size is too small, or what checks it: the words of its calibration, else what checks
    the period."""
    for axis in description.axes:
        if axis.bits and np.any(left.placed[axis.name].reason == Reason.OUTSIDE):
            whole = place(left.measured[axis.name], axis, axis.covered_px)
            if larger := beyond(axis, whole.coordinate_px):
                return larger
    found = []
    fit = {one.about for one in said if one.outcome is Outcome.FITS}
    stated = rig.stated_px.get("right") == description.projector_px
    for axis_name, word, size_px, at_px in zip(
        "xy", ("width", "height"), description.projector_px, rig.rig.right.lens.c_px, strict=True
    ):
        checked = stated or bool(fit & {f"{axis_name}.period_px", f"{axis_name}.stripe_px"})
        text = f"the projector's axis leaves at {100 * at_px / size_px:.0f} % of {size_px} px"
        found.append(told(f"projector.{word}_px", checked, text))
    return found


def _size(rig: StereoRig, of_projector: bool) -> ExaminedAssumption:
    """Test by the principal points whether the lenses are those of images of this size."""
    about, sides = "cameras: size of their images", (rig.left,) if of_projector else (rig.left, rig.right)
    places = [c / size for one in sides for c, size in zip(one.lens.c_px, (one.width_px, one.height_px), strict=True)]
    beside = {scale: max(abs(scale * at - 0.5) for at in places) for scale in (1.0, 2.0, 0.5)}
    text = f"their axes meet the images at {', '.join(f'{100 * at:.0f} %' for at in places)} of width and height"
    if beside[1.0] <= CENTRED:
        return told(about, True, text)
    for scale, other in ((2.0, "half"), (0.5, "twice")):
        if beside[scale] <= NEARLY_CENTRED:
            return wrong(
                about, f"{text}: the calibration is of images of {other} the size, multiply the matrices by {scale:g}"
            )
    return told(about, False, f"{text}: parts of a sensor, or a calibration of other images")


# ----------------------------------------------------------------------------------------------------- points


def _found(setting: _Setting, description: Description) -> _Found:
    """Make points along the first direction whose fringes cross the epipolar curves, and ask them."""
    depths_mm = depths_of(description, StereoRig(setting.left, setting.right), setting.index)
    limits = OneDirectionLimits(min_neighbours=LEAST_NEIGHBOURS)
    why = ""
    for axis in description.axes:
        first, left_px, step = _coarse(setting.left, setting.left_px[axis.name])
        second, right_px, right_step = _coarse(setting.right, setting.right_px[axis.name])
        try:
            points = match_along_curves(
                left_px, right_px, StereoRig(first, second), setting.index, depths_mm, limits=limits
            )
        except CurveError as error:
            why = f" ({error})"
            continue
        there = points.mask
        share = float(np.count_nonzero(there) / np.count_nonzero(np.isfinite(left_px)))
        if share < POOR:
            reason = max(list(NoPoint)[NoPoint.OUT_OF_VIEW :], key=points.count)
            return _Found(share, why=f" (most others: {reason.name.lower().replace('_', ' ')})")
        y, x = (at[:: max(1, np.count_nonzero(there) // PATCHES)] for at in np.nonzero(there))
        places_px = right_step * second.project(points.points_mm[y, x].astype(np.float64), setting.index)
        left_at = step * np.stack([x, y], axis=1)
        aside = NOTHING
        if setting.textures is not None:
            along, down = _slopes(right_px)
            aside = texture_offset(setting.textures, left_at, places_px, along >= down)
        for other in description.axes:
            if other.name != axis.name:
                aside = _by_other(setting, other, left_at, places_px, right_step)
        depth_mm = float(np.median(points.points_mm[..., 2][there]))
        return _Found(share, _same_side(points.points_mm, second), depth_mm, aside)
    return _Found(why=why)


def _by_other(
    setting: _Setting, axis: AxisConvention, left_at: NDArray[np.int64], places_px: NDArray[np.float64], step: int
) -> Offset:
    """Return how far the right image has the other coordinate of left pixels beside the places of their points."""
    whole_px = setting.right_px[axis.name]
    u, v = np.ascontiguousarray(places_px.T[:, None], np.float32)
    there = cv2.remap(whole_px, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    slope = max(*_slopes(whole_px[::step, ::step]), 1e-6) / step
    off_px = (setting.left_px[axis.name][left_at[:, 1], left_at[:, 0]] - there[0]) / slope
    error_px = MOST_ASIDE_PERIODS * axis.period_px if setting.projector else 0.0
    return Offset.of(off_px[np.isfinite(off_px)].astype(np.float64), len(off_px), MOST_ASIDE_PX + error_px)


def _slopes(coordinate_px: Floats) -> tuple[float, float]:
    """Return by how much a coordinate usually changes from one pixel to the next along the image, and down."""
    along, down = (np.abs(np.diff(coordinate_px, axis=axis)) for axis in (1, 0))
    return float(np.nanmedian(along)), float(np.nanmedian(down))


def _same_side(points_mm: NDArray[np.float32], right: HousedCamera) -> float:
    """Return the share of the surface that both sides see from the same side."""
    normal = np.cross(points_mm[1:-1, 2:] - points_mm[1:-1, :-2], points_mm[2:, 1:-1] - points_mm[:-2, 1:-1])
    middle = points_mm[1:-1, 1:-1]
    from_left, from_right = ((normal * (middle - np.array(at))).sum(-1) for at in ((0, 0, 0), right.translation_mm))
    known = np.isfinite(from_left)
    return float(np.mean((from_left * from_right)[known] > 0.0)) if known.any() else 1.0


def _maps(camera: DecodedCamera) -> Maps:
    return {name: one.coordinate_px for name, one in camera.placed.items()}


def _coarse(camera: HousedCamera, whole_px: Floats) -> tuple[HousedCamera, Floats, int]:
    """Return the lens that sees every so many pixels, what these see of the pattern, and how many of the map's pixels
    each one is.

    The map may itself be of every so many of the camera's own pixels.
    """
    step = -(-whole_px.shape[1] // COARSE_PX)
    few_px = whole_px[::step, ::step]
    scale = step * round(camera.width_px / whole_px.shape[1])
    (fu, fv), (cu, cv) = camera.lens.f_px, camera.lens.c_px
    lens = replace(camera.lens, f_px=(fu / scale, fv / scale), c_px=(cu / scale, cv / scale))
    height_px, width_px = few_px.shape
    # Corrections of an image are worth hundredths of a pixel: too little to tell one arrangement from another.
    thin = replace(camera, width_px=width_px, height_px=height_px, lens=lens, correction=None, ray_shift=None)
    return thin, few_px, step
