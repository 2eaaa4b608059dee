"""Image sets as other laboratories take them: other projected patterns before the simulated cameras, and other people's files.

Patterns are drawn here by their own formulas, from the literature and not from the product. ``CONVENTIONS`` has six that differ in
whatever a description can say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import encode_calibration
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueEye, TruePort, TrueRig, draw_truth
from hw_sim.water.medium import Water
from tests.support.rendered import exposed
from tests.support.truth import true_calibration

Image = NDArray[np.uint8]
WIDTH, HEIGHT = 1024, 768
EXPOSURE_S = 0.012
AIR_EXPOSURE_S = 0.009
LOW, HIGH = 8, 247


@dataclass(frozen=True)
class Pattern:
    """One projected image: its codes along one axis."""

    codes: NDArray[np.float64]
    axis: str

    def image(self) -> Image:
        codes = np.clip(np.rint(self.codes), 0, 255).astype(np.uint8)
        along = codes[None, :] if self.axis == "x" else codes[:, None]
        return np.ascontiguousarray(np.broadcast_to(along, (HEIGHT, WIDTH)))


def edge(axis: str) -> NDArray[np.float64]:
    """Distance of each pixel's centre from the pattern's edge."""
    return np.arange(WIDTH if axis == "x" else HEIGHT, dtype=np.float64) + 0.5


def sines(
    axis: str, period_px: float, steps: int, sign: int = 1, start_deg: float = 0.0, order: tuple[int, ...] | None = None
) -> Iterator[Pattern]:
    phase = 2 * np.pi * edge(axis) / period_px + np.deg2rad(start_deg)
    for k in order or range(steps):
        light = np.cos(phase + sign * 2 * np.pi * k / steps)
        yield Pattern(0.5 * (LOW + HIGH) + 0.5 * (HIGH - LOW) * light, axis)


def stripes(axis: str, stripe_px: float, bits: int, offset_px: float = 0.0, inverse: bool = False) -> Iterator[Pattern]:
    """Gray code, coarsest first; with ``inverse`` each image is followed by its inverse."""
    number = np.floor((edge(axis) - offset_px) / stripe_px).astype(int)
    code = number ^ (number >> 1)
    for bit in reversed(range(bits)):
        lit = (code >> bit) & 1
        yield Pattern(np.where(lit == 1, HIGH, 0).astype(float), axis)
        if inverse:
            yield Pattern(np.where(lit == 1, 0, HIGH).astype(float), axis)


def even(code: int) -> Pattern:
    return Pattern(np.full(WIDTH, float(code)), "x")


@dataclass(frozen=True)
class Convention:
    """A laboratory's way."""

    name: str
    patterns: Callable[[], list[Pattern]]
    text: str
    """The description, but for cameras, water and ports."""
    water: bool = False
    save: str = "grey8"
    """``grey8``, ``grey16`` or ``colour`` (the pattern's light in the green channel)."""
    names: str = "{side}/{k:03d}.png"
    one_direction: bool = True
    coarse: bool = False
    """Stripes alone: coordinates to a fraction of a stripe."""


def _three_steps() -> list[Pattern]:
    return [even(HIGH), even(0), *stripes("x", 32, 5), *sines("x", 32, 3)]


def _eight_steps() -> list[Pattern]:
    return [*sines("x", 32, 8, -1, 180.0), even(HIGH), even(0), *stripes("x", 16, 6)]


def _inverses() -> list[Pattern]:
    return [*stripes("x", 4, 8, 0.0, True), *stripes("y", 4, 8, 0.0, True)]


def _half_off() -> list[Pattern]:
    return [*sines("x", 64, 4), *stripes("x", 64, 5, -32.0)]


def _periods() -> list[Pattern]:
    return [*sines("x", 1024 / 49, 5), *sines("x", 1024 / 48, 5), *sines("x", 1024 / 42, 5)]


def _two_directions() -> list[Pattern]:
    found = [even(0), even(HIGH)]
    for axis in "xy":
        found += [*sines(axis, 32, 4, 1, 0.0, (0, 2, 1, 3)), *stripes(axis, 16, 6)]
    return found


CONVENTIONS = (
    Convention(
        "three-steps", _three_steps,
        'order = "bright dark gray-x*5 sine-x*3"', names="{k:02d}_{side}.png",
    ),
    Convention(
        "eight-steps", _eight_steps, 'order = "sine-x*8 bright dark gray-x*6"', save="grey8", names="cam{n}_{k}.bmp",
    ),
    Convention("inverses", _inverses, 'order = "(gray-x ~gray-x)*8 (gray-y ~gray-y)*8"', one_direction=False, coarse=True),
    Convention("half-off", _half_off, 'order = "sine-x*4 gray-x*5"', save="grey16", names="{side}_{k:02d}.tif"),
    Convention(
        "periods", _periods, 'order = "sine-x*5 sine-x2*5 sine-x3*5"\nchannel = "green"', save="colour", names="{k:02d}{side}.png",
    ),
    Convention(
        "two-directions", _two_directions, 'order = "dark bright sine-x*4 gray-x*6 sine-y*4 gray-y*6"',
        water=True, one_direction=False,
    ),
)  # fmt: skip
AXES = {
    "three-steps": "[x]\nperiod_px = 32\nsteps = 3\n",
    "eight-steps": '[x]\nperiod_px = 32\nsteps = 8\nsign = "-"\nstart_deg = 180\ngray = "complementary"\n',
    "inverses": "[x]\nstripe_px = 4\n[y]\nstripe_px = 4\n",
    "half-off": "[x]\nperiod_px = 64\nsteps = 4\ncode_offset_px = -32\n",
    "periods": "[x]\nfringes = [49, 48, 42]\nsteps = 5\n",
    "two-directions": '[x]\nperiod_px = 32\nsteps_deg = [0, 180, 90, 270]\ngray = "complementary"\n'
    '[y]\nperiod_px = 32\nsteps_deg = [0, 180, 90, 270]\ngray = "complementary"\n',
}


