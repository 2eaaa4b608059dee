"""The verb ``cloud``: files of points or triangles, of stored scans, of recordings that broke, and of objects."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    from appliance.desk import PlacedGrid, StoredObject
    from appliance.store import Wish

NAME = "{}"
"""Stands for the scan's name in ``--out``."""
INCOMPLETE = "incomplete:"
"""Prefix that tells the number of a recording that broke from that of a scan."""
OWN, GRIDS, POSED, PAGE = ".ply", ".npz", ".e57", ".html"
log = logging.getLogger(__name__)


def _triangles() -> tuple[str, ...]:
    """Return the suffixes that only meshes have."""
    from appliance.desk import MESH_SUFFIXES, SCAN_SUFFIXES

    return tuple(suffix for suffix in MESH_SUFFIXES if suffix not in SCAN_SUFFIXES)


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

    def _of_scans(self, wish: Wish) -> Exit:
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
                    reports.append(work(out, wish, progress))
        if len(reports) == 1:
            self.tell(reports[0])
        elif self.json:
            self.tell(reports)
        else:
            for report in reports:
                self.tell(report)
        return Exit.DAMAGED if any(report.get("salvaged") for report in reports) else Exit.OK

    def _works(self, wish: Wish) -> Mapping[Path, _Work]:
        """Return what is to be done for each file. Raises UsageError, UnknownScan, ScanError before any work."""
        from appliance.desk import MESH_SUFFIXES, SCAN_SUFFIXES

        works: dict[Path, _Work] = {}
        words: dict[Path, str] = {}
        for wanted in self.out or (f"{NAME}{OWN}",):
            path = Path(wanted)
            suffix = path.suffix.lower()
            meshed = suffix in _triangles() or self.mesh
            allowed, kind = (MESH_SUFFIXES, "a mesh") if meshed else ((*SCAN_SUFFIXES, *_triangles()), "a scan")
            # The folder, too, may have the scan's name in it.
            writable_as(path, allowed, kind) if NAME not in wanted else checked_as(path, allowed, kind)
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

    def _work(self, wish: Wish, word: str, meshed: bool, suffix: str) -> tuple[str, _Work]:
        """Return the name of what ``word`` means and how its file is made. Raises UsageError, UnknownScan,
        ScanError."""
        from appliance.store import INCOMPLETE_MANIFEST_FILE, find_incomplete

        if word.startswith(INCOMPLETE):
            folders = [find_incomplete(library_root(wish), word.removeprefix(INCOMPLETE))]
        else:
            # A folder's name may have a plus, too.
            folders = [scan_in(wish, one) for one in ((word,) if Path(word).is_dir() else word.split("+"))]
        broken = (folders[0] / INCOMPLETE_MANIFEST_FILE).is_file()
        own = suffix == OWN and not (meshed or self.normals)
        if (broken or len(folders) > 1) and not own:
            raise UsageError(f"{word}: its cloud is written as {OWN}, in the instrument's own form")
        if broken:
            return f"incomplete-{folders[0].name}", lambda out, wish, progress: _rescued(
                folders[0], out, wish, progress
            )
        if len(folders) > 1:
            name = "+".join(folder.name for folder in folders)
            return name, lambda out, wish, progress: _merged(folders, out, wish, progress)
        if own:
            return folders[0].name, lambda out, wish, progress: _own(folders[0], out, wish, progress)
        return folders[0].name, lambda out, wish, progress: _exported(folders[0], out, wish, progress, meshed)

    # ------------------------------------------------------------------------------------- objects

    def _of_object(self, wish: Wish, name: str) -> Exit:
        outs = [Path(out) for out in self.out or (f"{name}{OWN}",)]
        self._check_files(outs)
        root, solved = self.solved(wish, name)
        compile_kernels()
        self._write(root, solved, wish, outs)
        self.tell({"object": solved.name, "files": [str(out) for out in outs]}, map(str, outs))
        return Exit.OK

    def _check_files(self, outs: Sequence[Path]) -> None:
        """Raises UsageError for a file that cannot be written, and MissingLibraryError, before minutes of work."""
        from appliance.base import require
        from appliance.desk import SURFACE_SUFFIXES

        for out in outs:
            if out.suffix.lower() == PAGE:
                raise UsageError(f"--out {out}: a page is made by `kingfisher report object:NAME`")
            writable_as(out, (*SURFACE_SUFFIXES, *_triangles(), GRIDS), "an object")
        # An option that would do nothing is a word that was meant otherwise.
        meshes = any(map(self._meshed, outs))
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

    def _write(self, root: Path, solved: StoredObject, wish: Wish, outs: Sequence[Path]) -> None:
        """Write the files of a solved object; the surface and its mesh are made once, when they are first wanted.
        Raises StorageError, ScanError."""
        from appliance.desk import (
            VOXEL_MM,
            about_object,
            mesh_of_surface,
            surface_of,
            write_mesh,
            write_placed,
            write_surface,
        )

        with ProgressLine() as progress:
            surface = mesh = None
            for out in outs:
                if out.suffix.lower() == GRIDS or (self.single_scans and out.suffix.lower() == POSED):
                    with writing(out):
                        write_placed(out, _grids(root, solved, wish, progress), about_object(solved))
                    continue
                surface = surface_of(root, solved, wish, progress, self.spacing) if surface is None else surface
                progress(f"writing {out.name}")
                if self._meshed(out) and mesh is None:
                    # It takes as long as everything before.
                    mesh = mesh_of_surface(surface, max(VOXEL_MM, 2.0 * self.spacing), self.close_holes or 0.0)
                with writing(out):
                    if mesh is not None and self._meshed(out):
                        write_mesh(out, mesh, about_object(solved))
                    else:
                        write_surface(out, surface, about_object(solved))

    def _meshed(self, out: Path) -> bool:
        return out.suffix.lower() in _triangles() or (self.mesh and out.suffix.lower() == OWN)


