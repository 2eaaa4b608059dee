"""Sets as strangers have them on their disks, in files that nobody here named: a guess is enough, and its points lie on the surface."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.base import silent
from appliance.desk.foreign.folder import describe_guess
from appliance.desk.foreign.guess import guess_sequence
from appliance.desk.foreign.importing import import_described
from tests.support.imported import import_folder
from tests.support.other_programs import PROGRAMS
from tests.support.strangers import (
    Bench,
    Image,
    distance_mm,
    flat,
    gray,
    pair,
    photographs,
    save,
    sine,
    view,
    with_inverses,
    with_projector,
    without_distortion,
    yaml,
)

SIZE = (640, 480)
WIDTH_PX = 240


@dataclass(frozen=True)
class Case:
    """A set, what its guess must say, and how good its points must be."""

    make: Callable[[Path], None]
    said: tuple[str, ...]
    at_least_percent: float
    at_most_mm: float


def taken(bench: Bench, folder: Path, patterns: Sequence[Image], names: Sequence[str]) -> None:
    """Save what each camera sees; ``names`` are of the left and the right one, with the number {k}."""
    for n, name in enumerate(names):
        camera = bench.left if n == 0 else bench.right
        for k, image in enumerate(photographs(camera, bench.projector, patterns, n)):
            save(folder / name.format(k=k), image)


def one_camera_and_a_projector(folder: Path) -> None:
    """The projector's axis leaves below its picture; codes lie in the middle of 1024 and of 512 stripes."""
    bench = with_projector(WIDTH_PX, SIZE)
    rows, columns = gray("x", SIZE, 10, 1.0, -192.0), gray("y", SIZE, 9, 1.0, -16.0)
    patterns = [flat(250, SIZE), flat(0, SIZE), *with_inverses(rows), *with_inverses(columns)]
    taken(bench, folder, patterns, ("bust/cam_{k:02d}.png",))
    yaml(
        folder / "calibration.yml", cam_K=bench.left.K, cam_kc=bench.left.D, proj_K=bench.right.K, proj_kc=bench.right.D, R=bench.R,
        T=bench.T, stereo_error=0.3,
    )  # fmt: skip


def three_frequencies_by_turns(folder: Path) -> None:
    """Eight steps of three periods without any code, in colour: even numbers, without zeros before them, of the left camera."""
    bench = pair(WIDTH_PX, SIZE)
    patterns = [one for fringes in (36, 31, 28) for one in sine("x", SIZE, 640 / fringes, [45.0 * k for k in range(8)])]
    for n, images in enumerate(seen(bench, patterns)):
        for k, image in enumerate(images):
            save(folder / f"frame{2 * k + n}.png", np.stack([image] * 3, -1))
    np.savez(
        folder / "stereo.npz", mtxL=bench.left.K, distL=bench.left.D, mtxR=bench.right.K, distR=bench.right.D, R=bench.R, T=bench.T,
    )  # fmt: skip


def by_projection_matrices(folder: Path, patterns: Sequence[Image]) -> None:
    """Camera and projector are given as matrices of 3 x 4, in metres."""
    bench = without_distortion(with_projector(WIDTH_PX, SIZE))
    taken(bench, folder, patterns, ("{k}.bmp",))
    left, right = (one.K @ np.column_stack([one.R, 0.001 * one.t_mm]) for one in (bench.left, bench.right))
    np.savez(folder / "calib.npz", P_cam=left, P_proj=right)


def fringes_of_a_projector(folder: Path) -> None:
    by_projection_matrices(folder, [one for fringes in (1, 8, 64) for one in sine("x", SIZE, 640 / fringes, FOUR)])


def code_half_a_period_off(folder: Path) -> None:
    """Before the projector's width is known it is guessed for 1024 px."""
    by_projection_matrices(folder, [*BRIGHT_DARK, *gray("x", SIZE, 6, 10.0, -5.0), *sine("x", SIZE, 10.0, FOUR)])


