"""The verbs ``object add``, ``show`` and ``solve``: many scans as one object."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from appliance.base import use_one_blas_thread
from appliance.cli.arguments import operand, operands, option, switch, whole_number
from appliance.cli.desk import find_scan, library_root
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError, complain
from appliance.cli.places import WithCalibration, WithRoot

if TYPE_CHECKING:
    from appliance.desk import Places, StoredObject

LEAST_SCANS = 2
"""Least number of scans with a pose in a solved object."""
_NAME = "the object's name; a folder objects/NAME is made under the storage root"
_TAKEN_AS = "also all scans that the instrument took as object N; those already in the object are left out"


@dataclass(frozen=True, slots=True, kw_only=True)
class AddToObject(WithRoot):
    """Add scans to an object, which is made if it does not exist; without scans an empty one is made."""

    name: str = operand("NAME", _NAME)
    scans: tuple[str, ...] = operands(
        "SCAN", "their numbers or folders, in the order they were taken", at_least_one=False
    )
    taken_as: int | None = option("--taken-as", _TAKEN_AS, parse=whole_number(1, 999_999), metavar="N")

    def run(self) -> Exit:
        from appliance.desk import object_exists

        root = library_root(self.scan_options())
        new = not object_exists(root, self.name)
        if not new and not self.scans and self.taken_as is None:
            raise UsageError("SCAN is missing; give numbers or folders of scans, or --taken-as N")
        added = _add_scans(self, root)
        # Reported, because a mistyped name makes a new object.
        self.tell(_document(added), [*([f"new object under {root}"] if new else []), *_lines(added)])
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowObject(WithRoot):
    """Show the scan poses of an object, their uncertainty and the rejected pairs; without NAME list all objects."""

    kernels: ClassVar[bool] = False

    name: str | None = operand("NAME", _NAME, optional=True)

    def run(self) -> Exit:
        from appliance.desk import object_names, read_object

        root = library_root(self.scan_options())
        if self.name is None:
            names = object_names(root)
            self.tell(
                {"objects": names}, names or [f"no objects under {root}; make one: kingfisher object add NAME SCAN..."]
            )
        else:
            stored = read_object(root, self.name)
            self.tell(_document(stored), _lines(stored))
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveObject(WithCalibration):
    """Find the pose of every scan of an object relative to the first, or why it is left out.

    `kingfisher cloud object:NAME` writes files.
    """

    codes: ClassVar[Sequence[Exit]] = (Exit.LEFT_OUT,)

    name: str = operand("NAME", _NAME)
    scans: tuple[str, ...] = operands(
        "SCAN", "scans to add first; the object is made if it is not there", at_least_one=False
    )
    taken_as: int | None = option("--taken-as", _TAKEN_AS, parse=whole_number(1, 999_999), metavar="N")
    with_estimate: bool = switch(
        "--with-estimate",
        "remove from the points the shared depth error that the overlaps show",
    )

    def run(self) -> Exit:
        use_one_blas_thread(os.environ)
        options = self.scan_options()
        from appliance.desk import read_object

        root = library_root(options)
        has_scans = self.scans or self.taken_as is not None
        stored = _add_scans(self, root) if has_scans else read_object(root, self.name)
        compile_kernels()
        from appliance.desk import solve_object, tell_health
        from appliance.store import StorageError

        with ProgressLine() as progress:
            solved = solve_object(root, stored, options, progress, with_shared_error=self.with_estimate)
        try:
            tell_health(root, solved)
        except StorageError as error:
            # The object is solved and stored; solving it again writes the calibration's health.
            complain(f"not written to the calibration's health: {error}", as_json=self.json)
        self.tell(_document(solved), _lines(solved))
        placed = 0 if solved.places is None else len(solved.places.places)
        if placed < LEAST_SCANS:
            return Exit.FAILED
        # A calling program must notice scans without a pose.
        return Exit.OK if placed == len(solved.scans) else Exit.LEFT_OUT


def _add_scans(verb: AddToObject | SolveObject, root: Path) -> StoredObject:
    """Return the object with the verb's scans added; it is made if it does not exist.

    Scans are those named, and those of the instrument's object ``taken_as`` that it lacks. Raises UsageError,
    ScanError, ObjectError.
    """
    # All folders are found before the first byte is read.
    named_scans = [find_scan(verb.scan_options(), scan) for scan in verb.scans]
    taken_scans = [find_scan(verb.scan_options(), scan) for scan in _taken_as(root, verb.taken_as)]
    from appliance.desk import add_to_object

    return add_to_object(root, verb.name, named_scans, taken_scans)


def _taken_as(root: Path, number: int | None) -> Sequence[str]:
    """Return the scans of the object that the diver began as ``number``. Raises UsageError for an unknown one."""
    if number is None:
        return ()
    from appliance.store import Library

    library = Library(root)
    scans = library.scans_of_object(number)
    if not scans:
        numbers = ", ".join(str(item) for item in library.objects()) or "none; name the scans instead"
        raise UsageError(f"--taken-as {number}: no scan under {root} has this object; there are {numbers}")
    return scans


def _document(stored: StoredObject) -> Any:
    from pydantic import TypeAdapter

    from appliance.desk import StoredObject as Kind

    # Without the joint covariance: it is for programs that compute lengths (import kingfisher), and megabytes of text.
    return TypeAdapter(Kind).dump_python(stored, mode="json", exclude={"places": {"joint"}})


def _lines(stored: StoredObject) -> list[str]:
    begin = f"object {stored.name}: {len(stored.scans)} scans"
    if stored.places is not None:
        return [begin, *lines_of(stored.places)]
    return [
        begin,
        "not solved yet: kingfisher object solve",
        *(f"  {scan.name:<10} {scan.folder}" for scan in stored.scans),
    ]


def lines_of(places: Places) -> list[str]:
    """Return a solution for people: scan poses, rejected pairs, warnings and the depth error."""
    lines = [
        f"{'centre of':<10} {'x':>9} {'y':>9} {'z mm':>9} {'± mm':>7}   bending, part of ±, mm (with --with-estimate)"
    ]
    for name, place in places.places.items():
        x, y, z = place.middle_mm
        lines.append(
            f"{name:<10} {x:9.2f} {y:9.2f} {z:9.2f} {place.sigma_mm:7.3f}   {place.bending_mm:.3f} "
            f"({place.bending_aided_mm:.3f})"
        )
    lines += [f"{name:<10} left out: {why}" for name, why in places.left_out.items()]
    used = [pair for pair in places.pairs if pair.used]
    unchecked = sum(pair.discrepancy_mm is None for pair in used)
    lines.append(
        f"{len(used)} of {len(places.pairs)} pairs used" + (f", {unchecked} of them unchecked" if unchecked else "")
    )
    lines += [f"  {pair.first} - {pair.second}: overlap –; {pair.text}" for pair in places.pairs if not pair.used]
    lines += [f"warning: {text}" for text in places.warnings]
    if places.shared_error_score is not None:
        from appliance.calibrate import OVERLAP_LIMIT

        lines.append(
            f"overlaps and calibration agree: depth error {places.shared_error_score:.1f} times the stated one"
            if places.shared_error_score <= OVERLAP_LIMIT
            else f"warning: the overlaps show a depth error of {places.shared_error_score:.1f} times the stated "
            "one: calibrate "
            "again, or check the calibration with the ball bar"
        )
    lines.append(
        f"standard deviation of the shared depth error: {1000.0 * places.shared_error_spread_mm:.0f} µm, "
        f"{1000.0 * places.shared_error_aided_mm:.0f} µm with the estimate from the overlaps, which is "
        f"{'removed from the points' if places.shared_error_removed else 'not used (--with-estimate)'}"
    )
    return lines