_Work = Callable[[Path, "Wish", ProgressLine], dict[str, Any]]
"""Makes a file and returns the report of it."""


def _own(folder: Path, out: Path, wish: Wish, progress: ProgressLine) -> dict[str, Any]:
    """Make the instrument's own form, whose head says which damaged frame was made up."""
    from appliance.desk import reconstruct_scan, salvage
    from appliance.store import calibration_for, open_source

    salvaged = salvage(folder)
    source = open_source(folder, wish, salvaged.scan)
    report = reconstruct_scan(source, calibration_for(source, wish), out, progress, salvaged)
    if salvaged.notes:
        log.warning("%s: salvaged, not to be measured in: %s", folder, "; ".join(salvaged.notes))
    return report


def _exported(folder: Path, out: Path, wish: Wish, progress: ProgressLine, meshed: bool) -> dict[str, Any]:
    from appliance.desk import export_scan
    from appliance.store import calibration_for, open_source, refuse_damaged_frames

    refuse_damaged_frames(folder)
    source = open_source(folder, wish)
    return export_scan(source, calibration_for(source, wish), out, progress, mesh=meshed)


def _merged(folders: Sequence[Path], out: Path, wish: Wish, progress: ProgressLine) -> dict[str, Any]:
    from appliance.desk import merge_scans
    from appliance.store import instrument_of, one_calibration, open_source, refuse_damaged_frames

    if len(folders) > 2:
        raise UsageError(f"{'+'.join(folder.name for folder in folders)}: one cloud is made of two scans at most")
    for folder in folders:
        refuse_damaged_frames(folder)
    sources = (open_source(folders[0], wish), open_source(folders[1], wish))
    instrument_of(sources, wish)  # refuses two
    return merge_scans(sources, one_calibration(sources, wish), out, progress)


def _rescued(folder: Path, out: Path, wish: Wish, progress: ProgressLine) -> dict[str, Any]:
    from appliance.desk import rescue_recording
    from appliance.store import calibration_for, load_incomplete, open_source

    recording = load_incomplete(folder)
    source = open_source(folder, wish, recording.scan)
    return rescue_recording(recording, source, calibration_for(source, wish), out, progress)


def _grids(root: Path, solved: StoredObject, wish: Wish, progress: ProgressLine) -> Iterator[PlacedGrid]:
    """Yield the scans that have a place, one at a time."""
    import numpy as np

    from appliance.desk import PlacedGrid, placed_scans

    places = {} if solved.places is None else solved.places.places
    for (name, place), scan in zip(places.items(), placed_scans(root, solved, wish, progress), strict=True):
        yield PlacedGrid(
            name, scan.cloud, scan.rotation, scan.translation_mm, np.array(place.covariance), np.array(place.middle_mm)
        )
