"""Owns the verb ``calibrate pair``: anybody's two cameras in air, from their pictures of a ChArUco board."""

from __future__ import annotations

import argparse
import logging
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from appliance.cli.arguments import Verb, number, operand, option, switch
from appliance.cli.desk import existing, writable, writing
from appliance.cli.output import Exit, Progress, UsageError, complain, say, say_json, table

log = logging.getLogger(__name__)

DEFAULT_NAME = "pair.json"
"""Name of the file that is written into the folder of pictures unless ``--out`` names another."""


def squares(text: str) -> tuple[int, int]:
    """Read ``25x18``. Raises ArgumentTypeError."""
    found = re.fullmatch(r"(\d{1,2})x(\d{1,2})", text)
    if found is None or not all(3 <= int(n) <= 60 for n in found.groups()):
        raise argparse.ArgumentTypeError(f"{text}: allowed are two numbers 3..60 with an x, for example 25x18")
    return int(found[1]), int(found[2])


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratePair(Verb):
    """Calibrate from a folder of anybody's pictures; FAILED where they do not suffice, with the reason for each."""

    folder: Path = operand("FOLDER", "pictures of a ChArUco board; names tell left from right", parse=Path)
    square_mm: float = option(
        "--square-mm", "side of a square: needed, since no picture tells it", parse=number(0.1, 1000.0), metavar="MM"
    )
    board: tuple[int, int] | None = option(
        "--board", "squares across and down (default: found)", parse=squares, metavar="25x18"
    )
    marker_mm: float | None = option(
        "--marker-mm", "side of a marker (default: found)", parse=number(0.05, 1000.0), metavar="MM"
    )
    flat: bool = switch("--flat", "the board is known to be flat: its shape is not adjusted")
    left: str | None = option("--left", "which pictures are the left camera's, with one *", metavar="'a/*.png'")
    right: str | None = option("--right", "which are the right one's", metavar="'b/*.png'")
    name: str | None = option("--name", "of these cameras, for the file (default: the folder's)")
    out: Path | None = option("--out", "default: pair.json in FOLDER; more goes beside it", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        """Look at the pictures, adjust, write and say what came out."""
        if self.square_mm is None:
            raise UsageError(
                "--square-mm MM is missing: no picture tells how large a board is; measure a row of squares"
            )
        if (self.left is None) != (self.right is None):
            raise UsageError("--left and --right belong together; give both, or neither")
        if self.marker_mm is not None and self.marker_mm >= self.square_mm:
            raise UsageError(f"--marker-mm {self.marker_mm:g}: allowed are sizes below --square-mm {self.square_mm:g}")
        writable(self.out)
        existing("FOLDER", self.folder, "the pictures of the board")
        from appliance.calibrate import (
            AirCalibrationError,
            BoardNotFoundError,
            Patterns,
            PicturesError,
            Wanted,
            calibrate_pictures,
            named_pictures,
        )

        target = self.out or self.folder / DEFAULT_NAME
        patterns = None if self.left is None or self.right is None else Patterns(self.left, self.right)
        across, down = self.board or (None, None)
        wanted = Wanted(self.square_mm, across, down, self.marker_mm)
        try:
            pictures = named_pictures(self.folder, patterns)
            with Progress() as progress, writing(target):
                report = calibrate_pictures(
                    self.name or self.folder.resolve().name,
                    pictures,
                    wanted,
                    self.flat,
                    target,
                    datetime.now(UTC),
                    progress,
                )
        except PicturesError as error:
            raise UsageError(str(error)) from error
        except (AirCalibrationError, BoardNotFoundError) as error:
            complain(str(error), as_json=self.json)
            return Exit.FAILED
        for text in report["warnings"]:
            log.warning(text)
        if self.json:
            say_json(report)
        else:
            _tell(report)
        return Exit.OK


def _tell(report: dict[str, Any]) -> None:
    rows = [
        (
            view["name"],
            " / ".join(str(n or "-") for n in view["corners"]),
            f"{view['residual_px']:.3f}",
            " / ".join("-" if sd is None else f"{sd:.3f}" for sd in view["noise_px"]),
            "; ".join(view["remarks"]),
        )
        for view in report["views"]
    ]
    say(table(("VIEW", "CORNERS", "RESIDUAL PX", "NOISE PX", ""), rows))
    for text in report["left_out"]:
        say(f"left out: {text}")
    for text in report["unnamed"]:
        say(f"neither left nor right by its name: {text}")
    f, sd = report["principal_distance_px"], report["principal_distance_sd_px"]
    for name, value in (
        ("board found", report["board"]),
        ("left and right told by", report["told_by"]),
        ("pairs", f"{len(report['pairs'])} of {len(report['views'])} views used"),
        ("residual", f"{report['residual_px']:.4f} px"),
        ("principal distances", f"{f[0]:.2f} ± {sd[0]:.2f} / {f[1]:.2f} ± {sd[1]:.2f} px"),
        ("baseline", f"{report['baseline_mm']:.3f} ± {report['baseline_sd_mm']:.3f} mm"),
        ("board's bow, saddle, twist", ", ".join(f"{v:.3f}" for v in report["board_shapes_mm"][:3]) + " mm"),
        ("file", report["file"]),
        ("for OpenCV", report["opencv_file"]),
        *(("picture", path) for path in report["pictures"]),
    ):
        say(f"{name:<27} {value}")
