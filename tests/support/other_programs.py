"""Sequences that other programs project, drawn by their own formulas before the scene of ``strangers``: ``PROGRAMS`` has twenty of them.

A seed draws what differs from laboratory to laboratory: texture of the thing, blur of the projector, a gamma, noise, and how the projector is
turned about its axis. Phases are those of the programs' sources and papers: of SLStudio (1 + cos(2πc/p − φ))/2 at column c, of the others a phase
of 0° at the pattern's edge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.support.strangers import (
    Bench,
    Image,
    along,
    flat,
    gray,
    lit,
    photographs,
    projected,
    save,
    sine,
    view,
    with_inverses,
    yaml,
)

Array = NDArray[np.float64]

LIT = 0.5
"""Share of a pixel's rays that must be lit for a point to be expected there."""
MICRO_PX = (70.0, 71.32, 72.47, 73.72, 76.23, 77.35, 78.4, 79.22, 80.0)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A laboratory, and what a camera of it adds."""

    bench: Bench
    two_cameras: bool
    seed: int
    texture: int
    blur_px: float
    gamma: float
    noise: float

    def seen(self, patterns: Sequence[Image]) -> list[list[Image]]:
        """The pictures of each camera."""
        shown = [self.shown(one) for one in patterns]
        cameras = (self.bench.left, self.bench.right)[: 1 + self.two_cameras]
        return [
            photographs(camera, self.bench.projector, shown, 10 * self.seed + n, noise=self.noise, texture=self.texture)
            for n, camera in enumerate(cameras)
        ]

    def shown(self, pattern: Image) -> Image:
        light = np.rint(255.0 * (np.arange(256) / 255.0) ** self.gamma).astype(np.uint8)
        return np.asarray(cv2.LUT(cv2.GaussianBlur(pattern, (0, 0), self.blur_px), light), np.uint8)

    @property
    def pixel_mm(self) -> float:
        """What a pixel of disparity is worth in depth at the wall: z² / (f b)."""
        other = self.bench.right if self.two_cameras else self.bench.projector
        return float(640.0**2 / (self.bench.left.K[0, 0] * np.linalg.norm(other.t_mm)))

    def in_sight(self) -> int:
        """Pixels of the left camera that the projector lights, and that lie in the other camera's picture."""
        bench, camera = self.bench, self.bench.left
        there = lit(camera, bench.projector, self.texture)
        inside = (there.column > 0) & (there.column < bench.projector.width_px - 1)
        inside &= (there.row > 0) & (there.row < bench.projector.height_px - 1)
        found = ((there.shade > 0) & inside).reshape(-1, camera.height_px, camera.width_px).mean(0) > LIT
        if self.two_cameras:
            other = projected(bench.right, there.points_mm.reshape(-1, 3)).reshape(*found.shape, 2)
            size = (bench.right.width_px - 1, bench.right.height_px - 1)
            found &= np.all((other > 0) & (other < size), axis=-1)
        return int(found.sum())


def draw_laboratory(width_px: int, projector_px: tuple[int, int], two_cameras: bool, linear: bool, seed: int) -> Drawn:
    random = np.random.default_rng(seed)
    height_px, f_px = width_px * 3 // 4, 1.35 * width_px
    turn = float(np.radians(random.uniform(1.0, 4.0) * random.choice([-1, 1])))
    left = view(width_px, height_px, f_px, (0.0, 0.0, 0.0), D=(-0.08, 0.03, 0.0005, -0.0004, 0.0))
    if two_cameras:
        right = view(
            width_px, height_px, 1.02 * f_px, (150.0, 3.0, 6.0), (0.01, 0.25, 0.01), D=(-0.06, 0.02, 0.0, 0.0, 0.0)
        )
        projector = view(*projector_px, 1.25 * projector_px[0], (70.0, -40.0, -10.0), (0.06, 0.12, turn))
    else:
        projector = view(
            *projector_px,
            1.45 * projector_px[0],
            (160.0, 30.0, 0.0),
            (0.05, 0.26, turn),
            D=(0.01, -0.02, 0.0, 0.0, 0.0),
        )
        right = projector
    gamma = 1.0 if linear else float(random.uniform(1.0, 1.15))
    return Drawn(
        Bench(left, right, projector),
        two_cameras,
        seed,
        seed + 1,
        float(random.uniform(0.3, 0.8)),
        gamma,
        float(random.uniform(0.5, 1.0)),
    )


# ------------------------------------------------------------------------------------------------- files of cameras


def opencv(drawn: Drawn, folder: Path) -> None:
    bench = drawn.bench
    yaml(
        folder / "stereo.yml",
        M1=bench.left.K,
        D1=bench.left.D,
        M2=bench.right.K,
        D2=bench.right.D,
        R=bench.R,
        T=bench.T,
    )


def scan3d(drawn: Drawn, folder: Path) -> None:
    bench = drawn.bench
    yaml(
        folder / "calibration.yml", cam_K=bench.left.K, cam_kc=bench.left.D, proj_K=bench.right.K, proj_kc=bench.right.D, R=bench.R,
        T=bench.T, cam_error=0.2, proj_error=0.3, stereo_error=0.3,
    )  # fmt: skip


