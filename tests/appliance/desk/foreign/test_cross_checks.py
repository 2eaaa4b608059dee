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

from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome
from appliance.desk.foreign.camera import DecodedCamera
from appliance.desk.foreign.cameras import ForeignRig, read_rig
from appliance.desk.foreign.cross_checks import POSE, TURN, examine_cameras
from appliance.desk.foreign.decode import AxisCoordinates
from appliance.desk.foreign.description import Description, parse_description
from appliance.desk.foreign.images import ImageSet
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
    placed = {
        name: AxisCoordinates(one, np.zeros(one.shape, np.uint8), np.ones_like(one)) for name, one in maps.items()
    }
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
    axes: str, bench: Bench, exchanged: bool = False, change: Callable[[DecodedCamera], DecodedCamera] = lambda one: one, **cameras: Any
) -> Mapping[str, ExaminedAssumption]:  # fmt: skip
    """What is said by word."""
    description, rig = described(bench, axes, **cameras)
    views = (bench.right, bench.left) if exchanged else (bench.left, bench.right)
    found = {side: seen(view, bench.projector) for side, view in zip(("left", "right"), views, strict=True)}
    if bench.right is bench.projector:
        del found["right"]
    said = examine_cameras(
        description,
        rig,
        {side: change(replace(one, placed={axis: one.placed[axis] for axis in axes})) for side, one in found.items()},
    )
    assert len({one.subject for one in said}) == len(said)
    return {one.subject: one for one in said}


def outcomes(said: Mapping[str, ExaminedAssumption], outcome: Outcome) -> set[str]:
    return {about for about, one in said.items() if one.outcome is outcome}


def scaled(scale: float, shift_px: float, name: str = "x") -> Callable[[DecodedCamera], DecodedCamera]:
    """The images as another pattern on the projector would make them."""

    def change(one: DecodedCamera) -> DecodedCamera:
        map_ = one.placed[name]
        moved = np.float32(scale) * map_.coordinate_px + np.float32(shift_px)
        return replace(one, placed={**one.placed, name: replace(map_, coordinate_px=moved)})

    return change


def on_its_head(one: DecodedCamera) -> DecodedCamera:
    return scaled(-1.0, SIZE[1] - 1.0, "y")(scaled(-1.0, SIZE[0] - 1.0)(one))


def exchanged(one: DecodedCamera) -> DecodedCamera:
    return replace(one, placed={"x": one.placed["y"], "y": one.placed["x"]})


def thin(one: DecodedCamera) -> DecodedCamera:
    placed = {name: replace(p, coordinate_px=p.coordinate_px[::2, ::2]) for name, p in one.placed.items()}
    return replace(one, placed=placed, grey=one.grey[::2, ::2])


def without_texture(one: DecodedCamera) -> DecodedCamera:
    return replace(one, grey=np.full_like(one.grey, 90))


TWO, BEAM = pair(WIDTH_PX, SIZE), with_projector(WIDTH_PX, SIZE)
R, T, K = TWO.R, TWO.T, np.diag([0.5, 0.5, 1.0])


@pytest.mark.parametrize(
    ("axes", "change"), [("x", {}), ("x", {"R": turned(TWO, 1, 0.3)}), ("xy", {}), ("xy", {"change": thin})]
)
def test_right_cameras_fit_and_what_nothing_sees_is_said(axes: str, change: Mapping[str, Any]) -> None:
    """Thinned images are told with the lens of the whole ones; a small turn about the columns is seen by nothing."""
    said = told(axes, TWO, **change)
    assert outcomes(said, Outcome.FITS) == {POSE, LEFT, IMAGES_SIZE}
    assert {TURN, "cameras.unit"} <= outcomes(said, Outcome.UNCHECKED)


BOTH_SIGNS = {"x.sign": -1, "y.sign": -1}


