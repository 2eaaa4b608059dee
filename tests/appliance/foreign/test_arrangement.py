"""What is said of the cameras and of a projector's pattern, on a textured scene: each wrong word is named, and no right one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.foreign.arrangement import POSE, TURN, examine_cameras
from appliance.foreign.assumptions import ExaminedAssumption, Outcome
from appliance.foreign.camera import DecodedCamera
from appliance.foreign.cameras import ForeignRig, read_rig
from appliance.foreign.decode import PlacedAxis
from appliance.foreign.description import Description, parse_description
from appliance.foreign.images import ImageSet
from tests.support.strangers import RAYS, Bench, View, lit, pair, photographs, with_projector

WIDTH_PX, SIZE = 240, (640, 480)
LEFT = "cameras: which is left"
IMAGES_SIZE = "cameras: size of their images"
XY = "images.order: x and y"
Array = NDArray[np.float64]


@lru_cache(maxsize=8)
def seen(camera: View, projector: View) -> DecodedCamera:
    """Coordinates as the middle ray of each pixel has them; a projected speckle stands for the texture of the thing."""
    there = lit(camera, projector)
    number = RAYS * RAYS // 2
    middle = slice(number * camera.height_px, (number + 1) * camera.height_px)
    dark = there.shade[middle] == 0.0
    maps = {
        name: np.where(dark, np.float32(np.nan), one[middle]) for name, one in (("x", there.column), ("y", there.row))
    }
    speckle = cv2.GaussianBlur(np.random.default_rng(1).normal(0.0, 1.0, SIZE[::-1]), (0, 0), 3.0)
    pattern = np.clip(125.0 + 400.0 * speckle, 0, 255).astype(np.uint8)
    grey = photographs(camera, projector, [pattern], 3)[0]
    placed = {name: PlacedAxis(one, np.zeros(one.shape, np.uint8), np.ones_like(one)) for name, one in maps.items()}
    return DecodedCamera(ImageSet((), (), np.zeros((0, *grey.shape), np.uint8), 255.0), {}, placed, grey)


def described(bench: Bench, axes: str, more: str = "", **cameras: Any) -> tuple[Description, ForeignRig]:
    """A description in ``axes`` (one letter each), and the rig with some of its matrices replaced."""
    numbers = {"K1": bench.left.K, "K2": bench.right.K, "R": bench.R, "T": bench.T} | cameras
    matrix = {name: np.asarray(one).tolist() for name, one in numbers.items()}
    projector = bench.right is bench.projector
    text = '[images]\nleft = "l"\n' + ("" if projector else 'right = "r"\n')
    text += f'order = "{" ".join(f"sine-{axis}*4 sine-{axis}2*4" for axis in axes)}"\n'
    text += f"[projector]\nwidth_px = {SIZE[0]}\nheight_px = {SIZE[1]}\n"
    text += "".join(f"[{axis}]\nfringes = [16, 1]\nsteps = 4\n" for axis in axes)
    text += f"[cameras]\nrotation = {matrix['R']}\ntranslation = {matrix['T']}\n"
    for n, (side, view) in enumerate((("left", bench.left), ("right", bench.right)), 1):
        text += f"[cameras.{side}]\nmatrix = {matrix[f'K{n}']}\ndistortion = {view.D.tolist()}\n"
    description = parse_description(text + more, Path(), "set", "set.toml")
    sizes = {side: (view.width_px, view.height_px) for side, view in (("left", bench.left), ("right", bench.right))}
    return description, read_rig(description, sizes)


def turned(bench: Bench, axis: int, degrees: float) -> Array:
    return np.asarray(cv2.Rodrigues(np.deg2rad(degrees) * np.eye(3)[axis])[0] @ bench.R)


def told(
    axes: str, bench: Bench | None = None, exchanged: bool = False, change: Callable[[DecodedCamera], DecodedCamera] | None = None,
    **cameras: Any,
) -> Mapping[str, ExaminedAssumption]:  # fmt: skip
    """What is said by word."""
    bench = bench or pair(WIDTH_PX, SIZE)
    description, rig = described(bench, axes, **cameras)
    views = (bench.right, bench.left) if exchanged else (bench.left, bench.right)
    found = {side: seen(view, bench.projector) for side, view in zip(("left", "right"), views, strict=True)}
    if bench.right is bench.projector:
        del found["right"]
    thinned = {side: replace(one, placed={axis: one.placed[axis] for axis in axes}) for side, one in found.items()}
    if change:
        thinned = {side: change(one) for side, one in thinned.items()}
    said = examine_cameras(description, rig, thinned)
    assert len({one.about for one in said}) == len(said)
    return {one.about: one for one in said}


def outcomes(said: Mapping[str, ExaminedAssumption], outcome: Outcome) -> set[str]:
    return {about for about, one in said.items() if one.outcome is outcome}


R, T = pair(WIDTH_PX, SIZE).R, pair(WIDTH_PX, SIZE).T
K = np.diag([0.5, 0.5, 1.0])


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_right_cameras_fit_and_what_nothing_sees_is_said(axes: str) -> None:
    """Thinned images are told with the lens of the whole ones; a small turn about the columns is seen by nothing."""

    def thin(one: DecodedCamera) -> DecodedCamera:
        placed = {name: replace(p, coordinate_px=p.coordinate_px[::2, ::2]) for name, p in one.placed.items()}
        return replace(one, placed=placed, grey=one.grey[::2, ::2])

    for said in (
        told(axes),
        told(axes, change=thin) if axes == "xy" else told(axes, R=turned(pair(WIDTH_PX, SIZE), 1, 0.3)),
    ):
        assert outcomes(said, Outcome.FITS) == {POSE, LEFT, IMAGES_SIZE}
        assert {TURN, "cameras.unit"} <= outcomes(said, Outcome.UNCHECKED)


@pytest.mark.parametrize(
    ("axes", "about", "text", "wrong"),
    [
        ("x", LEFT, "if left and right are exchanged", {"exchanged": True}),
        ("xy", POSE, "if they are R and T of right to left", {"R": R.T, "T": -R.T @ T}),
        ("x", POSE, "if R is transposed", {"R": R.T}),
        ("xy", POSE, "if T is negated", {"T": -T}),
        ("x", POSE, "if R is transposed and T negated", {"R": R.T, "T": -T}),
        ("xy", POSE, "no better if cameras, R or T are exchanged", {"R": turned(pair(WIDTH_PX, SIZE), 0, 1.0)}),
        ("x", IMAGES_SIZE, "half the size, multiply the matrices by 2",
         {"K1": K @ pair(WIDTH_PX, SIZE).left.K, "K2": K @ pair(WIDTH_PX, SIZE).right.K}),
    ],
)  # fmt: skip
def test_wrong_cameras_are_named(axes: str, about: str, text: str, wrong: Mapping[str, Any]) -> None:
    said = told(axes, **wrong)
    assert outcomes(said, Outcome.WRONG) == {about}
    assert text in said[about].text


@pytest.mark.parametrize(
    ("degrees", "outcome", "text"),
    [(0.3, Outcome.WRONG, "if it is 0.3° less"), (-0.3, Outcome.WRONG, "if it is 0.3° more"), (0.15, Outcome.UNCHECKED, "")],
)  # fmt: skip
def test_a_projector_that_is_turned_about_the_columns_is_not_passed_over(
    degrees: float, outcome: Outcome, text: str
) -> None:
    """Of its two directions the other one moves across the disparity, by 3 px."""
    bench = with_projector(WIDTH_PX, SIZE)
    said = told("xy", bench, R=turned(bench, 1, degrees))
    assert said[TURN].outcome is outcome
    assert said[TURN].text.endswith(text)


def test_without_texture_one_direction_leaves_the_cameras_unchecked() -> None:
    smooth = told("x", change=lambda one: replace(one, grey=np.full_like(one.grey, 90)))
    assert {POSE, LEFT} <= outcomes(smooth, Outcome.UNCHECKED)
    assert "too few to tell" in smooth[POSE].text


# ---------------------------------------------------------------------------------------------- a projector


def test_of_several_that_do_as_well_none_is_left_out() -> None:
    bench = with_projector(WIDTH_PX, SIZE)
    said = told("x", bench, R=bench.R.T, T=-bench.T)[POSE]
    assert said.outcome is Outcome.WRONG
    assert "if they are R and T of right to left or R is transposed and T negated" in said.text


def scaled(scale: float, shift_px: float, name: str = "x") -> Callable[[DecodedCamera], DecodedCamera]:
    """The images as another pattern on the projector would make them."""

    def change(one: DecodedCamera) -> DecodedCamera:
        map_ = one.placed[name]
        moved = np.float32(scale) * map_.coordinate_px + np.float32(shift_px)
        return replace(one, placed={**one.placed, name: replace(map_, coordinate_px=moved)})

    return change


PATTERN = {"x.period_px", "x.start_deg", "projector.width_px", "projector.height_px"}


def test_one_direction_of_a_projector_checks_its_sign_alone_and_two_hardly_leave_anything() -> None:
    """Windows and water are nearly a longer lens, seen from half a metre away: nothing sees them."""
    said = told("x", with_projector(WIDTH_PX, SIZE))
    assert outcomes(said, Outcome.FITS) == {"x.sign", XY, IMAGES_SIZE}
    assert outcomes(said, Outcome.UNCHECKED) == {POSE, "cameras.unit", *PATTERN}
    assert "50 % of 640 px" in said["projector.width_px"].text
    said = told("xy", with_projector(WIDTH_PX, SIZE))
    assert outcomes(said, Outcome.WRONG) == set()
    assert outcomes(said, Outcome.UNCHECKED) <= {TURN, "cameras.unit"}
    bench = pair(WIDTH_PX, SIZE)
    wet = "[water]\nindex = 1.0\n[ports]\ndistance_mm = 4.0\nthickness_mm = 1.0\nglass_index = 1.5\n"
    description, rig = described(bench, "x", more=wet)
    found = {side: seen(view, bench.projector) for side, view in (("left", bench.left), ("right", bench.right))}
    unchecked = {one.about for one in examine_cameras(description, rig, found) if one.outcome is Outcome.UNCHECKED}
    assert {"ports.distance_mm", "ports.thickness_mm", "water.index"} <= unchecked


def on_its_head(one: DecodedCamera) -> DecodedCamera:
    return scaled(-1.0, SIZE[1] - 1.0, "y")(scaled(-1.0, SIZE[0] - 1.0)(one))


@pytest.mark.parametrize(
    ("axes", "change", "instead"),
    [("x", scaled(-1.0, SIZE[0] - 100.0), {"x.sign": -1}), ("xy", on_its_head, {"x.sign": -1, "y.sign": -1})],
)
def test_a_pattern_that_runs_backwards_would_light_the_surface_from_behind(
    axes: str, change: Callable[[DecodedCamera], DecodedCamera], instead: dict[str, int]
) -> None:
    said = told(axes, with_projector(WIDTH_PX, SIZE), change=change)
    assert outcomes(said, Outcome.WRONG) == {"x.sign"}
    assert said["x.sign"].instead == instead


def exchanged(one: DecodedCamera) -> DecodedCamera:
    return replace(one, placed={"x": one.placed["y"], "y": one.placed["x"]})


@pytest.mark.parametrize(
    ("word", "change"),
    [
        ("x.period_px", scaled(2.0, 0.5)),
        ("y.period_px", scaled(0.5, -0.25, "y")),
        ("x.start_deg", scaled(1.0, 80.0)),
        (XY, exchanged),
    ],
)
def test_the_third_ray_of_two_directions_checks_the_pattern(
    word: str, change: Callable[[DecodedCamera], DecodedCamera]
) -> None:
    said = told("xy", with_projector(WIDTH_PX, SIZE), change=change)
    assert outcomes(said, Outcome.WRONG) == {word}