def convention(name: str) -> Convention:
    return next(one for one in CONVENTIONS if one.name == name)


@dataclass(frozen=True)
class ForeignSet:
    """A folder with a set and its description, and the world it was taken in."""

    description: Path
    renderer: Renderer

    def text(self) -> str:
        return self.description.read_text(encoding="utf-8")

    def described(self, *changes: tuple[str, str]) -> Path:
        """Another description of the same images, with some words exchanged."""
        text = self.text()
        for before, after in changes:
            assert before in text, before
            text = text.replace(before, after)
        path = self.description.with_name("other.toml")
        path.write_text(text, encoding="utf-8")
        return path


def true_rig(convention: Convention, width_px: int, height_px: int, scene: Scene) -> TrueRig:
    """In air: the same two cameras without windows, which OpenCV's model describes exactly."""
    if convention.water:
        return draw_truth("modelled", 7, width_px, height_px, scene.water.index)
    truth = draw_truth("modelled", 7, width_px, height_px, 1.0)

    def bare(eye: TrueEye) -> TrueEye:
        return replace(eye, port=TruePort((0.0, 0.0, 1.0), 1.0, 1e-6, 1.0))

    return replace(truth, left=bare(truth.left), right=bare(truth.right), projector=bare(truth.projector))


def make_set(
    convention: Convention,
    folder: Path,
    width_px: int = 400,
    object_name: str = "pipe",
    seed: int = 3,
    described: str | None = None,
) -> ForeignSet:
    """Render a convention's images of a simulated scene into ``folder``, and write their description, or what is ``described``."""
    water = Water() if convention.water else Water(attenuation_per_m=0.0, backscatter=0.0, blur_px_per_m=0.0)
    scene = Scene(object=object_name, water=water)
    height_px = width_px * 3 // 4
    truth = true_rig(convention, width_px, height_px, scene)
    renderer = Renderer(truth, scene)
    exposure_s = EXPOSURE_S if convention.water else AIR_EXPOSURE_S
    frames = exposed(renderer, [pattern.image() for pattern in convention.patterns()], exposure_s, seed=seed)
    for side, images in frames.items():
        for k, image in enumerate(images):
            name = convention.names.format(side=side, k=k, n=0 if side == "left" else 1)
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), saved(image, convention.save))
    write_cameras(truth, folder, convention.water)
    sides = {
        side: convention.names.format(side=side, k=123456789, n=n).replace("123456789", "*")
        for n, side in enumerate(frames)
    }
    cameras = 'calibration = "calibration.json"' if convention.water else 'files = ["stereo.yml"]'
    named = f'left = "{sides["left"]}"\nright = "{sides["right"]}"\n{convention.text}\n'
    description = folder / f"{convention.name}.toml"
    if described is not None:
        description.write_text(described, encoding="utf-8")
        return ForeignSet(description, renderer)
    description.write_text(
        f"[images]\n{named}[projector]\nwidth_px = {WIDTH}\nheight_px = {HEIGHT}\n{AXES[convention.name]}[cameras]\n{cameras}\n",
        encoding="utf-8",
    )
    return ForeignSet(description, renderer)


def saved(image: Image, save: str) -> NDArray[np.uint8] | NDArray[np.uint16]:
    match save:
        case "grey16":
            return image.astype(np.uint16) * np.uint16(16) + np.uint16(7)
        case "colour":
            return np.stack([image // 5, image, image // 3], -1)
        case _:
            return image


def write_cameras(truth: TrueRig, folder: Path, water: bool) -> None:
    """The true cameras: in water as a calibration of ours, in air as OpenCV writes them."""
    calibration = true_calibration(truth)
    if water:
        (folder / "calibration.json").write_bytes(encode_calibration(calibration))
        return
    left, right = calibration.rig.left, calibration.rig.right
    storage = cv2.FileStorage(str(folder / "stereo.yml"), cv2.FILE_STORAGE_WRITE)
    for n, eye in ((1, left), (2, right)):
        (fu, fv), (cu, cv) = eye.lens.f_px, eye.lens.c_px
        storage.write(f"M{n}", np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]]))
        storage.write(f"D{n}", np.array([eye.lens.distortion]))
    R = np.array(right.rotation).T
    storage.write("R", R)
    storage.write("T", -R @ np.array(right.translation_mm)[:, None])
    storage.release()