def slstudio(drawn: Drawn, folder: Path) -> None:
    bench, (camera, projector) = drawn.bench, (drawn.bench.left, drawn.bench.projector)
    yaml(
        folder / "calibration.xml", Kc=camera.K, kc=camera.D, Kp=projector.K, kp=projector.D, Rp=bench.R, Tp=bench.T, cam_error=0.2,
        proj_error=0.3, stereo_error=0.3, frameWidth=camera.width_px, frameHeight=camera.height_px, screenResX=projector.width_px,
        screenResY=projector.height_px,
    )  # fmt: skip


def slmaster(drawn: Drawn, folder: Path) -> None:
    bench, size = drawn.bench, np.array([[drawn.bench.left.width_px], [drawn.bench.left.height_px]], np.float64)
    other = {"M2": bench.right.K, "D2": bench.right.D, "Rlr": bench.R, "Tlr": bench.T}
    if not drawn.two_cameras:
        other = {"M4": bench.right.K, "D4": bench.right.D, "Rlp": bench.R, "Tlp": bench.T}
    yaml(folder / "caliInfo.yml", M1=bench.left.K, D1=bench.left.D, S=size, **other)


# ------------------------------------------------------------------------------------------------- files of pictures


def by_number(folder: Path, seen: Sequence[Sequence[NDArray[Any]]], names: Sequence[str], begin: int = 0) -> None:
    for images, name in zip(seen, names, strict=False):
        for k, image in enumerate(images):
            save(folder / name.format(k=k + begin), image)


def left_right(folder: Path, seen: Sequence[Sequence[Image]]) -> None:
    by_number(folder, seen, ("left/{k:02d}.png", "right/{k:02d}.png"))


def one_folder(folder: Path, seen: Sequence[Sequence[Image]]) -> None:
    by_number(folder, seen, ("frameSeq_{k:02d}.png",))


def sides_l_r(folder: Path, seen: Sequence[Sequence[Image]]) -> None:
    by_number(folder, seen, ("L/{k}.png", "R/{k}.png"))


def side_by_side(folder: Path, seen: Sequence[Sequence[Image]]) -> None:
    """Both cameras in one picture."""
    by_number(folder, [[np.hstack(pair) for pair in zip(*seen, strict=True)]], ("{k:03d}.png",))


def sixteen_bits(folder: Path, seen: Sequence[Sequence[Image]]) -> None:
    by_number(
        folder,
        [[one.astype(np.uint16) * np.uint16(257) for one in images] for images in seen],
        ("cam0_{k:02d}.tif", "cam1_{k:02d}.tif"),
    )


def fringes_in_colours(folder: Path, seen: Sequence[Sequence[Image]]) -> None:
    """The first three pictures are the red, green and blue of one; the others are grey."""
    merged = [[np.dstack(images[2::-1]), *(np.dstack([one] * 3) for one in images[3:])] for images in seen]
    by_number(folder, merged, ("left_{k}.png", "right_{k}.png"))


# ------------------------------------------------------------------------------------------------------- sequences

Size = tuple[int, int]
Patterns = Callable[[Size], list[Image]]
FOUR = (0.0, 90.0, 180.0, 270.0)


def references(size: Size) -> list[Image]:
    return [flat(250, size), flat(0, size)]


def pairs(columns: int, rows: int, stripe_px: float = 1.0, offset: Size = (0, 0)) -> Patterns:
    return lambda size: [
        *with_inverses(gray("x", size, columns, stripe_px, -offset[0])), *with_inverses(gray("y", size, rows, stripe_px, -offset[1])),
    ]  # fmt: skip


def shifted(size: Size, period_px: float, shifts_deg: Sequence[float], axis: str = "x") -> list[Image]:
    """SLStudio's fringes: (1 + cos(2πc/p − φ))/2 at column c."""
    phase = 2 * np.pi * np.arange(size["xy".index(axis)], dtype=np.float64) / period_px
    return [along(125.0 + 125.0 * np.cos(phase - np.deg2rad(one)), axis, size) for one in shifts_deg]


THIRDS = (0.0, 120.0, 240.0)


def micro(size: Size) -> list[Image]:
    first = shifted(size, 75.02, (0.0, -120.0, -240.0))
    return first + [shifted(size, one, (180.0 * (k % 2 == 0),))[0] for k, one in enumerate(MICRO_PX)]


def modulated(size: Size) -> list[Image]:
    columns, rows = (
        [one / 250.0 for one in shifted(size, size["xy".index(axis)] / periods, THIRDS, axis)]
        for axis, periods in (("x", 24), ("y", 16))
    )
    products = [np.rint(250.0 * column * row).astype(np.uint8) for column in columns for row in rows]
    return products + shifted(size, size[0], THIRDS)


def of_periods(*fringes: int, steps: int = 4) -> Patterns:
    return lambda size: [
        one for n in fringes for one in sine("x", size, size[0] / n, [360.0 * k / steps for k in range(steps)])
    ]


