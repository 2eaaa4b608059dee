"""Image sets of other laboratories by one command: points, distance from their own clouds or a plane, and sigma against
it."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import cv2
import numpy as np
import scipy.io
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bench.result import Measurement
from tests.support.imported import kingfisher

Array = NDArray[np.float64]

NORMAL_MEDIAN = 0.6745
NEAR_MM = 1.0
"""From a plane, for a point to be counted as on it."""
PICTURE_HEIGHT_PX = 480


@dataclass(frozen=True)
class Set:
    """Pictures with their cameras' files, below ``KINGFISHER_REAL_PICTURES``."""

    name: str
    pictures: tuple[str, ...]
    """Folders; of several, each names its pictures."""
    cameras: tuple[str, ...]
    against: str
    """Reference: ``peer`` is the peer's cloud, ``codes`` the same object by another code (``second_set``), ``board`` a
    plane."""
    second_set: str = ""
    picture: str | None = None
    description: str | None = None
    """Hand-written description; ``None`` if the one command needs none."""


SLSTUDIO = "slstudio/calibration/calibration.xml"
AXIS = '[{0}]\nfringes = [16, 1]\nsteps = 3\nsign = "-"\n'
BOARD = (
    '[images]\nleft = "frameSeq_*.png"\norder = "sine-x*3 sine-x2*3 sine-y*3 sine-y2*3"\n[projector]\nwidth_px = 1824\nheight_px = 1140\n'
    + AXIS.format("x") + AXIS.format("y") + '[cameras]\nfiles = ["calibration.xml"]\n'
)  # fmt: skip
BLENDER = ("rendered/camera_calibration.json", "rendered/projector_calibration.json")
SETS = (
    Set("skull, Gray code", ("slstudio/skull_gray",), (SLSTUDIO,), "peer", picture="real-skull.png"),
    Set("skull, 16 and 1 fringes x 3", ("slstudio/skull_2x3",), (SLSTUDIO,), "peer", "skull, Gray code"),
    Set("skull, 1 fringe x 3", ("slstudio/skull_3ps",), (SLSTUDIO,), "peer", "skull, Gray code"),
    Set("skull, micro phase shifting", ("slstudio/skull_microps",), (SLSTUDIO,), "peer", "skull, Gray code"),
    Set("skull, modulated phase shifting", ("slstudio/skull_modulatedps",), (SLSTUDIO,), "peer", "skull, Gray code"),
    Set("board, first pose", ("slstudio/calibration/calseq1",), (SLSTUDIO,), "board", description=BOARD),
    Set("board, second pose", ("slstudio/calibration/calseq2",), (SLSTUDIO,), "board", description=BOARD),
    Set("face, two cameras", ("slmaster/binocular/L", "slmaster/binocular/R"), ("slmaster/binocular/caliInfo.yml",), "", picture="real-face.png"),
    Set("relief, camera and projector", ("slmaster/monocular",), ("slmaster/monocular/caliInfo.yml",), ""),
    Set("dragon of a renderer, Gray and 64 fringes", ("rendered/gray", "rendered/64"), BLENDER, ""),
    Set("dragon of a renderer, Gray, 16 and 64 fringes", ("rendered/gray", "rendered/16", "rendered/64"), BLENDER, ""),
    Set("dragon of a renderer, Gray and 16 fringes", ("rendered/gray", "rendered/16"), BLENDER, "codes", "dragon of a renderer, Gray, 16 and 64 fringes"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Grid:
    """A cloud on the left camera's pixels."""

    points_mm: Array
    """(h, w, 3)."""
    sigma_mm: Array
    mask: NDArray[np.bool_]


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="./dev bench real_light", description=__doc__)
    parser.add_argument(
        "--pictures", metavar="FOLDER", type=Path, help="draw the clouds that docs/foreign.md shows into it"
    )
    parser.add_argument("--only", metavar="TEXT", default="", help="sets whose name has it")
    chosen = parser.parse_args(arguments)
    for number in measure(chosen.pictures, chosen.only):
        print(number.line(), flush=True)
    return 0


def measure(pictures: Path | None = None, only: str = "") -> Iterator[Measurement]:
    """Yield the figures of every set below ``KINGFISHER_REAL_PICTURES``."""
    if "KINGFISHER_REAL_PICTURES" not in os.environ:
        yield Measurement("sets of others", float("nan"), "", why="KINGFISHER_REAL_PICTURES names no folder")
        return
    root = Path(os.environ["KINGFISHER_REAL_PICTURES"])
    clouds: dict[str, Grid] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for k, image_set in enumerate(SETS):
            if only.lower() in image_set.name.lower():
                yield from _measured(image_set, root, Path(temporary) / str(k), clouds, pictures)


def _measured(
    image_set: Set, root: Path, folder: Path, clouds: dict[str, Grid], pictures: Path | None
) -> Iterator[Measurement]:
    _linked(image_set, root, folder)
    begin_s = process_time()
    answer = kingfisher("import", folder, "--out", folder.with_suffix(".npz"))
    described = "no word"
    if answer.code:
        yield Measurement(f"{image_set.name}: asked", float("nan"), "", why=" ".join(answer.error.split())[:300])
        if image_set.description is None:
            return
        described, begin_s = "described by hand", process_time()
        (folder / "described.toml").write_text(image_set.description, encoding="utf-8")
        answer = kingfisher("import", folder / "described.toml", "--out", folder.with_suffix(".npz"))
        assert not answer.code, answer.error
    cpu_s = process_time() - begin_s
    with np.load(folder.with_suffix(".npz")) as file:
        points_mm = np.stack([np.asarray(file[f"{axis}_mm"], np.float64) for axis in "xyz"], -1)
        grid = clouds[image_set.name] = Grid(
            points_mm, np.asarray(file["sigma_mm"], np.float64), np.asarray(file["mask"], bool)
        )
    yield Measurement(f"{image_set.name}: points", float(grid.mask.sum()), f"in {cpu_s:.1f} s CPU, {described}")
    yield Measurement(f"{image_set.name}: depth", float(np.median(grid.points_mm[grid.mask][:, 2])), "mm")
    yield Measurement(f"{image_set.name}: sigma", float(np.median(grid.sigma_mm[grid.mask])), "mm")
    if image_set.against == "peer":
        peer = scipy.io.loadmat(str(root / "slstudio/skull_gray/pointCloud.mat"))["xyz"].reshape(-1, 3)
        peer = peer[np.isfinite(peer).all(1) & (peer[:, 2] > 0)]
        off_mm = cKDTree(grid.points_mm[grid.mask]).query(peer)[0]
        yield Measurement(f"{image_set.name}: from the peer's cloud", float(np.median(off_mm)), "mm")
    if image_set.against == "board":
        yield from _board(image_set, grid)
    if image_set.second_set in clouds:
        yield from _between(image_set, grid, clouds[image_set.second_set])
    for line in answer.unchecked:
        yield Measurement(f"    {line[:300]}", float("nan"), "", why="")
    if image_set.picture and pictures:
        picture = relief(grid)
        assert cv2.imwrite(str(pictures / image_set.picture), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _linked(image_set: Set, root: Path, folder: Path) -> None:
    folder.mkdir()
    for pictures in image_set.pictures:
        side = Path(pictures).name
        for path in (root / pictures).iterdir():
            if path.suffix == ".png":
                into = folder / side if side in "LR" else folder
                into.mkdir(exist_ok=True)
                (into / (path.name if len(image_set.pictures) == 1 else f"{side}_{path.name}")).symlink_to(path)
    for path in (root / name for name in image_set.cameras):
        (folder / path.name).symlink_to(path)


def _board(image_set: Set, grid: Grid) -> Iterator[Measurement]:
    """Yield the distance from the plane with most points (of 500 through three points each), fitted robustly."""
    points, sigma_mm = grid.points_mm[grid.mask], grid.sigma_mm[grid.mask]
    random = np.random.default_rng(0)
    some = points[random.permutation(len(points))[:20000]]
    is_near, most_points = np.zeros(len(points), bool), 0
    for _ in range(500):
        first, second, third = some[random.integers(0, len(some), 3)]
        normal = np.cross(second - first, third - first)
        normal /= np.linalg.norm(normal) + 1e-12
        if (count := int((np.abs((some - first) @ normal) < NEAR_MM).sum())) > most_points:
            is_near, most_points = np.abs((points - first) @ normal) < NEAR_MM, count
    for _ in range(6):
        middle = points[is_near].mean(0)
        off_mm = np.abs((points - middle) @ np.linalg.eigh(np.cov((points[is_near] - middle).T))[1][:, 0])
        is_near = off_mm < 4.0 * float(np.median(off_mm[is_near])) / NORMAL_MEDIAN
    rms_mm = float(np.sqrt(np.mean(off_mm[is_near] ** 2)))
    yield Measurement(
        f"{image_set.name}: from a plane", rms_mm, f"mm rms, {is_near.sum()} points, {100.0 * is_near.mean():.0f} %"
    )
    of_sigma = float(np.median(off_mm[is_near] / sigma_mm[is_near])) / NORMAL_MEDIAN
    yield Measurement(f"{image_set.name}: error over sigma", of_sigma, "")


def _between(image_set: Set, grid: Grid, second: Grid) -> Iterator[Measurement]:
    """Yield the difference of the same pixels by two codes, which lies along their rays, against both sigmas."""
    common = grid.mask & second.mask
    off_mm = np.linalg.norm(grid.points_mm[common] - second.points_mm[common], axis=-1)
    sigma_mm = np.hypot(grid.sigma_mm[common], second.sigma_mm[common])
    yield Measurement(
        f"{image_set.name}: from {image_set.second_set}", float(np.median(off_mm)), f"mm, {common.sum()} pixels"
    )
    yield Measurement(f"{image_set.name}: error over sigma", float(np.median(off_mm / sigma_mm)) / NORMAL_MEDIAN, "")


def relief(grid: Grid) -> NDArray[np.uint8]:
    """Return a picture of the surface as of plaster: brightness by slope, from the points alone."""
    # The thing itself, not specks of the room behind it.
    _, labels, parts, _ = cv2.connectedComponentsWithStats(
        cv2.dilate(grid.mask.astype(np.uint8), np.ones((5, 5), np.uint8))
    )
    thing = grid.mask & (labels == 1 + int(np.argmax(parts[1:, cv2.CC_STAT_AREA])))
    rows, columns = np.nonzero(thing)
    part = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    mask, points = thing[part], np.where(thing[part][..., None], grid.points_mm[part], 0.0)
    # Means over the points about each pixel, at the size of the picture.
    scale = PICTURE_HEIGHT_PX / mask.shape[0]
    wide = max(1.0, 0.7 / scale)
    weight = cv2.GaussianBlur(mask.astype(np.float64), (0, 0), wide)
    smooth = cv2.GaussianBlur(points, (0, 0), wide) / np.maximum(weight, 1e-6)[..., None]
    normal = np.cross(np.gradient(smooth, axis=1), np.gradient(smooth, axis=0))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    normal *= np.sign(normal[..., 2:]) * -1.0
    light = np.array([-0.5, -0.6, -0.62])
    grey = 30.0 + 215.0 * np.clip(normal @ light, 0.0, 1.0)
    small = cv2.resize(
        np.where(mask & (weight > 0.6), grey, 255.0), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    return np.rint(small).astype(np.uint8)
