"""Pictures at the top of the README: a dive on the simulated instrument, and its cloud.

    python -m bench.pictures        writes docs/pictures/scan.gif and scan.png

The screens are those of a real run of ``kingfisher sim``, taken from the simulated display; the cloud is the saved one, turned
about its middle. Nothing is drawn by hand but the captions.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.store.library import Library

OUT = Path(__file__).parents[1] / "docs" / "pictures"
SIZE_PX = (800, 480)
CAPTION_PX = 44
SCRIPT = """
wait state AIM 120
pause 1.5
screenshot {folder}/aim.png
press scan
pause 0.25
screenshot {folder}/capture.png
wait state REVIEW 120
pause 3
screenshot {folder}/review.png
press scan
wait state AIM 120
end
"""
CAPTIONS = {
    "aim": "1  Aim: both cameras, the distance, and whether a scan can succeed",
    "capture": "2  One key. Hold still for 0.4 s while 24 patterns are projected",
    "review": "3  Review: the cloud and a verdict, a moment later and under water",
}
CLOUD_CAPTION = "4  What was saved: {points:,} points, each with its expected error"
SHOWN_MS, TURN_MS = 2600, 180
TURN_DEG = (0, 9, 18, 26, 18, 9, 0, -9, -18, -26, -18, -9)
INK, GROUND = (235, 235, 235), (26, 22, 18)
MIDDLE_SHARE = 0.5
GIF_SCALE = 0.8
Image = NDArray[np.uint8]


def main() -> int:
    """Run the dive, and write both pictures; return 0 if they were written."""
    parser = argparse.ArgumentParser(prog="python -m bench.pictures", description=__doc__.partition("\n")[0])
    parser.add_argument("--object", default="pipe")
    parser.add_argument("--size", default="1600x1200")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kingfisher-pictures-") as folder:
        screens, points = dive(Path(folder), options.object, options.size)
    frames = [captioned(screen, CAPTIONS[name]) for name, screen in screens.items()]
    last = CLOUD_CAPTION.format(points=len(points))
    turned = [captioned(view(points, degrees), last) for degrees in TURN_DEG]
    write_gif(options.out / "scan.gif", [*frames, *turned], [SHOWN_MS] * len(frames) + [TURN_MS] * len(turned))
    strip = [captioned(screens[name], CAPTIONS[name]) for name in ("aim", "review")] + [turned[4]]
    cv2.imwrite(str(options.out / "scan.png"), np.hstack([cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for picture in strip]))  # fmt: skip
    return 0


def dive(folder: Path, scanned: str, size: str) -> tuple[dict[str, Image], NDArray[np.float32]]:
    """Return the screens of a scan by name (h, w, 3) BGR, and the saved points (n, 3) in mm."""
    script = folder / "dive.script"
    script.write_text(SCRIPT.format(folder=folder), encoding="utf-8")
    root = folder / "root"
    command = [sys.executable, "-m", "appliance.cli", "sim", "truth=nominal", f"object={scanned}", f"size={size}"]
    subprocess.run([*command, "--script", str(script), "--root", str(root)], check=True)
    library = Library(root)
    last = library.last_id()
    assert last is not None, "the dive left no scan"
    cloud = library.load(last).cloud()
    assert cloud is not None
    screens = {name: np.asarray(cv2.imread(str(folder / f"{name}.png")), np.uint8) for name in CAPTIONS}
    return screens, np.asarray(cloud.points_mm, np.float32)


def view(points_mm: NDArray[np.float32], turned_deg: float) -> Image:
    """Return a picture (h, w, 3) BGR of the points, turned about the vertical through their middle.

    It is seen from the camera's side and from 20° above, coloured as in REVIEW by the distance from the instrument, and
    lit from the upper left by the slope of the depth image.
    """
    width, height = SIZE_PX
    middle_mm = np.median(points_mm, 0)
    a, b = np.radians(turned_deg), np.radians(-20.0)
    about_y = np.array([[np.cos(a), 0.0, np.sin(a)], [0.0, 1.0, 0.0], [-np.sin(a), 0.0, np.cos(a)]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), -np.sin(b)], [0.0, np.sin(b), np.cos(b)]])
    x, y, z = ((points_mm - middle_mm) @ (about_x @ about_y).T).T
    span_mm = max(np.ptp(points_mm[:, 0]) / (0.9 * width), np.ptp(points_mm[:, 1]) / (0.8 * height))
    depth = np.full((height, width), np.inf, np.float32)
    own_distance_mm = np.zeros((height, width), np.float32)
    u, v = np.rint(x / span_mm + width / 2).astype(int), np.rint(y / span_mm + height / 2).astype(int)
    is_inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    order = np.flatnonzero(is_inside)[np.argsort(-z[is_inside], kind="stable")]  # the nearest one is written last
    depth[v[order], u[order]], own_distance_mm[v[order], u[order]] = z[order], points_mm[order, 2]
    has_depth = np.isfinite(depth)
    filled = cv2.GaussianBlur(np.where(has_depth, depth, 0.0).astype(np.float32), (0, 0), 1.2)
    weight = cv2.GaussianBlur(has_depth.astype(np.float32), (0, 0), 1.2)
    smooth = filled / np.maximum(weight, 1e-6)
    slope_x, slope_y = np.gradient(smooth, span_mm, axis=1), np.gradient(smooth, span_mm, axis=0)
    normal = np.stack([slope_x, slope_y, -np.ones_like(smooth)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.array([-0.45, -0.55, -0.70])
    shade = np.clip(normal @ (light / np.linalg.norm(light)), 0.08, 1.0)
    near, far = np.quantile(points_mm[:, 2], [0.01, 0.99])
    distance_mm = cv2.GaussianBlur(own_distance_mm, (0, 0), 1.2) / np.maximum(weight, 1e-6)
    level = np.clip(255.0 * (far - distance_mm) / max(far - near, 1e-6), 0, 255).astype(np.uint8)
    colour = cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS).astype(np.float32) * shade[..., None]
    is_covered = (weight > MIDDLE_SHARE)[..., None]
    return np.where(is_covered, colour, np.array(GROUND, np.float32)).astype(np.uint8)


def captioned(screen: Image, text: str) -> Image:
    """Return ``screen`` with a line of text below it."""
    below = np.full((CAPTION_PX, screen.shape[1], 3), GROUND, np.uint8)
    cv2.putText(below, text, (16, 29), cv2.FONT_HERSHEY_SIMPLEX, 0.62, INK, 1, cv2.LINE_AA)
    return np.ascontiguousarray(np.vstack([screen, below]))


def write_gif(path: Path, frames: list[Image], shown_ms: list[int]) -> None:
    """Write an endless animation with OpenCV's writer."""
    animation = cv2.Animation(0)
    size = round(GIF_SCALE * frames[0].shape[1]), round(GIF_SCALE * frames[0].shape[0])
    animation.frames = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames]
    animation.durations = shown_ms
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwriteanimation(
        str(path), animation, [cv2.IMWRITE_GIF_DITHER, 3, cv2.IMWRITE_GIF_QUALITY, 8, cv2.IMWRITE_GIF_COLORTABLE, 1]
    ):
        raise OSError(f"{path}: OpenCV could not write the animation")


if __name__ == "__main__":
    sys.exit(main())
