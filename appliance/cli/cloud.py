"""The verb ``cloud``: files of points or triangles, from stored scans, incomplete scans and objects."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from appliance.cli.arguments import number, operands, option, repeated, switch
from appliance.cli.desk import (
    SPACING_MM,
    WithObjects,
    check_suffix,
    check_writable,
    check_writable_as,
    find_scan,
    library_root,
    object_name,
    writing,
)
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError

if TYPE_CHECKING:
    from appliance.store import ScanOptions

NAME = "{}"
"""Placeholder of the scan's name in ``--out``."""
INCOMPLETE = "incomplete:"
"""Prefix of the number of an incomplete scan."""
OWN, POSED, PAGE = ".ply", ".e57", ".html"
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeCloud(WithObjects):
    """Make points or meshes of stored scans from their raw frames, or one surface of a solved object.

    Files of a damaged scan say so, as do stderr and the exit code; they must not be measured in.
    """

    codes: ClassVar[Sequence[Exit]] = (Exit.DAMAGED,)

    what: Sequence[str] = operands(
        "WHAT",
        "scans, by numbers or folders; SCAN+SCAN: one cloud from two exposures of one place; incomplete:N: an "
        "unchecked cloud of a recording that broke after its first direction; object:NAME",
        at_least_one=True,
    )
    out: tuple[str, ...] = repeated(
        "--out",
        "points: .ply .e57 .las, on the pixel grid .npz; meshes: .stl .obj; may be repeated; {} stands for the scan's "
        "name, and is needed for several scans (default: {}.ply)",
        metavar="FILE",
    )
    mesh: bool = switch("--mesh", "in .ply files, write triangles instead of points")
    normals: bool = switch(
        "--normals", "normals, and grey as colour, in .ply files of scans, instead of the instrument's own form"
    )
    single_scans: bool = switch(
        "--scans", "an object's single scans in .e57 files, each with its pose, instead of one surface of all"
    )
    close_holes: float | None = option(
        "--close-holes",
        "close holes of an object's mesh up to this width; filled parts are not measured and have no sigma",
        parse=number(0.1, 1000.0, "mm"),
        metavar="MM",
    )

    def run(self) -> Exit:
        options = self.scan_options()
        name = next((name for name in map(object_name, self.what) if name is not None), None)
        if name is None:
            return self._of_scans(options)
        if len(self.what) > 1 or self.normals:
            raise UsageError(f"object:{name}: takes neither other scans nor --normals; give it alone")
        return self._of_object(options, name)

    # ------------------------------------------------------------------------------------- scans

    def _of_scans(self, options: ScanOptions) -> Exit:
        of_objects = {
            "--spacing": self.spacing != SPACING_MM,
            "--scans": self.single_scans,
            "--close-holes": self.close_holes is not None,
        }
        for flag, is_given in of_objects.items():
            if is_given:
                raise UsageError(f"{flag}: is for objects; give object:NAME")
        works = self._works(options)
        reports: list[dict[str, Any]] = []
        with ProgressLine() as progress:
            compile_kernels()
            for k, (out, work) in enumerate(works.items(), 1):
                progress(f"comparing checksums ({k} of {len(works)})")
                # Also for the default name, so that an error names that file.
                with writing(out):
                    reports.append(work(out, progress))
        if len(reports) == 1:
            self.tell(reports[0])
        elif self.json:
            self.tell(reports)
        else:
            for report in reports:
                self.tell(report)
        return Exit.DAMAGED if any(report.get("salvaged") for report in reports) else Exit.OK

    def _works(self, options: ScanOptions) -> Mapping[Path, _Work]:
        """Return the work for each file. Raises UsageError, UnknownScan, ScanError before any of it."""
        from appliance.desk import has_triangles

        works: dict[Path, _Work] = {}
        word_by_file: dict[Path, str] = {}
        for out_name in self.out or (f"{NAME}{OWN}",):
            path = Path(out_name)
            suffix = path.suffix.lower()
            meshed = has_triangles(path) or self.mesh
            kind = "a mesh" if meshed else "a scan"
            # The name of the folder may contain the scan's name, too.
            check_writable_as(path, kind) if NAME not in out_name else check_suffix(path, kind)
            if len(self.what) > 1 and NAME not in out_name:
                raise UsageError(
                    f"--out {out_name}: is one file, for {len(self.what)} scans; put {NAME} where the scan's name "
                    f"belongs, for example --out '{path.with_name(f'{path.stem}-{NAME}{path.suffix}')}'"
                )
            for word in self.what:
                name, work = self._work(options, word, meshed, suffix)
                out = Path(out_name.replace(NAME, name))
                check_writable(out)
                if out in works:
                    raise UsageError(
                        f"{word_by_file[out]} and {word}: both would be written to {out}; make them in two calls"
                    )
                works[out], word_by_file[out] = work, word
        return works

    def _work(self, options: ScanOptions, word: str, meshed: bool, suffix: str) -> tuple[str, _Work]:
        """Return the name of the scan in ``word``, and the function that makes its file.

        Raises UsageError, UnknownScan, ScanError.
        """
        from appliance.store import IncompleteRecording

        if word.startswith(INCOMPLETE):
            folders = [IncompleteRecording.find(library_root(options), word.removeprefix(INCOMPLETE))]
        else:
            # A folder's name may contain a plus.
            folders = [find_scan(options, part) for part in ((word,) if Path(word).is_dir() else word.split("+"))]
        broken = IncompleteRecording.is_in(folders[0])
        own_form = suffix == OWN and not (meshed or self.normals)
        if (broken or len(folders) > 1) and not own_form:
            raise UsageError(f"{word}: its cloud is written as {OWN}, in the instrument's own form")
        name = "+".join(folder.name for folder in folders)
        if len(folders) > 2:
            raise UsageError(f"{name}: has more than two scans; one cloud is made from two at most")

        def work(out: Path, progress: ProgressLine) -> dict[str, Any]:
            from appliance.desk import write_cloud

            report = write_cloud(folders, out, options, progress, own_form=own_form, mesh=meshed)
            if report.get("salvaged"):
                log.warning("%s: salvaged, do not measure in it: %s", folders[0], "; ".join(report["salvaged"]))
            return report

        return f"incomplete-{name}" if broken else name, work

    # ------------------------------------------------------------------------------------- objects

    def _of_object(self, options: ScanOptions, name: str) -> Exit:
        outs = [Path(out) for out in self.out or (f"{name}{OWN}",)]
        self._check_files(outs)
        root, solved = self.solved(options, name)
        compile_kernels()
        from appliance.desk import ObjectFiles

        with ProgressLine() as progress:
            files = ObjectFiles(root, solved, options, progress, self.spacing, self.close_holes or 0.0)
            for out in outs:
                write = files.prepare(out, mesh=self.mesh, single_scans=self.single_scans)
                with writing(out):
                    write()
        self.tell({"object": solved.name, "files": [str(out) for out in outs]}, map(str, outs))
        return Exit.OK

    def _check_files(self, outs: Sequence[Path]) -> None:
        """Raise UsageError or MissingLibraryError for a file that cannot be written, before minutes of work."""
        from appliance.base import require
        from appliance.desk import has_triangles

        for out in outs:
            if out.suffix.lower() == PAGE:
                raise UsageError(f"--out {out}: a page is made by `kingfisher report object:NAME`")
            check_writable_as(out, "an object")
        # An option without effect is probably a mistake.
        meshes = any(has_triangles(out, self.mesh) for out in outs)
        if meshes:
            require("skimage.measure", "scikit-image", "the mesh of an object")
        for is_given, text in (
            (self.mesh, "--mesh: is for .ply files"),
            (self.close_holes is not None, "--close-holes: is for meshes"),
        ):
            if is_given and not meshes:
                raise UsageError(f"{text}, and none is written; give --out FILE.ply --mesh, or --out FILE.stl")
        if self.single_scans and not any(out.suffix.lower() == POSED for out in outs):
            raise UsageError("--scans: is for .e57 files, and none is written; give --out FILE.e57")


_Work = Callable[[Path, ProgressLine], dict[str, Any]]
"""Function that writes a file and returns its report."""
