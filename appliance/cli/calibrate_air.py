"""Owns the verb ``calibrate air``: the pair of cameras in air, from pictures of a board."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from appliance.cli.desk import writable, writing
from appliance.cli.output import Exit, Progress, UsageError, complain, say, say_json, table
from appliance.config import Rig

DEFAULT_NAME = "air.json"
"""In the folder of pictures."""


def air(rig: Rig, folder: Path, board: str | None, out: Path | None, *, install: bool, json: bool) -> Exit:
    """Calibrate from a folder of pictures; FAILED where they do not suffice, with the reason for each."""
    from appliance.calibration.air import AirCalibrationError
    from appliance.calibration.board import BoardDesign, BoardError, parse_board
    from appliance.service.air import PicturesError, calibrate_folder
    from appliance.service.air import install as install_air

    writable(out)
    target = out or folder / DEFAULT_NAME
    try:
        design = BoardDesign() if board is None else parse_board(board)
        with Progress() as progress, writing(target):
            report = calibrate_folder(rig, folder, design, target, datetime.now(UTC), progress)
    except (BoardError, PicturesError) as error:
        raise UsageError(str(error)) from error
    except AirCalibrationError as error:
        complain(str(error), as_json=json)
        return Exit.FAILED
    if install:
        installed, before = install_air(rig, target)
        report |= {"installed": str(installed), "before": None if before is None else str(before)}
    if json:
        say_json(report)
    else:
        _tell(report)
    return Exit.OK


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
