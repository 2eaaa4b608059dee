"""The verb ``cloud``: files of points or triangles, of stored scans, of recordings that broke, and of objects."""

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
    checked_as,
    library_root,
    object_named,
    scan_in,
    writable,
    writable_as,
    writing,
)
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError

if TYPE_CHECKING:
    from appliance.store import ScanOptions

NAME = "{}"
"""Stands for the scan's name in ``--out``."""
INCOMPLETE = "incomplete:"
"""Prefix that tells the number of a recording that broke from that of a scan."""
OWN, POSED, PAGE = ".ply", ".e57", ".html"
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeCloud(WithObjects):
    """Make points or meshes of stored scans from their raw frames, or of a solved object one surface.

    What is made of a damaged scan says so in the file, on stderr and by the exit code; it is not to be measured in.
    """

    codes: ClassVar[Sequence[Exit]] = (Exit.DAMAGED,)

    what: Sequence[str] = operands(
        "WHAT",
        "scans, by numbers or folders; SCAN+SCAN: one cloud of two exposures from the same place; incomplete:N: an "
        "unchecked cloud of a recording that broke after its first direction; object:NAME",
        at_least_one=True,
    )
    out: tuple[str, ...] = repeated(
        "--out",
        "points: .ply .e57 .las, on the pixel grid .npz; meshes: .stl .obj; may be repeated; {} stands for the scan's "
        "name, and must where there are many (default: {}.ply)",
        metavar="FILE",
    )
    mesh: bool = switch("--mesh", "triangles instead of points in .ply files")
    normals: bool = switch(
        "--normals", "normals, and grey as colour, in .ply files of scans, instead of the instrument's own form"
    )
    single_scans: bool = switch(
        "--scans", "an object's single scans in .e57 files, each with its pose, instead of one surface of all"
    )
    close_holes: float | None = option(
        "--close-holes",
        "close holes of an object's mesh that are no wider; what is filled in was not measured, and has no sigma",
        parse=number(0.1, 1000.0, "mm"),
        metavar="MM",
    )

    def run(self) -> Exit:
        wish = self.wish()
        name = next((name for name in map(object_named, self.what) if name is not None), None)
        if name is None:
            return self._of_scans(wish)
        if len(self.what) > 1 or self.normals:
            raise UsageError(f"object:{name}: has files of its own, without --normals; give it alone")
        return self._of_object(wish, name)

    # ------------------------------------------------------------------------------------- scans

    def _of_scans(self, wish: ScanOptions) -> Exit:
        of_objects = {
            "--spacing": self.spacing != SPACING_MM,
            "--scans": self.single_scans,
            "--close-holes": self.close_holes is not None,
        }
        for flag, given in of_objects.items():
            if given:
                raise UsageError(f"{flag}: is for objects; give object:NAME")
        works = self._works(wish)
        reports: list[dict[str, Any]] = []
        with ProgressLine() as progress:
            compile_kernels()
            for k, (out, work) in enumerate(works.items(), 1):
                progress(f"comparing checksums ({k} of {len(works)})")
                # The name that the cloud gets without --out, too, so that an error speaks of that file.
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

    def _works(self, wish: ScanOptions) -> Mapping[Path, _Work]:
        """Return what is to be done for each file. Raises UsageError, UnknownScan, ScanError before any work."""
        from appliance.desk import has_triangles

        works: dict[Path, _Work] = {}
        words: dict[Path, str] = {}
        for wanted in self.out or (f"{NAME}{OWN}",):
            path = Path(wanted)
            suffix = path.suffix.lower()
            meshed = has_triangles(path) or self.mesh
            kind = "a mesh" if meshed else "a scan"
            # The folder, too, may have the scan's name in it.
            writable_as(path, kind) if NAME not in wanted else checked_as(path, kind)
            if len(self.what) > 1 and NAME not in wanted:
                raise UsageError(
                    f"--out {wanted}: is one file, for {len(self.what)} scans; put {NAME} where the scan's name "
                    f"belongs, for example --out '{path.with_name(f'{path.stem}-{NAME}{path.suffix}')}'"
                )
            for word in self.what:
                name, work = self._work(wish, word, meshed, suffix)
                out = Path(wanted.replace(NAME, name))
                writable(out)
                if out in works:
                    raise UsageError(f"{words[out]} and {word}: both would be written to {out}; make them one by one")
                works[out], words[out] = work, word
        return works

    def _work(self, wish: ScanOptions, word: str, meshed: bool, suffix: str) -> tuple[str, _Work]:
        """Return the name of what ``word`` means and how its file is made. Raises UsageError, UnknownScan,
        ScanError."""
        from appliance.store import IncompleteRecording

        if word.startswith(INCOMPLETE):
            folders = [IncompleteRecording.find(library_root(wish), word.removeprefix(INCOMPLETE))]
        else:
            # A folder's name may have a plus, too.
            folders = [scan_in(wish, one) for one in ((word,) if Path(word).is_dir() else word.split("+"))]
        broken = IncompleteRecording.is_in(folders[0])
        own = suffix == OWN and not (meshed or self.normals)
        if (broken or len(folders) > 1) and not own:
            raise UsageError(f"{word}: its cloud is written as {OWN}, in the instrument's own form")
        name = "+".join(folder.name for folder in folders)
        if len(folders) > 2:
            raise UsageError(f"{name}: one cloud is made of two scans at most")

        def work(out: Path, progress: ProgressLine) -> dict[str, Any]:
            from appliance.desk import write_cloud

            report = write_cloud(folders, out, wish, progress, own=own, mesh=meshed)
            if report.get("salvaged"):
                log.warning("%s: salvaged, not to be measured in: %s", folders[0], "; ".join(report["salvaged"]))
            return report

        return f"incomplete-{name}" if broken else name, work

    # ------------------------------------------------------------------------------------- objects

    def _of_object(self, wish: ScanOptions, name: str) -> Exit:
        outs = [Path(out) for out in self.out or (f"{name}{OWN}",)]
        self._check_files(outs)
        root, solved = self.solved(wish, name)
        compile_kernels()
        from appliance.desk import ObjectFiles

        with ProgressLine() as progress:
            files = ObjectFiles(root, solved, wish, progress, self.spacing, self.close_holes or 0.0)
            for out in outs:
                write = files.prepare(out, mesh=self.mesh, single_scans=self.single_scans)
                with writing(out):
                    write()
        self.tell({"object": solved.name, "files": [str(out) for out in outs]}, map(str, outs))
        return Exit.OK

    def _check_files(self, outs: Sequence[Path]) -> None:
        """Raises UsageError for a file that cannot be written, and MissingLibraryError, before minutes of work."""
        from appliance.base import require
        from appliance.desk import has_triangles

        for out in outs:
            if out.suffix.lower() == PAGE:
                raise UsageError(f"--out {out}: a page is made by `kingfisher report object:NAME`")
            writable_as(out, "an object")
        # An option that would do nothing is a word that was meant otherwise.
        meshes = any(has_triangles(out, self.mesh) for out in outs)
        if meshes:
            require("skimage.measure", "scikit-image", "the mesh of an object")
        for given, what in (
            (self.mesh, "--mesh: is for .ply files"),
            (self.close_holes is not None, "--close-holes: is for meshes"),
        ):
            if given and not meshes:
                raise UsageError(f"{what}, and none is written; give --out FILE.ply --mesh, or --out FILE.stl")
        if self.single_scans and not any(out.suffix.lower() == POSED for out in outs):
            raise UsageError("--scans: is for .e57 files, and none is written; give --out FILE.e57")


_Work = Callable[[Path, ProgressLine], dict[str, Any]]
"""Makes a file and returns the report of it."""
