"""The verbs ``archive pack`` and ``unpack``: scans in a third of the space, and back, byte for byte."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from appliance.cli.arguments import Verb, operand, operands, path_option, switch
from appliance.cli.desk import check_new_folder
from appliance.cli.output import Exit, ProgressLine, UsageError
from appliance.store import ArchiveReport, LibraryFolder, pack_archive, unpack_archive

MB = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class PackArchive(Verb):
    """Pack every scan of a storage root into an archive; FAILED if any cannot be packed, after all others."""

    kernels: ClassVar[bool] = False

    source: Path = operand("SOURCE", "storage root with the scans", parse=Path)
    out: Path | None = path_option("--out", "folder of the archive, made if it does not exist", metavar="ARCHIVE")
    all: bool = switch("--all", "also rejected scans")
    remove: bool = switch("--remove", "remove each scan from SOURCE after its packed copy has been compared with it")

    def run(self) -> Exit:
        """Pack the scans. Raises UsageError, StorageError, MissingLibraryError."""
        source, archive = storage_root("SOURCE", self.source), target_folder(self.out, self.source)
        with ProgressLine() as progress:
            report = pack_archive(source, archive, every=self.all, remove=self.remove, progress=progress)
        return _report(self, report)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnpackArchive(Verb):
    """Restore scans of an archive, byte for byte; FAILED if any cannot be restored, after all others."""

    kernels: ClassVar[bool] = False

    archive: Path = operand("ARCHIVE", "storage root with packed scans", parse=Path)
    scans: Sequence[str] = operands("SCAN", "numbers (default: all)", at_least_one=False)
    out: Path | None = path_option("--out", "storage root, made if it does not exist", metavar="ROOT")

    def run(self) -> Exit:
        """Restore the scans. Raises UsageError, UnknownScan, StorageError, MissingLibraryError."""
        archive, out = storage_root("ARCHIVE", self.archive), target_folder(self.out, self.archive)
        with ProgressLine() as progress:
            report = unpack_archive(archive, out, self.scans, progress)
        return _report(self, report)


def _report(verb: Verb, report: ArchiveReport) -> Exit:
    source_bytes = sum(scan.size_bytes for scan in report.scans if scan.outcome is not None)
    target_bytes = sum(scan.target_bytes for scan in report.scans)
    scans: list[dict[str, Any]] = []
    for scan in report.scans:
        done = "failed" if scan.outcome is None else scan.outcome.value
        scans.append({"scan": scan.scan, "done": done, "reason": scan.reason, "bytes": scan.size_bytes})
        if scan.outcome is not None:
            scans[-1]["bytes_there"] = scan.target_bytes
    sizes = (
        f"{source_bytes / MB:.1f} MB read, {target_bytes / MB:.1f} MB in the target"
        if source_bytes
        else "nothing to do"
    )
    verb.tell(
        {
            "different": [
                {"path": file.path, "copy": None if file.copy is None else str(file.copy)} for file in report.different
            ],
            **{name.replace(" ", "_"): number for name, number in report.counts.items()},
            "bytes": source_bytes,
            "bytes_there": target_bytes,
            "scans": scans,
        },
        [
            *(f"{file.path}  DIFFERS: {_copy_sentence(file.copy)}" for file in report.different),
            *(f"{scan.scan}  failed: {scan.reason}" for scan in report.scans if scan.outcome is None),
            f"{', '.join(f'{number} {name}' for name, number in report.counts.items())}; {sizes}",
        ],
    )
    return Exit.OK if report.is_complete else Exit.FAILED


def _copy_sentence(copy: Path | None) -> str:
    if copy is None:
        return "the target has two copies that differ; move away the one with a checksum in its name, and call again"
    return f"the target keeps its file; the file of the source is beside it as {copy.name}"


def storage_root(what: str, root: Path) -> Path:
    """Return ``root``, the operand ``what``. Raises UsageError if it is no storage root."""
    if not (root / LibraryFolder.SCANS.value).is_dir():
        raise UsageError(f"{what} {root}: no storage root; give the folder that holds scans/")
    return root


def target_folder(out: Path | None, source: Path | None) -> Path:
    """Return the folder of ``--out``, which may not exist yet. Raises UsageError, also if it is ``source``."""
    if out is None:
        raise UsageError("--out is missing; give the folder to write to")
    if source is not None and out.resolve() == source.resolve():
        raise UsageError(f"--out {out}: is the folder that the scans are read from; give another folder")
    check_new_folder(out)
    if not out.absolute().parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.absolute().parent}; make it first")
    return out.absolute()