def three_steps_of_a_part(folder: Path) -> None:
    """Three steps with a Gray code, kinds in the names, 12 bits in 16; of the left sensor a part, so that its axis is outside."""
    bench = pair(WIDTH_PX, SIZE)
    names = ["white", "black", *(f"gray_{k}" for k in range(6)), *(f"phase_{k}" for k in range(3))]
    patterns = [flat(250, SIZE), flat(0, SIZE), *gray("x", SIZE, 6, 10.0), *sine("x", SIZE, 10.0, (0.0, 120.0, 240.0))]
    cut_px = WIDTH_PX // 2 + 10
    for n, camera in enumerate((bench.left, bench.right)):
        for name, image in zip(names, photographs(camera, bench.projector, patterns, n), strict=True):
            save(folder / f"cam{n}_{name}.tif", image[:, cut_px * (n == 0) :].astype(np.uint16) * np.uint16(16))
    moved = bench.left.K - np.array([[0.0, 0.0, cut_px], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for side, K, D in (("left", moved, bench.left.D), ("right", bench.right.K, bench.right.D)):
        numbers = [", ".join(f"{one:.9g}" for one in np.ravel(values)) for values in (K, D)]
        (folder / f"{side}.yaml").write_text(
            f"camera_name: {side}\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [{numbers[0]}]\n"
            f"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [{numbers[1]}]\n"
        )
    rows = ", ".join(f"[{', '.join(f'{one:.9g}' for one in row)}]" for row in bench.R)
    (folder / "extrinsics.yaml").write_text(f"R: [{rows}]\nT: [{', '.join(f'{one:.9g}' for one in bench.T)}]\n")


BRIGHT_DARK = [flat(250, SIZE), flat(0, SIZE)]
FOUR = (0.0, 90.0, 180.0, 270.0)


def usual() -> list[Image]:
    """Bright, dark, a code of stripes a period wide, four steps."""
    return [*BRIGHT_DARK, *gray("x", SIZE, 5, 20.0), *sine("x", SIZE, 20.0, FOUR)]


def opencv(bench: Bench, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    yaml(
        folder / "stereo.yml", M1=bench.left.K, D1=bench.left.D, M2=bench.right.K, D2=bench.right.D, R=bench.R, T=bench.T
    )  # fmt: skip


def seen(bench: Bench, patterns: Sequence[Image]) -> list[list[Image]]:
    return [photographs(camera, bench.projector, patterns, n) for n, camera in enumerate((bench.left, bench.right))]


def pictures_of_a_laptops_projector(folder: Path) -> None:
    """8-bit JPEG in colour, darker towards the corners, gamma of the projector and of the camera."""
    bench = pair(WIDTH_PX, SIZE)
    shown = [np.clip(np.rint(255 * (one / 255.0) ** 2.2), 0, 255).astype(np.uint8) for one in usual()]
    for side, images in zip(("left", "right"), seen(bench, shown), strict=True):
        for k, image in enumerate(images):
            v, u = (np.mgrid[0 : image.shape[0], 0 : image.shape[1]].T / image.shape[::-1] - 0.5).T[:2]
            light = np.stack([0.8 * image, 0.97 * image, 0.9 * image], -1) * (1.0 - 0.7 * (u**2 + v**2))[..., None]
            save(folder / side / f"IMG_{k + 1:04d}.JPG", np.rint(255 * (light / 255) ** (1 / 2.2)).astype(np.uint8))
    opencv(bench, folder)


def two_stacks(folder: Path) -> None:
    """Pages of a TIFF, 12 bits at the upper end of 16; and an array in which, as in MATLAB's, the number of the image comes last."""
    bench = pair(WIDTH_PX, SIZE)
    opencv(bench, folder)
    left, right = seen(bench, usual())
    assert cv2.imwritemulti(str(folder / "left.tif"), [one.astype(np.uint16) * np.uint16(256) for one in left])
    np.savez_compressed(folder / "right.npz", frames=np.stack(right, -1), exposure=np.array([3.0]))


def cameras_above_each_other(folder: Path) -> None:
    """Stripes of rows alone, and pictures of a board beside them; no dark image but one at the end."""
    height_px, f_px = WIDTH_PX * 3 // 4, 1.35 * WIDTH_PX
    bench = Bench(
        view(WIDTH_PX, height_px, f_px, (0.0, 0.0, 0.0), D=(-0.08, 0.03, 0.0005, -0.0004, 0.0)),
        view(WIDTH_PX, height_px, 1.02 * f_px, (3.0, 150.0, 6.0), (-0.25, 0.01, 0.01)),
        view(*SIZE, 1.25 * SIZE[0], (-40.0, 70.0, -10.0), (-0.12, -0.06, 0.0)),
    )
    patterns = [*gray("y", SIZE, 5, 20.0), *sine("y", SIZE, 20.0, FOUR), flat(0, SIZE)]
    taken(bench, folder, patterns, ("scene/c0/{k}.png", "scene/c1/{k}.png"))
    taken(bench, folder, [flat(250, SIZE)] * 7, ("checkerboard/c0/{k}.png", "checkerboard/c1/{k}.png"))
    opencv(bench, folder / "checkerboard")


CASES = (
    Case(pictures_of_a_laptops_projector, ('channel = "green"', 'order = "bright dark gray-x*5 sine-x*4"'), 80.0, 0.25),
    Case(two_stacks, ('left = "left.tif"', 'right = "right.npz#frames"', 'order = "bright dark gray-x*5 sine-x*4"'), 80.0, 0.12),
    Case(cameras_above_each_other, ('order = "gray-y*5 sine-y*4 dark"', 'left = "scene/c0/*.png"'), 80.0, 0.12),
    Case(one_camera_and_a_projector, ("width_px = 640\nheight_px = 480", "code_offset_px = -192", "code_offset_px = -16"), 80.0, 0.06),
    Case(three_frequencies_by_turns, ('both = "*.png"', 'sides = "left right"', '"sine-x*8 sine-x2*8 sine-x3*8"', "period_px = [28.444444, 33.032258, 36.571429]"), 80.0, 0.08),
    Case(code_half_a_period_off, ("period_px = 10", "code_offset_px = -5"), 80.0, 0.08),
    Case(fringes_of_a_projector, ("period_px = [640, 80, 10]", 'unit = "m"'), 80.0, 0.08),
    Case(three_steps_of_a_part, ('"dark gray-x*6 sine-x*3 bright"', 'left = "cam0*.tif"'), 75.0, 0.08),
)  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.make.__name__)
def test_a_strangers_folder_needs_no_more_than_a_guess(tmp_path: Path, case: Case) -> None:
    folder = tmp_path / "set"
    case.make(folder)
    candidates = guess_sequence(folder, silent)
    assert len(candidates) == 1, [one.program for one in candidates]
    text = describe_guess(candidates[0], folder)
    (folder / "description.toml").write_text(text)
    said = re.sub(r" +# .*", "", text)
    for one in case.said:
        assert one in said
    import_described(folder / "description.toml", tmp_path / "cloud.npz", silent)
    with np.load(tmp_path / "cloud.npz") as grid:
        there = grid["mask"]
        points_mm = np.stack([grid[f"{axis}_mm"][there] for axis in "xyz"], -1)
        sigma_mm = float(np.median(grid["sigma_mm"][there]))
    off_mm = float(np.median(distance_mm(points_mm)))
    assert 100.0 * there.mean() > case.at_least_percent
    assert off_mm < case.at_most_mm
    assert 0.5 < sigma_mm / off_mm < 6.0


def test_another_programs_folder_becomes_a_whole_cloud_by_one_command(tmp_path: Path) -> None:
    """The bench ``import_sequences`` has twenty of them."""
    (program,) = (one for one in PROGRAMS if one.name == "SLStudio 2x3")
    drawn = program.make(tmp_path / "set", 3, WIDTH_PX)
    found = import_folder(tmp_path / "set", tmp_path / "cloud.npz", drawn)
    assert found.outcome == "whole", found
