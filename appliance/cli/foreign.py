"""Owns the verb ``import``: images that some other rig took, as points or as a scan folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import Verb, operand, option, switch
from appliance.cli.desk import existing, writable, writing
from appliance.cli.kernels import compile_point_kernels
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, Progress, UsageError, say


@dataclass(frozen=True, slots=True, kw_only=True)
class Import(Verb):
    """Points of images that another rig took, by a description of what they show (docs/foreign.md)."""

    description: Path | None = operand("DESCRIPTION", "what the images show (TOML)", parse=Path, optional=True)
    out: Path | None = option(
        "--out",
        "a cloud: .ply .e57 .las .npz (default: NAME.ply here); a folder: a scan like our own",
        parse=Path,
        metavar="FILE",
    )
    as_described: bool = switch("--as-described", "import it also where the images contradict the description")
    reasons: Path | None = option("--reasons", "draw why pixels have no point (PNG)", parse=Path, metavar="PICTURE")
    guess: Path | None = option(
        "--guess",
        "write a first description of the images in that folder, by looking at them",
        parse=Path,
        metavar="FOLDER",
    )

    def run(self) -> Exit:
        if (self.guess is None) == (self.description is None):
            raise UsageError("import: give a description, or --guess FOLDER to have one written; one of them")
        if self.guess is not None:
            return self._guess(self.guess)
        assert self.description is not None
        out = self.out or Path(f"{self.description.stem}.ply")
        folder = out.suffix == ""
        if not folder:
            writable(out)
        writable(self.reasons, "--reasons")
        from appliance.export.suffixes import SCAN_SUFFIXES, ExportError, checked_suffix, require_library
        from appliance.foreign.description import load_description

        try:
            if not folder:
                checked_suffix(out, SCAN_SUFFIXES, "a cloud")
                require_library(out)
        except ExportError as error:
            raise UsageError(f"--out {error}") from error
        # A wrong word is the usual end of a first try, as is a picture that is not there: told before anything that computes is loaded, and before a minute of compiling.
        load_description(self.description)
        from appliance.foreign.first_look import look_first

        look_first(self.description)
        from appliance.offline.foreign_import import check_import, import_cloud, import_scan

        check_import(self.description, out)
        with Progress() as progress:
            compile_point_kernels()
            with writing(out):
                make = import_scan if folder else import_cloud
                report = make(self.description, out, progress, as_described=self.as_described, reasons=self.reasons)
        say_report(report, as_json=self.json)
        return Exit.OK

    def _guess(self, folder: Path) -> Exit:
        out = self.out or folder / "description.toml"
        if out.exists():
            raise UsageError(f"--out {out}: is there already; give another name with --out FILE")
        existing("--guess", folder, "the images")
        writable(out)
        from appliance.foreign.guess import guess_description
        from appliance.storage.atomic import replace_file
        from appliance.storage.filesystem import LocalFileSystem

        with Progress() as progress:
            text = guess_description(folder, out.parent, progress)
        with writing(out):
            replace_file(LocalFileSystem(), out, text.encode())
        say(str(out))
        return Exit.OK