@pytest.mark.parametrize(
    ("axes", "bench", "wrong", "about", "text", "instead"),
    [
        ("x", TWO, {"exchanged": True}, LEFT, "if left and right are exchanged", {}),
        ("xy", TWO, {"R": R.T, "T": -R.T @ T}, POSE, "if they are R and T of right to left", {}),
        ("x", TWO, {"R": R.T}, POSE, "if R is transposed", {}),
        ("xy", TWO, {"T": -T}, POSE, "if T is negated", {}),
        ("x", TWO, {"R": R.T, "T": -T}, POSE, "if R is transposed and T negated", {}),
        ("xy", TWO, {"R": turned(TWO, 0, 1.0)}, POSE, "exchanging cameras, R or T is no better", {}),
        ("x", TWO, {"K1": K @ TWO.left.K, "K2": K @ TWO.right.K}, IMAGES_SIZE, "half the size, multiply the matrices by 2", {}),
        # Of several that do as well none is left out.
        ("x", TWO, {"R": R.T, "change": without_texture}, POSE, "if R is transposed or T is negated", {}),
        # Of two directions of a projector the other one moves across the disparity, by 3 px.
        ("xy", BEAM, {"R": turned(BEAM, 1, 0.3)}, TURN, "if it is 0.3° less", {}),
        ("xy", BEAM, {"R": turned(BEAM, 1, -0.3)}, TURN, "if it is 0.3° more", {}),
        # A pattern that runs backwards would light the surface from behind.
        ("x", BEAM, {"change": scaled(-1.0, SIZE[0] - 100.0)}, "x.sign", "", {"x.sign": -1}),
        ("xy", BEAM, {"change": on_its_head}, "x.sign", "", BOTH_SIGNS),
        # The third ray of two directions checks the pattern.
        ("xy", BEAM, {"change": scaled(2.0, 0.5)}, "x.period_px", "", {}),
        ("xy", BEAM, {"change": scaled(0.5, -0.25, "y")}, "y.period_px", "", {}),
        ("xy", BEAM, {"change": scaled(1.0, 80.0)}, "x.start_deg", "", {}),
        ("xy", BEAM, {"change": exchanged}, XY, "", {}),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_alone(
    axes: str, bench: Bench, wrong: Mapping[str, Any], about: str, text: str, instead: Mapping[str, int]
) -> None:
    said = told(axes, bench, **wrong)
    assert outcomes(said, Outcome.WRONG) == {about}
    assert text in said[about].text
    assert not instead or said[about].corrections == instead


def test_half_of_the_turn_that_is_tried_is_no_contradiction() -> None:
    assert told("xy", BEAM, R=turned(BEAM, 1, 0.15))[TURN].outcome is Outcome.UNCHECKED


def test_without_texture_one_direction_leaves_the_cameras_unchecked() -> None:
    smooth = told("x", TWO, change=without_texture)
    assert {POSE, LEFT} <= outcomes(smooth, Outcome.UNCHECKED)
    assert "too few to tell" in smooth[POSE].text


def test_one_direction_of_a_projector_checks_its_sign_alone_and_two_hardly_leave_anything() -> None:
    pattern = {"x.period_px", "x.start_deg", "projector.width_px", "projector.height_px"}
    said = told("x", BEAM)
    assert outcomes(said, Outcome.FITS) == {"x.sign", XY, IMAGES_SIZE}
    assert outcomes(said, Outcome.UNCHECKED) == {POSE, "cameras.unit", *pattern}
    assert "50 % of 640 px" in said["projector.width_px"].text
    said = told("xy", BEAM)
    assert outcomes(said, Outcome.WRONG) == set()
    assert outcomes(said, Outcome.UNCHECKED) <= {TURN, "cameras.unit"}


def test_nothing_sees_windows_and_water() -> None:
    """They are nearly a longer lens, from half a metre away."""
    wet = "[water]\nindex = 1.0\n[ports]\ndistance_mm = 4.0\nthickness_mm = 1.0\nglass_index = 1.5\n"
    said = told("x", TWO, more=wet)
    assert {"ports.distance_mm", "ports.thickness_mm", "water.index"} <= outcomes(said, Outcome.UNCHECKED)
