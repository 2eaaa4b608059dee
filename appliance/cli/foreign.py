"""The verb ``import``: images of another rig as points or as a scan folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import Verb, operand, path_option, switch
from appliance.cli.desk import check_writable, check_writable_as, writing
from appliance.cli.kernels import compile_point_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class Import(Verb):
    """Import images of another rig as points, from a folder or by a description (docs/foreign.md)."""

    source: Path = operand(
        "FOLDER | DESCRIPTION",
        "a folder with the images of one pose and the cameras' files, or an image set description (TOML)",
        parse=Path,
    )
    out: Path | None = path_option(
        "--out", "a cloud: .ply .e57 .las .npz (default: NAME.ply here); a folder: a scan as the instrument stores it"
    )
    as_described: bool = switch("--as-described", "import it although the images contradict the description")
    reasons: Path | None = path_option("--reasons", "draw the mask reason of each pixel (PNG)", metavar="PICTURE")

    def run(self) -> Exit:
        out = self.out or Path(f"{self.source.absolute().stem}.ply")
        if out.suffix:
            check_writable_as(out, "a cloud")
        check_writable(self.reasons, "--reasons")
        if self.source.is_dir():
            self._check_folder(out)
        else:
            from appliance.desk import check_import

            # Checked before modules that compute are loaded, and before a minute of compiling.
            check_import(self.source, out)
        with ProgressLine() as progress:
            if self.source.is_dir():
                progress("looking for images")
            from appliance.desk import import_images

            compile_point_kernels()
            with writing(out):
                report = import_images(self.source, out, progress, as_described=self.as_described, reasons=self.reasons)
        self.tell(report)
        return Exit.OK

    def _check_folder(self, out: Path) -> None:
        """Raise UsageError for options or files that a folder of images does not allow."""
        if self.as_described or not out.suffix:
            raise UsageError(
                "import: a folder of images makes a cloud (.ply .e57 .las .npz); --as-described and a scan folder "
                "need a "
                "description; import the one that is written with the cloud"
            )
        description = out.with_suffix(".toml")
        if description.exists():
            raise UsageError(f"{description} exists already; import it, or give another name with --out FILE")
