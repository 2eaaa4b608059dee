"""What ``kingfisher import`` makes of a drawn laboratory, against where things are: by its command line and its files alone."""

from __future__ import annotations

import contextlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from appliance.cli import main
from tests.support.other_programs import Drawn
from tests.support.strangers import distance_mm

LEAST_PERCENT = 60.0
"""Of the pixels in sight of all, where edges of depth are a part."""
MOST_PX = 0.3
"""Median distance from the surface, in pixels of disparity; or as much as the points themselves say."""
MOST_OF_SIGMA = 1.5
FAR_PX, MOST_FAR_PERCENT = 5.0, 3.0
NOTED = (
    "period",
    "fringes",
    "width",
    "stripe",
    "sign",
    "start",
    "offset",
    "order",
    "scale",
    "which is left",
    "rotation",
    "unit",
)
"""Words of what a note may be about that would explain a wrong cloud."""


@dataclass(frozen=True)
class Said:
    """How a call ended."""

    code: int
    report: dict[str, Any]
    """Empty if it was refused."""
    error: str

    @property
    def unchecked(self) -> list[str]:
        return list(self.report.get("unchecked", []))


def kingfisher(*arguments: object) -> Said:
    """Call the command line here, with ``--json``."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([*map(str, arguments), "--json"])
        except Exception as error:  # one set that breaks the program must not hide what the others do
            return Said(1, {}, f"crashed: {type(error).__name__}: {error}")
    told = [json.loads(line) for line in err.getvalue().splitlines() if line.startswith("{")]
    return Said(
        int(code),
        json.loads(out.getvalue()) if code == 0 else {},
        " ".join(one["error"] for one in told if "error" in one),
    )


@dataclass(frozen=True)
class Import:
    """How good a cloud is, and what was said."""

    outcome: str
    complete_percent: float
    off_px: float
    said: tuple[str, ...]


def import_folder(folder: Path, out: Path, drawn: Drawn) -> Import:
    """Import a folder without a word. ``whole``, ``asked`` (no cloud), ``wrong, with a note`` or ``wrong without a note``."""
    said = kingfisher("import", folder, "--out", out)
    if said.code:
        return Import("crashed" if said.error.startswith("crashed") else "asked", 0.0, float("nan"), (said.error,))
    complete_percent, off_px, right = judged(out, drawn)
    described = str(said.report.get("order", ""))
    noted = any(word in line for line in said.unchecked for word in NOTED)
    outcome = "whole" if right else "wrong, with a note" if noted else "wrong without a note"
    return Import(outcome, complete_percent, off_px, (described, *said.unchecked))


def judged(cloud: Path, drawn: Drawn) -> tuple[float, float, bool]:
    """Return the share of points of what all see, in %, their median distance from the surface in px of disparity, and whether both are right."""
    with np.load(cloud) as grid:
        there = grid["mask"]
        points_mm = np.stack([grid[f"{axis}_mm"][there] for axis in "xyz"], -1)
        sigma_mm = float(np.median(grid["sigma_mm"][there]))
    off_mm = distance_mm(points_mm)
    complete_percent = 100.0 * len(points_mm) / drawn.in_sight()
    off_px = float(np.median(off_mm)) / drawn.pixel_mm
    far_percent = 100.0 * float(np.mean(off_mm > FAR_PX * max(drawn.pixel_mm, sigma_mm)))
    most_px = max(MOST_PX, MOST_OF_SIGMA * sigma_mm / drawn.pixel_mm)
    return (
        complete_percent,
        off_px,
        complete_percent >= LEAST_PERCENT and off_px <= most_px and far_percent <= MOST_FAR_PERCENT,
    )
