"""The verbs ``archive pack`` and ``unpack``: scans kept in a third of the room, and had again byte for byte."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from appliance.cli.arguments import Verb, operand, operands, path_option, switch
from appliance.cli.desk import new_folder
from appliance.cli.output import Exit, ProgressLine, UsageError
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
    make_shelves,
    pack_scan,
    remove_source,
    scan_folders,
    unpack_scan,
)

MB = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class PackArchive(Verb):
    """Pack every scan of a storage root into an archive; FAILED if one could not be, after all others were."""

    kernels: ClassVar[bool] = False

    source: Path = operand("SOURCE", "storage root with the scans", parse=Path)
    out: Path | None = path_option("--out", "the archive, made where it is not there", metavar="ARCHIVE")
    all: bool = switch("--all", "also the rejected ones")
    remove: bool = switch("--remove", "remove each scan from SOURCE once its packed copy was compared with it")

    def run(self) -> Exit:
        """Raises UsageError, StorageError, MissingLibraryError."""
        source, archive = storage_root("SOURCE", self.source), target_folder(self.out, self.source)
        shelves = shelves_of(every=self.all)
        fs = LocalFileSystem()
        fs.make_folders(archive)
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

            return _each(self, scan_folders(source, shelves), pack, archive, different, left)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnpackArchive(Verb):
    """Bring scans of an archive back, byte for byte as they were; FAILED if one could not be, after all others were."""

    kernels: ClassVar[bool] = False

    archive: Path = operand("ARCHIVE", "storage root with packed scans", parse=Path)
    scans: Sequence[str] = operands("SCAN", "numbers (default: all)", at_least_one=False)
    out: Path | None = path_option("--out", "storage root, made where it is not there", metavar="ROOT")

    def run(self) -> Exit:
        """Raises UsageError, UnknownScan, StorageError, MissingLibraryError."""
        archive, out = storage_root("ARCHIVE", self.archive), target_folder(self.out, self.archive)
        shelves, fs = shelves_of(every=True), LocalFileSystem()
        folders = [Library(archive).entry(scan).folder for scan in self.scans] or scan_folders(archive, shelves)
        fs.make_folders(out)
        with hold_lock(out):
            make_shelves(fs, out, shelves)
            different = copy_beside(fs, archive, out)

            def unpack(folder: Path) -> Copied:
                return unpack_scan(fs, folder, out / folder.parent.name / folder.name)

            return _each(self, folders, unpack, out, different)


def _each(
    verb: Verb,
    folders: Sequence[Path],
    work: Callable[[Path], Copied],
    out: Path,
    different: Sequence[BesideFile],
    left: Mapping[str, str] = MappingProxyType({}),
) -> Exit:
    """Do ``work`` with each scan and tell what came of it; a scan that cannot be used does not keep the others from it.

    ``left``: why leftovers of removals stay, by folder.
    """
    found: list[dict[str, Any]] = [
        {"scan": name, "done": "failed", "reason": reason, "bytes": 0} for name, reason in left.items()
    ]
    with ProgressLine() as progress:
        for k, folder in enumerate(folders):
            progress(folder.name, k / len(folders))
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
    sizes = f"{held / MB:.1f} MB are {there / MB:.1f} MB there" if held else "nothing to do"
    verb.tell(
        {
            "different": [{"path": one.path, "copy": None if one.copy is None else str(one.copy)} for one in different],
            **{name.replace(" ", "_"): number for name, number in count.items()},
            "bytes": held,
            "bytes_there": there,
            "scans": found,
        },
        [
            *(f"{other.path}  DIFFERS: {_kept(other)}" for other in different),
            *(f"{one['scan']}  failed: {one['reason']}" for one in failed),
            f"{', '.join(f'{number} {name}' for name, number in count.items())}; {sizes}",
        ],
    )
    return Exit.FAILED if failed or any(one.copy is None for one in different) else Exit.OK


def _kept(other: BesideFile) -> str:
    if other.copy is None:
        return "is there twice with other content; move away the one with a checksum in its name, and call again"
    return f"the one there stays; the one from here lies beside it as {other.copy.name}"


def shelves_of(*, every: bool) -> tuple[LibraryFolder, ...]:
    """Return the shelves that are packed: that of the scans, and with ``every`` that of the rejected ones."""
    return (LibraryFolder.SCANS, LibraryFolder.REJECTED) if every else (LibraryFolder.SCANS,)


def storage_root(what: str, root: Path) -> Path:
    """Return ``root``, the operand ``what``. Raises UsageError where it is none."""
    if not (root / LibraryFolder.SCANS.value).is_dir():
        raise UsageError(f"{what} {root}: no storage root; give the folder that holds scans/")
    return root


def target_folder(out: Path | None, source: Path | None) -> Path:
    """Return the folder of ``--out``, which need not be there yet. Raises UsageError, also where it is ``source``."""
    if out is None:
        raise UsageError("--out is missing; give the folder to write to")
    if source is not None and out.resolve() == source.resolve():
        raise UsageError(f"--out {out}: is where the scans are read from; give another folder")
    new_folder(out)
    if not out.absolute().parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.absolute().parent}; make it first")
    return out.absolute()


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
