"""Owns the verbs of an object: many scans that become one thing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import number, operand, operands, option, repeated, switch
from appliance.cli.desk import library_root, measuring, scan_in, writable, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, Progress, UsageError, say, say_json
from appliance.cli.places import WithCalibration, WithRoot

if TYPE_CHECKING:
    from appliance.offline.origin import Wish
    from appliance.storage.objects import MemberScan, Places, StoredObject
    from appliance.surface.mesh import Mesh

PAGE, TRIANGLES = ".html", (".stl", ".obj")
SPACING_MM = 0.3
"""Distance of an object's points: that of a scan's in the middle of the volume is 0.16."""
_NAME = "the object's name; a folder objects/NAME is made under the storage root"


@dataclass(frozen=True, slots=True, kw_only=True)
class NewObject(WithRoot):
    """A new object, of no or some scans."""

    name: str = operand("NAME", _NAME)
    scans: tuple[str, ...] = operands(
        "SCAN", "their numbers or folders, in the order they were taken", at_least_one=False
    )

    def run(self) -> Exit:
        from appliance.storage import objects
        from appliance.storage.objects import StoredObject, folder_of, with_scans

        root = library_root(self.wish())
        if folder_of(root, self.name).exists():
            raise UsageError(f"object '{self.name}': there is one under {root}; add to it with `kingfisher object add`")
        made = with_scans(StoredObject(self.name), _members(self, root, self.scans))
        objects.write(root, made)
        _say_object(made, as_json=self.json)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class AddToObject(WithRoot):
    """More scans for an object."""

    name: str = operand("NAME", _NAME)
    scans: tuple[str, ...] = operands("SCAN", "their numbers or folders", at_least_one=True)

    def run(self) -> Exit:
        from appliance.storage import objects

        root = library_root(self.wish())
        added = objects.with_scans(objects.read(root, self.name), _members(self, root, self.scans))
        objects.write(root, added)
        _say_object(added, as_json=self.json)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowObject(WithRoot):
    """Show where the scans of an object lie, how certain that is, and what was refused; without NAME list all objects."""

    name: str | None = operand("NAME", _NAME, optional=True)

    def run(self) -> Exit:
        from appliance.storage import objects

        root = library_root(self.wish())
        if self.name is None:
            found = objects.names(root)
            if self.json:
                say_json({"objects": found})
            else:
                for one in found:
                    say(one)
                if not found:
                    say(f"no objects under {root}; make one: kingfisher object new NAME SCAN...")
            return Exit.OK
        _say_object(objects.read(root, self.name), as_json=self.json)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveObject(WithCalibration):
    """Find where every scan of an object lies relative to the first, or why it is left out."""

    name: str = operand("NAME", _NAME)
    scans: tuple[str, ...] = operands(
        "SCAN", "scans to add first; the object is made if it is not there", at_least_one=False
    )
    out: tuple[str, ...] = repeated(
        "--out",
        "one surface of all scans as points (.ply .e57 .las) or mesh (.stl .obj), or a page about it (.html); may be repeated",
        metavar="FILE",
    )
    spacing: float = option(
        "--spacing", "mm between its points (0.3)", default=SPACING_MM, parse=number(0.02, 20.0, "mm"), metavar="MM"
    )
    without_estimate: bool = switch(
        "--without-estimate",
        "take the depth error that all scans share for zero instead of estimating it from their overlaps",
    )

    def run(self) -> Exit:
        wish = self.wish()
        measuring(wish.calibration)
        outs = _writable([Path(one) for one in self.out])
        from appliance.storage import objects
        from appliance.storage.objects import StoredObject, folder_of, with_scans

        root = library_root(wish)
        found = (
            StoredObject(self.name)
            if self.scans and not folder_of(root, self.name).exists()
            else objects.read(root, self.name)
        )
        if self.scans:
            found = with_scans(found, _members(self, root, self.scans))
            objects.write(root, found)
        compile_kernels()
        from appliance.offline.objects import solve_object

        with Progress() as progress:
            solved = solve_object(root, found, wish, progress, with_shared_error=not self.without_estimate)
        objects.write(root, solved)
        placed = solved.places is not None and len(solved.places.places) >= 2
        if placed:
            _write(root, solved, wish, outs, self.spacing)
        _say_object(solved, as_json=self.json)
        # Nothing is lost where a scan is left out, but whoever calls this from a program must notice.
        return Exit.OK if placed else Exit.FAILED


def _writable(outs: Sequence[Path]) -> Sequence[Path]:
    """Return ``outs``. Raises UsageError for a file that cannot be written, before minutes of work."""
    from appliance.export.content import ExportError
    from appliance.export.files import SURFACE_SUFFIXES, checked_suffix, require_library
    from appliance.surface.libraries import needed

    for out in outs:
        writable(out)
        try:
            checked_suffix(out, (*SURFACE_SUFFIXES, *TRIANGLES, PAGE), "an object")
        except ExportError as error:
            raise UsageError(f"--out {error}") from error
        require_library(out)
        if out.suffix.lower() in TRIANGLES:
            needed("skimage.measure", "scikit-image", "the mesh of an object")
    return outs


def _write(root: Path, solved: StoredObject, wish: Wish, outs: Sequence[Path], spacing_mm: float) -> None:
    if not outs:
        return
    from appliance.export.files import write_mesh, write_surface
    from appliance.offline.object_report import report_of
    from appliance.offline.objects import about_object, surface_of
    from appliance.report.page import write_report
    from appliance.surface.object_mesh import VOXEL_MM, mesh_of_surface

    with Progress() as progress:
        surface = surface_of(root, solved, wish, progress, spacing_mm)
        mesh: Mesh | None = None
        for out in outs:
            progress(f"writing {out.name}")
            with writing(out):
                if out.suffix.lower() == PAGE:
                    write_report(out, report_of(solved, surface))
                elif out.suffix.lower() in TRIANGLES:
                    # Made when it is first wanted: it takes as long as everything before.
                    mesh = mesh_of_surface(surface, max(VOXEL_MM, 2.0 * spacing_mm)) if mesh is None else mesh
                    write_mesh(out, mesh, about_object(solved))
                else:
                    write_surface(out, surface, about_object(solved))


def _members(verb: WithRoot, root: Path, scans: Sequence[str]) -> tuple[MemberScan, ...]:
    from appliance.offline.objects import member_of
    from appliance.storage.damage import refuse_damaged_frames

    found = []
    for scan in scans:
        folder = scan_in(verb.wish(), scan)
        refuse_damaged_frames(folder)
        found.append(member_of(root, folder))
    return tuple(found)


def _say_object(stored: StoredObject, *, as_json: bool) -> None:
    if as_json:
        from pydantic import TypeAdapter

        from appliance.storage.objects import StoredObject as Kind

        say_json(TypeAdapter(Kind).dump_python(stored, mode="json"))
        return
    say(f"object {stored.name}: {len(stored.scans)} scans")
    if stored.places is None:
        say("not solved yet: kingfisher object solve")
        for one in stored.scans:
            say(f"  {one.name:<10} {one.folder}")
        return
    for line in lines_of(stored.places):
        say(line)


def lines_of(places: Places) -> list[str]:
    """Return what solving found, for people: places, then pairs that were refused, then warnings and the bending budget."""
    lines = [
        f"{'middle of':<10} {'x':>9} {'y':>9} {'z mm':>9} {'± mm':>7}   of it what may bend, mm (without the estimate)"
    ]
    for name, place in places.places.items():
        x, y, z = place.middle_mm
        lines.append(
            f"{name:<10} {x:9.2f} {y:9.2f} {z:9.2f} {place.sigma_mm:7.3f}   {place.bending_mm:.3f} ({place.bending_unaided_mm:.3f})"
        )
    lines += [f"{name:<10} left out: {why}" for name, why in places.left_out.items()]
    used = [pair for pair in places.pairs if pair.used]
    lines.append(f"{len(used)} of {len(places.pairs)} pairs used")
    lines += [f"  {pair.first} - {pair.second}: {pair.text}" for pair in places.pairs if not pair.used]
    lines += [f"warning: {one}" for one in places.warnings]
    error = ", ".join(f"{1000.0 * value:.0f}" for value in places.shared_error_mm)
    lines.append(
        f"depth error that all scans share, µm: {error}; {'taken out of the points' if places.shared_error_removed else 'not taken out'}"
    )
    return lines
