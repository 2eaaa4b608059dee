"""CPU time, memory and points of an import of 72 pictures of 16 megapixels."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from bench.result import Measurement
from tests.support import strangers
from tests.support.other_programs import draw_laboratory, of_periods, opencv

WIDTH_PX, PROJECTOR_PX = 4608, (1024, 768)
FRINGES, STEPS = (70, 64, 59), 12
STRIP_PX = 128
"""Rows that are drawn at a time."""
MOST_CPU_S, MOST_GB = 60.0, 1.5
# A process counts the memory of the one that started it as its own. This one, which has drawn the set, has more than the import.
BETWEEN = """
import json, resource, subprocess, sys
said = json.loads(subprocess.run(sys.argv[1:], check=True, capture_output=True, timeout=3600).stdout)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([said["points"], used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6]))
"""
"""The program between this process and the import; prints points, processor time in s and memory in GB."""


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="./dev bench import_large", description=__doc__)
    parser.add_argument(
        "--width", metavar="PX", type=int, default=WIDTH_PX, help="of the pictures; bounds hold for the default"
    )
    parser.add_argument("--out", default="cloud.npz", metavar="NAME", help="cloud.ply: as PLY")
    chosen = parser.parse_args(arguments)
    all_kept = True
    for number in measure(chosen.width, chosen.out):
        all_kept &= number.is_kept
        print(number.line(), flush=True)
    return 0 if all_kept else 1


def measure(width_px: int = WIDTH_PX, out: str = "cloud.npz") -> Iterator[Measurement]:
    """Draw the set, and import it by another process."""
    is_full_size = width_px == WIDTH_PX
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "set"
        draw(folder, width_px)
        arguments = ("-m", "appliance.cli", "import", str(folder), "--out", str(folder.with_name(out)), "--json")
        between = (sys.executable, "-c", BETWEEN, sys.executable, *arguments)
        result = subprocess.run(between, check=True, capture_output=True, timeout=3600)
    points, cpu_s, memory_gb = json.loads(result.stdout)
    yield Measurement("points", points, f"of {width_px * width_px * 3 // 4} pixels")
    yield Measurement("processor time", cpu_s, "s CPU", at_most=MOST_CPU_S if is_full_size else None)
    yield Measurement("largest memory", memory_gb, "GB", at_most=MOST_GB if is_full_size else None)


def draw(folder: Path, width_px: int) -> None:
    """Draw both cameras' pictures of three periods in one direction, with blur and noise, and their calibration."""
    drawn = draw_laboratory(width_px, PROJECTOR_PX, two_cameras=True, linear=False, seed=21)
    shown = [drawn.shown(pattern) for pattern in of_periods(*FRINGES, steps=STEPS)(PROJECTOR_PX)]
    folder.mkdir()
    opencv(drawn, folder)
    for n, (side, camera) in enumerate((("left", drawn.bench.left), ("right", drawn.bench.right))):
        pictures = np.empty((len(shown), camera.height_px, camera.width_px), np.uint8)
        for row in range(0, camera.height_px, STRIP_PX):
            K = camera.K.copy()
            K[1, 2] -= row
            strip = replace(camera, K=K, height_px=min(STRIP_PX, camera.height_px - row))
            strip_pictures = strangers.photographs(
                strip, drawn.bench.projector, shown, 1000 * n + row, noise=drawn.noise, texture=drawn.texture
            )
            pictures[:, row : row + strip.height_px] = strip_pictures
            strangers.lit.cache_clear()
        (folder / side).mkdir()
        for k, picture in enumerate(pictures):
            cv2.imwrite(str(folder / side / f"{k:02d}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
