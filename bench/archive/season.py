"""Draws a small season and its page: `./dev run python -m bench.archive.season docs/pictures/season.png [FOLDER]`.

Two scans a day on three weeks, of a frustum with a certificate and of other things, in water that gets colder. On the eighth day the right
camera is knocked; on the fifteenth the instrument is calibrated anew. Two scans are too dark, in one the hands moved, two are damaged on
the disk. What the page says of them is what `kingfisher archive reprocess` and `kingfisher report` make of the frames. Chromium takes the picture.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.objects.motion import Motion
from hw_sim.objects.shapes import FRUSTUM_BASE_MM, FRUSTUM_TOP_MM
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water
from tests.support.browser import browse
from tests.support.commands import kingfisher
from tests.support.rendered import EXPOSURE_S, RenderedScan, render_scan
from tests.support.stored import origin_of, store

DAYS, SIZE_PX = 21, (400, 300)
SET, SEED = "modelled", 3
KNOCKED_ON, CALIBRATED_ON = 8, 15
KNOCK = MountShift("right", yaw_deg=0.03, pitch_deg=0.01)
DARK, MOVED, DAMAGED = (9, 30), (21,), (14, 35)
TREMOR_MM = (1.5, 1.5, 1.0)
OTHERS = ("shell", "pipe", "stones")
MOST_S = 1800.0
WINDOW_PX = (1200, 2560)


@dataclass(frozen=True, slots=True)
class Season:
    """A storage root, and the list of artefacts that its scans show."""

    root: Path
    artefacts: Path


def draw_season(folder: Path) -> Season:
    """Draw the season's scans below ``folder``, the same ones each time."""
    shelf = folder / "season" / "scans"
    shelf.mkdir(parents=True)
    listed = []
    for number in range(1, 2 * DAYS + 1):
        day = (number + 1) // 2
        frustum = number % 2 == 1
        scan = _taken(number, day, frustum)
        truth = scan.renderer.truth
        believed = truth if day >= CALIBRATED_ON else draw_truth(SET, SEED, *SIZE_PX, scan.renderer.scene.water.index)
        wall_time = f"2031-05-{day:02d}T{9 + 5 * (number % 2 == 0):02d}:12:00+00:00"
        store(scan, shelf / f"{number:06d}", origin=origin_of(believed, *SIZE_PX), wall_time=wall_time)
        if number in DAMAGED:
            _damage(shelf / f"{number:06d}" / "frames_left.npy")
        if frustum:
            listed.append(
                f'[[scan]]\nscan = "{number}"\nartefact = "frustum"\ntop_mm = {FRUSTUM_TOP_MM}\nbase_mm = {FRUSTUM_BASE_MM}\n'
            )
    artefacts = folder / "artefacts.toml"
    artefacts.write_text("\n".join(listed), encoding="utf-8")
    return Season(shelf.parent, artefacts)


def season_page(season: Season, folder: Path) -> Path:
    """Return the page that the two verbs make of the season, below ``folder``."""
    arguments = (
        "archive",
        "reprocess",
        season.root,
        season.artefacts,
        "--out",
        folder / "out",
        "--table-only",
        "--json",
    )
    table = Path(_said(folder, *arguments)["table"]).relative_to(folder)
    _said(folder, "report", table, "--out", "season.html", "--json")
    return folder / "season.html"


def main(arguments: Sequence[str]) -> int:
    """Draw the season, write its page, and take its picture."""
    if not arguments:
        print(__doc__)
        return 2
    picture = Path(arguments[0]).absolute()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(arguments[1]).absolute() if len(arguments) > 1 else Path(scratch)
        page = season_page(draw_season(folder), folder)
        width_px, height_px = WINDOW_PX
        browse(page, Path(scratch), f"--screenshot={picture}", f"--window-size={width_px},{height_px}")
    print(picture)
    return 0


def _taken(number: int, day: int, frustum: bool) -> RenderedScan:
    pose = (
        4.0 * (number % 5 - 2),
        3.0 * (number % 7 - 3),
        540.0 + number % 4,
        5.0 - number % 3,
        -8.0 + number % 6,
        12.0,
    )
    scene = Scene(
        "frustum" if frustum else OTHERS[number // 2 % len(OTHERS)],
        pose=pose if frustum else None,
        water=Water(temperature_c=round(19.0 - 0.35 * day, 2), salinity_psu=35.0),
        motion=Motion(tremor_mm=TREMOR_MM) if number in MOVED else Motion(),
    )
    return render_scan(
        scene, SET, SEED, SIZE_PX[0], 16,
        EXPOSURE_S / 40 if number in DARK else EXPOSURE_S,
        frame_s=1.0 / 60.0 if number in MOVED else 0.0,
        change=(lambda truth: with_mount_shifted(truth, KNOCK)) if day >= KNOCKED_ON else None,
    )  # fmt: skip


def _damage(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _said(folder: Path, *arguments: object) -> Any:
    result = kingfisher(*arguments, cwd=folder, most_s=MOST_S)
    if not result.out:
        raise RuntimeError(f"kingfisher {arguments[0]}: {result.err}")
    return result.document


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
