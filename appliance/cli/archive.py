"""The verbs ``archive pack`` and ``unpack``: scans kept in a third of the room, and had again byte for byte."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from appliance.cli.arguments import Verb, operand, operands, path_option, switch
from appliance.cli.desk import new_folder
from appliance.cli.output import Exit, ProgressLine, UsageError
from appliance.store import ArchiveReport, LibraryFolder, pack_archive, unpack_archive

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
        with ProgressLine() as progress:
            report = pack_archive(source, archive, every=self.all, remove=self.remove, progress=progress)
        return _told(self, report)


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
        with ProgressLine() as progress:
            report = unpack_archive(archive, out, self.scans, progress)
        return _told(self, report)


def _told(verb: Verb, report: ArchiveReport) -> Exit:
    held = sum(one.size_bytes for one in report.scans if one.outcome is not None)
    there = sum(one.target_bytes for one in report.scans)
    scans: list[dict[str, Any]] = []
    for one in report.scans:
        done = "failed" if one.outcome is None else one.outcome.value
        scans.append({"scan": one.scan, "done": done, "reason": one.reason, "bytes": one.size_bytes})
        if one.outcome is not None:
            scans[-1]["bytes_there"] = one.target_bytes
    sizes = f"{held / MB:.1f} MB are {there / MB:.1f} MB there" if held else "nothing to do"
    verb.tell(
        {
            "different": [
                {"path": one.path, "copy": None if one.copy is None else str(one.copy)} for one in report.different
            ],
            **{name.replace(" ", "_"): number for name, number in report.counts.items()},
            "bytes": held,
            "bytes_there": there,
            "scans": scans,
        },
        [
            *(f"{other.path}  DIFFERS: {_kept(other.copy)}" for other in report.different),
            *(f"{one.scan}  failed: {one.reason}" for one in report.scans if one.outcome is None),
            f"{', '.join(f'{number} {name}' for name, number in report.counts.items())}; {sizes}",
        ],
    )
    return Exit.OK if report.is_complete else Exit.FAILED


def _kept(copy: Path | None) -> str:
    if copy is None:
        return "is there twice with other content; move away the one with a checksum in its name, and call again"
    return f"the one there stays; the one from here lies beside it as {copy.name}"


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
