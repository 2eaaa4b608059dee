"""Owns the verbs ``archive pack``, ``verify``, ``unpack`` and ``frame``: scans kept in a third of the room, and had again byte for byte."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from appliance.cli.arguments import Verb, operand, operands, option, switch
from appliance.cli.desk import writable, writing
from appliance.cli.output import Exit, Progress, UsageError, say, say_json
from appliance.cli.places import scan_folder
from appliance.measure import SIDES
from appliance.store import (
    BesideFile,
    Copied,
    Library,
    LibraryFolder,
    LocalFileSystem,
    ScanError,
    copy_beside,
    finish_removals,
    hold_lock,
    make_folders,
    make_shelves,
    manifest_of,
    pack_scan,
    problems_of,
    read_frame,
    remove_source,
    replace_file,
    scan_folders,
    unpack_scan,
)

MB = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class PackArchive(Verb):
    """Pack every scan of a storage root into an archive; FAILED if one could not be, after all others were."""

    kernels: ClassVar[bool] = False

    source: Path = operand("SOURCE", "storage root with the scans", parse=Path)
    out: Path | None = option("--out", "the archive, made where it is not there", parse=Path, metavar="ARCHIVE")
    all: bool = switch("--all", "also the rejected ones")
    remove: bool = switch("--remove", "remove each scan from SOURCE once its packed copy was compared with it")

    def run(self) -> Exit:
        """Raises UsageError, StorageError, MissingLibraryError."""
        source, archive = _root("SOURCE", self.source), _target(self.out, self.source)
        shelves = _shelves(every=self.all)
        fs = LocalFileSystem()
        make_folders(fs, archive)
        with ExitStack() as held:
            held.enter_context(hold_lock(archive))
            make_shelves(fs, archive, shelves)
            left: dict[str, str] = {}
            if self.remove:
                # No instrument may write there meanwhile; without removals it may, since only finished scans are read.
                held.enter_context(hold_lock(source))
                left = finish_removals(fs, source, shelves)
            different = copy_beside(fs, source, archive)

            def pack(folder: Path) -> Copied:
                target = archive / folder.parent.name / folder.name
                done = pack_scan(fs, folder, target)
                if self.remove:
                    remove_source(fs, folder, target)
                return done

            told = _Told(different, left, as_json=self.json)
            return _each(scan_folders(source, shelves), "packing", pack, archive, told)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnpackArchive(Verb):
    """Bring scans of an archive back, byte for byte as they were; FAILED if one could not be, after all others were."""

    kernels: ClassVar[bool] = False

    archive: Path = operand("ARCHIVE", "storage root with packed scans", parse=Path)
    scans: Sequence[str] = operands("SCAN", "numbers (default: all)", at_least_one=False)
    out: Path | None = option("--out", "storage root, made where it is not there", parse=Path, metavar="ROOT")

    def run(self) -> Exit:
        """Raises UsageError, UnknownScan, StorageError, MissingLibraryError."""
        archive, out = _root("ARCHIVE", self.archive), _target(self.out, self.archive)
        shelves, fs = _shelves(every=True), LocalFileSystem()
        folders = _wanted(archive, self.scans)
        make_folders(fs, out)
        with hold_lock(out):
            make_shelves(fs, out, shelves)
            different = copy_beside(fs, archive, out)

            def unpack(folder: Path) -> Copied:
                return unpack_scan(fs, folder, out / folder.parent.name / folder.name)

            return _each(folders, "unpacking", unpack, out, _Told(different, {}, as_json=self.json))


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyArchive(Verb):
    """Decode every frame and compare it with the checksum of before it was packed; DAMAGED if any does not fit."""

    kernels: ClassVar[bool] = False
    codes: ClassVar[Sequence[Exit]] = (Exit.DAMAGED,)

    archive: Path = operand("ARCHIVE", "storage root, packed or not", parse=Path)
    scans: Sequence[str] = operands("SCAN", "numbers (default: all)", at_least_one=False)

    def run(self) -> Exit:
        """Raises UsageError, UnknownScan, MissingLibraryError."""
        folders = _wanted(_root("ARCHIVE", self.archive), self.scans)
        found: list[dict[str, Any]] = []
        with Progress() as progress:
            for k, folder in enumerate(folders):
                progress(f"decoding {folder.name}", k / len(folders))
                try:
                    problems = [f"{name}: {what}" for name, what in sorted(problems_of(folder).items())]
                except ScanError as error:
                    problems = [str(error)]
                found.append({"scan": folder.name, "shelf": folder.parent.name, "problems": problems})
        damaged = sum(1 for one in found if one["problems"])
        if self.json:
            say_json({"checked": len(found), "damaged": damaged, "scans": found})
        else:
            for one in found:
                say(f"{one['scan']}  {'DAMAGED: ' + '; '.join(one['problems']) if one['problems'] else 'ok'}")
            say(f"{len(found)} decoded, {damaged} damaged")
        return Exit.DAMAGED if damaged else Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadFrame(Verb):
    """One frame of one scan as a picture; no other is decoded."""

    kernels: ClassVar[bool] = False

    scan: str = operand("SCAN", "its folder, packed or not")
    side: str = operand("SIDE", "left or right")
    pattern: str = operand("PATTERN", "for example bright or sine-x-90")
    out: Path | None = option("--out", "default: SCAN-SIDE-PATTERN.png here", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        """Raises UsageError, ScanError, StorageError, MissingLibraryError."""
        folder = scan_folder(self.scan)
        if folder is None:
            raise UsageError(f"SCAN {self.scan}: no such folder; give the folder of a scan")
        if self.side not in SIDES:
            raise UsageError(f"SIDE {self.side}: allowed are {' and '.join(SIDES)}")
        names = manifest_of(folder).record.sequence.patterns
        if self.pattern not in names:
            raise UsageError(f"PATTERN {self.pattern}: this scan has {', '.join(names)}")
        out = self.out or Path(f"{folder.name}-{self.side}-{self.pattern}.png")
        writable(out)
        if out.suffix.lower() != ".png":
            raise UsageError(f"--out {out}: the picture is a PNG; give {out.with_suffix('.png')}")
        frame = read_frame(folder, self.side, names.index(self.pattern))
        import cv2  # late: the other verbs need no pictures

        with writing(out):
            replace_file(LocalFileSystem(), out, cv2.imencode(".png", frame)[1].tobytes())
        height_px, width_px = frame.shape
        facts = {"file": str(out), "width_px": width_px, "height_px": height_px}
        if self.json:
            say_json(facts)
        else:
            say(f"{out}  {width_px} x {height_px} px")
        return Exit.OK


@dataclass(frozen=True, slots=True)
class _Told:
    """Facts that a report has beside those of the scans."""

    different: Sequence[BesideFile]
    left: Mapping[str, str]
    """Why leftovers of removals stay, by folder."""
    as_json: bool


def _each(folders: Sequence[Path], doing: str, work: Callable[[Path], Copied], out: Path, told: _Told) -> Exit:
    """Do ``work`` with each scan and tell what came of it; a scan that cannot be used does not keep the others from it."""
    found: list[dict[str, Any]] = [
        {"scan": name, "done": "failed", "reason": reason, "bytes": 0} for name, reason in told.left.items()
    ]
    with Progress() as progress:
        for k, folder in enumerate(folders):
            progress(f"{doing} {folder.name}", k / len(folders))
            size = _size(folder)  # before: a source may be gone afterwards
            try:
                done, reason = work(folder).value, None
            except ScanError as error:
                done, reason = "failed", str(error)
            found.append({"scan": folder.name, "done": done, "reason": reason, "bytes": size})
            if reason is None:
                found[-1]["bytes_there"] = _size(out / folder.parent.name / folder.name)
    failed = [one for one in found if one["reason"] is not None]
    held = sum(one["bytes"] for one in found if one["reason"] is None)
    there = sum(one["bytes_there"] for one in found if one["reason"] is None)
    count = {what: sum(one["done"] == what for one in found) for what in (*(done.value for done in Copied), "failed")}
    if told.as_json:
        say_json(
            {
                "different": [
                    {"path": one.path, "copy": None if one.copy is None else str(one.copy)} for one in told.different
                ],
                **{name.replace(" ", "_"): number for name, number in count.items()},
                "bytes": held,
                "bytes_there": there,
                "scans": found,
            }
        )
    else:
        for other in told.different:
            say(f"{other.path}  DIFFERS: {_kept(other)}")
        for one in failed:
            say(f"{one['scan']}  failed: {one['reason']}")
        sizes = f"{held / MB:.1f} MB are {there / MB:.1f} MB there" if held else "nothing to do"
        say(f"{', '.join(f'{number} {name}' for name, number in count.items())}; {sizes}")
    return Exit.FAILED if failed or any(one.copy is None for one in told.different) else Exit.OK


def _kept(other: BesideFile) -> str:
    if other.copy is None:
        return "is there twice with other content; move away the one with a checksum in its name, and call again"
    return f"the one there stays; the one from here lies beside it as {other.copy.name}"


def _wanted(archive: Path, scans: Sequence[str]) -> list[Path]:
    if scans:
        return [Library(archive).entry(scan).folder for scan in scans]
    return scan_folders(archive, _shelves(every=True))


def _shelves(*, every: bool) -> tuple[LibraryFolder, ...]:
    return (LibraryFolder.SCANS, LibraryFolder.REJECTED) if every else (LibraryFolder.SCANS,)


def _root(what: str, root: Path) -> Path:
    if not (root / LibraryFolder.SCANS.value).is_dir():
        raise UsageError(f"{what} {root}: no storage root; give the folder that holds scans/")
    return root


def _target(out: Path | None, source: Path) -> Path:
    if out is None:
        raise UsageError("--out is missing; give the folder to write to")
    if out.resolve() == source.resolve():
        raise UsageError(f"--out {out}: is where the scans are read from; give another folder")
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out}: is a file; give a folder")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.absolute().parent}; make it first")
    return out.absolute()


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