def binary(size: Size, bits: int, stripe_px: float) -> list[Image]:
    number = ((np.arange(size[0]) + 0.5) // stripe_px).astype(int)
    return [along(np.where((number >> bit) & 1, 250.0, 0.0), "x", size) for bit in reversed(range(bits))]


def stepped(*parts: Patterns) -> Patterns:
    return lambda size: [one for part in parts for one in part(size)]


def steps(period_px: float, count: int) -> Patterns:
    return lambda size: sine("x", size, period_px, [360.0 * k / count for k in range(count)])


def code(bits: int, stripe_px: float, offset_px: float = 0.0) -> Patterns:
    return lambda size: gray("x", size, bits, stripe_px, offset_px)


def fine_first(size: Size) -> list[Image]:
    return [*references(size), *gray("x", size, 7, 8.0)[::-1], *sine("x", size, 8.0, FOUR)]


def rows_first(size: Size) -> list[Image]:
    return [*references(size), *with_inverses(gray("y", size, 8, 4.0)), *with_inverses(gray("x", size, 8, 4.0))]


def inverses_as_a_block(size: Size) -> list[Image]:
    codes = [*gray("x", size, 9, 2.0), *gray("y", size, 9, 2.0)]
    return [*codes, *((250 - one).astype(np.uint8) for one in codes)]


@dataclass(frozen=True)
class Program:
    """A program's sequence, the files it comes in, and whose they are."""

    name: str
    projector_px: Size
    patterns: Patterns
    cameras: Callable[[Drawn, Path], None]
    pictures: Callable[[Path, Sequence[Sequence[Image]]], None]
    two_cameras: bool = True
    linear: bool = False
    words: str = ""
    """The description by hand, without cameras and names of files."""

    def make(self, folder: Path, seed: int, width_px: int = 400) -> Drawn:
        """Draw it into ``folder``."""
        drawn = draw_laboratory(width_px, self.projector_px, self.two_cameras, self.linear, seed)
        folder.mkdir(parents=True, exist_ok=True)
        self.pictures(folder, drawn.seen(self.patterns(self.projector_px)))
        self.cameras(drawn, folder)
        return drawn


def one_camera(folder: Path, seen: Sequence[Sequence[Image]]) -> None:
    by_number(folder, seen, ("cam_{k:02d}.png",), 1)


XGA, SLS = (1024, 768), (1824, 1140)
PROGRAMS = (
    Program("OpenCV GrayCodePattern", XGA, stepped(pairs(10, 10), references), opencv,
            lambda folder, seen: by_number(folder, seen, ("pattern_cam1_im{k}.png", "pattern_cam2_im{k}.png"), 1)),
    Program("scan3d-capture", XGA, stepped(references, pairs(10, 10, 1.0, (0, 128))), scan3d, one_camera, two_cameras=False),
    Program("SLStudio gray", SLS, stepped(references, lambda size: gray("x", size, 11)[:10]), slstudio, one_folder, False, True),
    Program("SLStudio 2x3", SLS, lambda size: [*shifted(size, size[0] / 16, THIRDS), *shifted(size, size[0], THIRDS)], slstudio,
            one_folder, False, True),
    Program("SLStudio 3ps", SLS, lambda size: shifted(size, size[0], THIRDS), slstudio, one_folder, False, True),
    Program("SLStudio micro", SLS, micro, slstudio, one_folder, False, True),
    Program("SLStudio modulated", SLS, modulated, slstudio, one_folder, False, True),
    Program("3DUNDERWORLD", XGA, stepped(references, pairs(10, 10)), opencv,
            lambda folder, seen: by_number(folder, seen, ("cam_0/{k:04d}.jpg", "cam_1/{k:04d}.jpg"), 1)),
    Program("SLMaster 12 steps, 7 bits", (1280, 720), stepped(steps(16.0, 12), code(7, 8.0)), slmaster, sides_l_r),
    Program("SLMaster 4 steps, shifted code", (1280, 720), stepped(steps(40.0, 4), code(6, 40.0, -20.0)), slmaster, sides_l_r),
    Program("heterodyne triples", (912, 1140), of_periods(70, 64, 59), opencv, left_right),
    Program("three frequencies x 4", (1280, 800), of_periods(1, 8, 64), slstudio, one_camera, two_cameras=False),
    Program("inverses as a block", XGA, inverses_as_a_block, opencv, left_right),
    Program("fine bits first", XGA, fine_first, opencv, left_right),
    Program("rows before columns", XGA, rows_first, scan3d, one_camera, two_cameras=False),
    Program("plain binary", XGA, stepped(references, lambda size: binary(size, 6, 16.0), steps(16.0, 4)), opencv, left_right),
    Program("both cameras in one picture", XGA, stepped(references, code(6, 16.0), steps(16.0, 4)), opencv, side_by_side),
    Program("fringes in red, green, blue", XGA, stepped(steps(16.0, 3), code(6, 16.0), references), opencv, fringes_in_colours),
    Program("16 bit TIFF, references last", XGA, stepped(code(6, 16.0), steps(16.0, 4), references), opencv, sixteen_bits),
    Program("8 steps, no references", (1280, 800), stepped(steps(20.0, 8), code(6, 20.0)), slmaster, one_camera, two_cameras=False),
)  # fmt: skip
