"""Owns the verb ``calibrate air``: the pair of cameras in air, from pictures of a board, or with a board before it."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.cli.arguments import number, operand, option, switch, whole
from appliance.cli.desk import existing, writable, writing
from appliance.cli.output import Exit, Progress, UsageError, complain, say, say_json, table
from appliance.cli.places import WithRoot

if TYPE_CHECKING:  # imported inside the verb: a wrong word can do without
    from appliance.calibrate import BoardDesign
    from appliance.store import Rig

log = logging.getLogger(__name__)

DEFAULT_NAME = "air.json"
"""Name of the file that is written into the folder of pictures unless ``--out`` names another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateAir(WithRoot):
    """Calibrate from a folder of pictures; FAILED where they do not suffice, with the reason for each."""

    folder: Path = operand(
        "FOLDER", "pairs NAME_left.png, NAME_right.png, or folders of --live or of scans", parse=Path
    )
    board: str | None = option(
        "--board", "squares across and down, their size and the markers' in mm", metavar="15x12x18x13.5"
    )
    """Design of the board; ``None``: that of the folder, else the usual one."""
    out: Path | None = option("--out", "default: air.json in FOLDER; pictures go beside it", parse=Path, metavar="FILE")
    install: bool = switch("--install", "make it the start of this instrument's calibrations")
    live: bool = switch("--live", "record the views first, with this instrument, into FOLDER")
    views: int = option("--views", "default: %(default)s", default=20, parse=whole(6, 200), metavar="N")
    room_light: bool = switch("--room-light", "the projector stays dark")
    exposure_ms: float | None = option(
        "--exposure-ms", "default: the rig file's", parse=number(0.05, 16.0), metavar="MS"
    )
    patience_s: float = option(
        "--patience-s",
        "without a new view, default: %(default)g",
        default=300.0,
        parse=number(1.0, 86400.0),
        metavar="S",
    )

    @property
    def says_news(self) -> bool:
        """True with ``--live``, which makes it the instrument for a while."""
        return self.live

    def run(self) -> Exit:
        rig = self.rooted_rig()
        writable(self.out)
        if not self.live:  # which makes it
            existing("FOLDER", self.folder, "the pictures of the board")
        from appliance.base import ContentError
        from appliance.calibrate import (
            AirCalibrationError,
            BoardDesign,
            BoardError,
            PicturesError,
            calibrate_folder,
            parse_board,
            read_session,
        )
        from appliance.calibrate import install as install_air

        target = self.out or self.folder / DEFAULT_NAME
        try:
            design = None if self.board is None else parse_board(self.board)
            if self.live:
                self._record(rig, design)
            # The board that the views were recorded with is written beside them, so that nobody has to remember its
            # size.
            begun = read_session(self.folder)
            design = design or (begun[1] if begun is not None else BoardDesign())
            with Progress() as progress, writing(target):
                report = calibrate_folder(rig, self.folder, design, target, datetime.now(UTC), progress)
        except (BoardError, PicturesError, ContentError) as error:
            raise UsageError(str(error)) from error
        except (AirCalibrationError, LiveFailed) as error:
            complain(str(error), as_json=self.json)
            return Exit.FAILED
        if self.install:
            installed, before = install_air(rig, target)
            report |= {"installed": str(installed), "before": None if before is None else str(before)}
        if self.json:
            say_json(report)
        else:
            _tell(report)
        return Exit.OK

    def _record(self, rig: Rig, design: BoardDesign | None) -> None:
        from appliance.calibrate import ViewFolder
        from appliance.instrument import LiveError, LiveOptions, record_views

        wanted = LiveOptions(self.views, not self.room_light, self.exposure_ms, self.patience_s)
        try:
            record_views(rig, ViewFolder(self.folder, rig.rig.serial, design), wanted, log.info)
        except LiveError as error:
            raise LiveFailed(str(error)) from error


class LiveFailed(Exception):
    """Recording ended before there were enough views; the text says why."""


def _tell(report: dict[str, Any]) -> None:
    rows = [
        (view["name"], str(view["corners"]), f"{view['residual_px']:.3f}", "; ".join(view["remarks"]))
        for view in report["views"]
    ]
    say(table(("VIEW", "CORNERS", "RESIDUAL PX", ""), rows))
    for key in ("left_out", "missing"):
        for text in report[key]:
            say(f"{key.replace('_', ' ')}: {text}")
    f, sd = report["principal_distance_px"], report["principal_distance_sd_px"]
    for name, value in (
        ("residual", f"{report['residual_px']:.4f} px"),
        ("principal distances", f"{f[0]:.2f} ± {sd[0]:.2f} / {f[1]:.2f} ± {sd[1]:.2f} px"),
        ("baseline", f"{report['baseline_mm']:.3f} ± {report['baseline_sd_mm']:.3f} mm"),
        ("board's bow", f"{report['board_bow_mm']:.3f} mm"),
        ("file", report["file"]),
        *(("picture", path) for path in report["pictures"]),
        *(("installed", report[key]) for key in ("installed",) if report.get(key)),
        *(("the one before is", report[key]) for key in ("before",) if report.get(key)),
    ):
        say(f"{name:<24} {value}")
