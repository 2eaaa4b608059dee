"""Sets as strangers have them on their disks, in files that nobody here named: a guess is enough, and its points lie on the surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from appliance.foreign.guess import guess_description
from appliance.offline.foreign_import import import_cloud
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
    notes: str = ""


def taken(bench: Bench, folder: Path, patterns: Sequence[Image], names: Sequence[str]) -> None:
    """Save what each camera sees; ``names`` are of the left and the right one, with the number {k}."""
    for n, name in enumerate(names):
        camera = bench.left if n == 0 else bench.right
        for k, image in enumerate(photographs(camera, bench.projector, patterns, n)):
            save(folder / name.format(k=k), image)


def stripes_of_one_pixel(folder: Path) -> None:
    """Two cameras, every image with its inverse, in both directions, down to stripes of a pixel of the projector."""
    bench = pair(WIDTH_PX, SIZE)
    patterns = [*with_inverses(gray("x", SIZE, 10)), *with_inverses(gray("y", SIZE, 9)), flat(250, SIZE), flat(0, SIZE)]
    taken(bench, folder, patterns, ("pattern_cam1_im{k}.png", "pattern_cam2_im{k}.png"))
    yaml(
        folder / "calib_stereo.yml", cam1_intrinsics=bench.left.K, cam1_distorsion=bench.left.D, cam2_intrinsics=bench.right.K,
        cam2_distorsion=bench.right.D, R=bench.R, T=bench.T,
    )  # fmt: skip


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


def three_frequencies(folder: Path) -> None:
    """Eight steps of three periods without any code, saved as colour pictures in one folder."""
    bench = pair(WIDTH_PX, SIZE)
    patterns = [one for fringes in (36, 31, 28) for one in sine("x", SIZE, 640 / fringes, [45.0 * k for k in range(8)])]
    for n, (side, camera) in enumerate(zip("LR", (bench.left, bench.right), strict=True)):
        for k, image in enumerate(photographs(camera, bench.projector, patterns, n)):
            save(folder / f"{k:03d}_{side}.png", np.stack([image] * 3, -1))
    np.savez(
        folder / "stereo.npz", mtxL=bench.left.K, distL=bench.left.D, mtxR=bench.right.K, distR=bench.right.D, R=bench.R, T=bench.T,
    )  # fmt: skip


def projection_matrices(folder: Path) -> None:
    """Fringes of 1, 8 and 64 periods for camera and projector, both of which are given as matrices of 3 x 4, in metres."""
    bench = without_distortion(with_projector(WIDTH_PX, SIZE))
    patterns = [one for fringes in (1, 8, 64) for one in sine("x", SIZE, 640 / fringes, (0.0, 90.0, 180.0, 270.0))]
    taken(bench, folder, patterns, ("{k}.bmp",))
    left, right = (one.K @ np.column_stack([one.R, 0.001 * one.t_mm]) for one in (bench.left, bench.right))
    np.savez(folder / "calib.npz", P_cam=left, P_proj=right)


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


CASES = (
    Case(stripes_of_one_pixel, ('"(gray-x ~gray-x)*10 (gray-y ~gray-y)*9 bright dark"', 'left = "pattern_cam1_im*.png"'), 80.0, 0.1,
         "of 10 images of the code have stripes that the camera cannot tell apart, and are left out: stripes of 2 px are used"),
    Case(one_camera_and_a_projector, ("width_px = 640\nheight_px = 480", "code_offset_px = -192", "code_offset_px = -16"), 80.0, 0.06),
    Case(three_frequencies, ('"sine-x*8 sine-x2*8 sine-x3*8"', "period_px = [28.4444, 33.0323, 36.5714]"), 80.0, 0.08),
    Case(projection_matrices, ("period_px = [640, 80, 10]", 'unit = "m"'), 80.0, 0.08),
    Case(three_steps_of_a_part, ('"dark gray-x*6 sine-x*3 bright"', 'left = "cam0*.tif"'), 75.0, 0.08),
)  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.make.__name__)
def test_a_strangers_folder_needs_no_more_than_a_guess(tmp_path: Path, case: Case) -> None:
    folder = tmp_path / "set"
    case.make(folder)
    text = guess_description(folder, folder, lambda _: None)
    (folder / "description.toml").write_text(text)
    for one in case.said:
        assert one in text
    report = import_cloud(folder / "description.toml", tmp_path / "cloud.npz", lambda _: None)
    with np.load(tmp_path / "cloud.npz") as grid:
        there = grid["mask"]
        points_mm = np.stack([grid[f"{axis}_mm"][there] for axis in "xyz"], -1)
        sigma_mm = float(np.median(grid["sigma_mm"][there]))
    off_mm = float(np.median(distance_mm(points_mm)))
    assert 100.0 * there.mean() > case.at_least_percent
    assert off_mm < case.at_most_mm
    assert 0.5 < sigma_mm / off_mm < 6.0
    assert case.notes in " ".join(report["not_judged"])
