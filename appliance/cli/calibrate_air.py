"""The verb ``calibration air``: two cameras in air, the instrument's or any others, from pictures of a board."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.cli.arguments import number, operand, option, path_option, switch, whole_number
from appliance.cli.desk import check_folder, check_writable, writing
from appliance.cli.output import Exit, ProgressLine, UsageError, table
from appliance.cli.places import WithRoot

if TYPE_CHECKING:  # imported inside the verb, because a wrong word does not need it
    from appliance.calibrate import BoardDesign
    from appliance.store import Rig

log = logging.getLogger(__name__)
_BOARD = re.compile(r"(?:(\d{1,2})x(\d{1,2})x)?(\d+(?:\.\d+)?)(?:x(\d+(?:\.\d+)?))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateAir(WithRoot):
    """Calibrate the instrument's cameras, or any two with --pair, from a folder of pictures.

    FAILED if the pictures do not suffice, with the reason for each.
    """

    folder: Path = operand(
        "FOLDER",
        "images NAME_left.png and NAME_right.png, or a folder of --live or of scans; with --pair, images whose names "
        "show left and right",
        parse=Path,
    )
    board: str | None = option(
        "--board",
        "squares across and down, their size and the markers' in mm (default: 15x12x18x13.5); with --pair, 18, 18x13.5 "
        "or 15x12x18 is enough: the images show the rest, but not the size of a square",
        metavar="15x12x18x13.5",
    )
    """Design of the board; ``None`` for that of the folder, else the default."""
    out: Path | None = path_option(
        "--out", "default: air.json or pair.json in FOLDER; its figures are written beside it"
    )
    install: bool = switch("--install", "make it the start of this instrument's calibrations")
    live: int | None = option(
        "--live",
        "first record up to N views into FOLDER with this instrument",
        parse=whole_number(6, 200),
        metavar="N",
    )
    room_light: bool = switch("--room-light", "with --live: the projector stays dark")
    exposure_ms: float | None = option(
        "--exposure-ms", "with --live; default: the rig file's", parse=number(0.05, 16.0), metavar="MS"
    )
    timeout_s: float = option(
        "--timeout-s",
        "with --live: longest time without a new view; default: %(default)g",
        default=300.0,
        parse=number(1.0, 86400.0),
        metavar="S",
    )
    pair: str | None = option(
        "--pair", "calibrate any two cameras, and call them NAME; no rig file is read", metavar="NAME"
    )
    sides: str | None = option(
        "--sides",
        "with --pair: file names of the left and of the right images, each with one *",
        metavar="'a/*.png,b/*.png'",
    )
    flat: bool = switch("--flat", "with --pair: the board is known to be flat; its shape is not adjusted")

    @property
    def says_news(self) -> bool:
        """True with ``--live``, which makes the program the instrument for a while."""
        return self.live is not None

    def run(self) -> Exit:
        check_writable(self.out)
        if self.pair is not None:
            if self.live is not None or self.install:
                raise UsageError("--pair: is for cameras that are not the instrument's; leave out --live and --install")
            return self._of_pair(self.pair)
        if self.sides is not None or self.flat:
            raise UsageError("--sides and --flat: are for --pair; give --pair NAME, or leave them out")
        return self._of_instrument()

    # ------------------------------------------------------------------------------------- the instrument's

    def _of_instrument(self) -> Exit:
        rig = self.rooted_rig()
        if self.live is None:  # --live makes the folder
            check_folder("FOLDER", self.folder, "the images of the board")
        from appliance.base import ContentError
        from appliance.calibrate import BoardDesign, ViewFolder, calibrate_folder
        from appliance.calibrate import install as install_air

        target = self.out or self.folder / "air.json"
        try:
            design = None if self.board is None else BoardDesign.parse(self.board)
            if self.live is not None:
                self._record(rig, self.live, design)
            # The board of recorded views is stored beside them, so that its size need not be typed again.
            begun = ViewFolder.session(self.folder)
            design = design or (begun[1] if begun is not None else BoardDesign())
            with ProgressLine() as progress, writing(target):
                report = calibrate_folder(rig, self.folder, design, target, datetime.now(UTC), progress)
        except ContentError as error:
            raise UsageError(str(error)) from error
        if self.install:
            installed, before = install_air(rig, target)
            report |= {"installed": str(installed), "before": None if before is None else str(before)}
        return self._report(report)

    def _record(self, rig: Rig, views: int, design: BoardDesign | None) -> None:
        from appliance.calibrate import ViewFolder
        from appliance.instrument import LiveOptions, record_views

        options = LiveOptions(views, not self.room_light, self.exposure_ms, self.timeout_s)
        record_views(rig, ViewFolder(self.folder, rig.rig.serial, design), options, log.info)

    # ------------------------------------------------------------------------------------- anybody's

    def _of_pair(self, name: str) -> Exit:
        """Find the boards, adjust, write the result and print it."""
        sizes_mm = self._sizes_mm()
        left, comma, right = (self.sides or "").partition(",")
        if self.sides is not None and not comma:
            raise UsageError(f"--sides {self.sides}: give two with a comma between them, for example 'a/*.png,b/*.png'")
        check_folder("FOLDER", self.folder, "the images of the board")
        from appliance.calibrate import BoardDescription, calibrate_pictures

        across, down, square_mm, marker_mm = sizes_mm
        description = BoardDescription(square_mm, across, down, marker_mm)
        target = self.out or self.folder / "pair.json"
        sides = (left, right) if comma else None
        with ProgressLine() as progress, writing(target):
            report = calibrate_pictures(
                name, self.folder, sides, description, self.flat, target, datetime.now(UTC), progress
            )
        return self._report(report)

    def _report(self, report: dict[str, Any]) -> Exit:
        for text in report["warnings"]:
            log.warning(text)
        self.tell(report, _lines(report))
        return Exit.OK

    def _sizes_mm(self) -> tuple[int | None, int | None, float, float | None]:
        """Return squares across and down, their size and that of the markers; ``None`` for a number to be found.

        Raises UsageError.
        """
        if self.board is None:
            raise UsageError(
                "--board is missing: images do not show the size of a square; measure a row of squares, and give "
                "--board "
                "18"
            )
        match = _BOARD.fullmatch(self.board)
        if match is not None:
            across, down = (None if text is None else int(text) for text in match.groups()[:2])
            square_mm, marker_mm = float(match[3]), None if match[4] is None else float(match[4])
            is_possible = all(text is None or 3 <= text <= 60 for text in (across, down)) and 0.1 <= square_mm <= 1000.0
            if is_possible and (marker_mm is None or 0.05 <= marker_mm < square_mm):
                return across, down, square_mm, marker_mm
        raise UsageError(
            f"--board {self.board}: give SQUARE, SQUARExMARKER, ACROSSxDOWNxSQUARE or all four, squares 3..60, sizes "
            f"0.1..1000 mm, markers "
            "smaller; for example 15x12x18x13.5"
        )


def _lines(report: dict[str, Any]) -> list[str]:
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
    return [
        table(("VIEW", "CORNERS", "RESIDUAL PX", "NOISE PX", ""), rows),
        *(f"left out: {text}" for text in report["left_out"]),
        *(f"name shows neither left nor right: {text}" for text in report.get("unnamed", ())),
        *(f"{name:<27} {value}" for name, value in _figures(report)),
    ]


def _figures(report: dict[str, Any]) -> list[tuple[str, str]]:
    f, sd = report["principal_distance_px"], report["principal_distance_sd_px"]
    names = {
        "file": "file",
        "opencv_file": "for OpenCV",
        "told_by": "left and right from",
        "installed": "installed",
        "before": "the former one is",
    }
    return [
        ("residual", f"{report['residual_px']:.4f} px"),
        ("principal distances", f"{f[0]:.2f} ± {sd[0]:.2f} / {f[1]:.2f} ± {sd[1]:.2f} px"),
        ("baseline", f"{report['baseline_mm']:.3f} ± {report['baseline_sd_mm']:.3f} mm"),
        ("board", report["board"]),
        ("board's bow, saddle, twist", ", ".join(f"{v:.3f}" for v in report["board_shapes_mm"][:3]) + " mm"),
        ("pairs", f"{len(report['pairs'])} of {len(report['views'])} views used"),
        *((name, report[key]) for key, name in names.items() if report.get(key)),
        *(("picture", path) for path in report["pictures"]),
    ]
