"""Owns the verb ``calibrate air``: the pair of cameras in air, from pictures of a board, or with a board before it."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.cli.desk import writable, writing
from appliance.cli.kernels import find_kernels
from appliance.cli.output import Exit, Progress, UsageError, complain, say, say_json, table
from appliance.config import Rig

if TYPE_CHECKING:  # imported inside the verb: `scans list` can do without
    from appliance.calibration.board import BoardDesign

log = logging.getLogger(__name__)

DEFAULT_NAME = "air.json"
"""In the folder of pictures."""


@dataclass(frozen=True, slots=True)
class AirOptions:
    """What was typed after ``calibrate air FOLDER``."""

    board: str | None = None
    """``None``: that of the folder, else the usual one."""
    out: Path | None = None
    install: bool = False
    live: bool = False
    views: int = 20
    room_light: bool = False
    exposure_ms: float | None = None
    patience_s: float = 300.0


def air(rig: Rig, folder: Path, options: AirOptions, *, json: bool) -> Exit:
    """Calibrate from a folder of pictures; FAILED where they do not suffice, with the reason for each."""
    find_kernels()
    from appliance.calibration.air import AirCalibrationError
    from appliance.calibration.board import BoardDesign, BoardError, parse_board
    from appliance.service.air import PicturesError, calibrate_folder
    from appliance.service.air import install as install_air
    from appliance.service.air_views import FolderError, read_session

    writable(options.out)
    target = options.out or folder / DEFAULT_NAME
    try:
        design = None if options.board is None else parse_board(options.board)
        if options.live:
            _record(rig, folder, design, options)
        begun = read_session(folder)
        design = design or (begun[1] if begun is not None else BoardDesign())
        with Progress() as progress, writing(target):
            report = calibrate_folder(rig, folder, design, target, datetime.now(UTC), progress)
    except (BoardError, PicturesError, FolderError) as error:
        raise UsageError(str(error)) from error
    except (AirCalibrationError, LiveFailed) as error:
        complain(str(error), as_json=json)
        return Exit.FAILED
    if options.install:
        installed, before = install_air(rig, target)
        report |= {"installed": str(installed), "before": None if before is None else str(before)}
    if json:
        say_json(report)
    else:
        _tell(report)
    return Exit.OK


class LiveFailed(Exception):
    """Recording ended before there were enough views; the text says why."""


def _record(rig: Rig, folder: Path, design: BoardDesign | None, options: AirOptions) -> None:
    from appliance.service.air_live import LiveError, LiveOptions, record_views
    from appliance.service.air_views import ViewFolder

    wanted = LiveOptions(options.views, not options.room_light, options.exposure_ms, options.patience_s)
    try:
        record_views(rig, ViewFolder(folder, rig.rig.serial, design), wanted, log.info)
    except LiveError as error:
        raise LiveFailed(str(error)) from error


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
