"""Steps that the desk's verbs share: which scan or object is meant, files that can be written, scans opened, files
written.

Whatever a wrong word could need is imported where it is needed: a mistake is told before anything that computes is
loaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import number, option
from appliance.cli.output import ProgressLine, UsageError, complain
from appliance.cli.places import WithCalibration, root_of_rig, scan_folder
from appliance.store import Library, LocalFileSystem, ScanOptions, StorageError

if TYPE_CHECKING:  # brings NumPy
    from appliance.desk import StoredObject
    from appliance.store import SourceScan

PAGE_SUFFIX = ".html"
SPACING_MM = 0.3
"""Distance of an object's points: that of a scan's in the middle of the volume is 0.16."""
OBJECT = "object:"
"""Prefix that tells an object's name from a scan's number and a file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WithObjects(WithCalibration):
    """A verb of scans and of objects."""

    spacing: float = option(
        "--spacing",
        "mm between points of an object, or of what is compared (0.3)",
        default=SPACING_MM,
        parse=number(0.02, 20.0, "mm"),
        metavar="MM",
    )

    def solved(self, wish: ScanOptions, name: str) -> tuple[Path, StoredObject]:
        """Return the storage root and a solved object, and say which scans are in none of its files, since they were
        added later. Raises ObjectError, before anything that computes is loaded where there is none."""
        from appliance.desk import ADDED_SINCE, solved_object

        root = library_root(wish)
        found = solved_object(root, name)
        if found.added_since:
            complain(f"object '{found.name}': without {', '.join(found.added_since)}, {ADDED_SINCE}", as_json=self.json)
        return root, found


def object_named(word: str) -> str | None:
    """Return NAME of ``object:NAME``; ``None`` where ``word`` is no object."""
    return word.removeprefix(OBJECT) if word.startswith(OBJECT) else None


def scan_in(wish: ScanOptions, scan: str) -> Path:
    """Return the folder of ``scan``, its number or its folder, whatever is in it. Raises UnknownScan, UsageError."""
    return scan_folder(scan) or Library(library_root(wish)).entry(scan).folder


def library_root(wish: ScanOptions) -> Path:
    """Return the storage root in which numbers of scans are looked up. Raises ConfigError, UsageError."""
    return wish.root or root_of_rig(wish.rig)


def place_of(listed: Path, scan: str) -> str:
    """Return what a list means by ``scan``: a folder is relative to the list, a number is one of the storage root."""
    return str(listed.parent / scan) if "/" in scan else scan


@contextmanager
def opened_scans(
    wish: ScanOptions, scans: Sequence[str], share: float = 1.0, check: Callable[[], None] = lambda: None
) -> Iterator[tuple[Sequence[SourceScan], ProgressLine]]:
    """Open ``scans``, by their numbers or folders, whose frames are whole: every byte is compared with its checksum.

    Comparing has the ``share`` of the progress; ``check`` is called before it, and may load what computes. What can be
    made again from the frames (cloud, preview), and what may be found elsewhere (calibration, rig file), need not be
    whole. Raises UnknownScan, ScanError, UsageError."""
    from appliance.cli.kernels import compile_kernels

    folders = [scan_in(wish, scan) for scan in scans]  # a wrong number is told before minutes of compiling
    compile_kernels()
    check()
    from appliance.store import SourceScan

    with ProgressLine() as progress:
        sources = []
        for k, folder in enumerate(folders):
            progress(f"comparing checksums of {folder.name}", share * k / len(folders))
            sources.append(SourceScan.open(folder, wish, whole=True))
        yield sources, progress


def existing(what: str, folder: Path, holds: str) -> None:
    """Raises UsageError where ``folder``, the operand ``what``, is none; ``holds``: what it is to hold, for the
    remedy."""
    if not folder.is_dir():
        raise UsageError(f"{what} {folder}: no such folder; give the one that holds {holds}")


def writable(out: Path | None, name: str = "--out") -> None:
    """Raises UsageError for a file of the option ``name`` that cannot become a file, before the work is done."""
    if out is None:
        return
    if out.is_dir():
        raise UsageError(f"{name} {out}: is a folder; give the name of a file in it, for example {out / 'cloud.ply'}")
    if out.exists() and not out.is_file():
        raise UsageError(f"{name} {out}: is no ordinary file and would be replaced by one; give the name of a file")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{name} {out}: there is no folder {out.parent}; make it first, or give another one")


def writable_as(out: Path, what: str) -> None:
    """Raises UsageError for a name that ``writable`` refuses or whose suffix ``what`` is not written with, and MissingLibraryError where what writes it is absent: before minutes of work."""
    writable(out)
    checked_as(out, what)


def checked_as(out: Path, what: str) -> None:
    """Raises what ``writable_as`` raises of the suffix alone, where the rest of the name is not known yet."""
    from appliance.desk import ExportError, check_file

    try:
        check_file(out, what)
    except ExportError as error:
        raise UsageError(f"--out {error}") from error


def writable_page(out: Path) -> None:
    """Raises UsageError for a name that ``writable`` refuses or that promises another format than a page."""
    writable(out)
    if out.suffix.lower() != PAGE_SUFFIX:
        raise UsageError(f"--out {out}: a page is written as {PAGE_SUFFIX}; give {out.with_suffix(PAGE_SUFFIX).name}")


def new_folder(out: Path) -> None:
    """Raises UsageError for a folder of ``--out`` that cannot be made."""
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out}: is a file; give a folder, which is made if it is not there")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns what the disk refuses into a StorageError that names ``path`` and the option that leads elsewhere."""
    try:
        yield
    except (StorageError, OSError) as error:
        # StorageError has its own remedy; a bare OSError (a vanished folder, say) gets one by its number.
        refusal = error if isinstance(error, StorageError) else StorageError.of("cannot write", path, error)
        remedy = f"{refusal.remedy}; --out FILE writes elsewhere"
        raise StorageError("cannot write", path, refusal.reason, remedy) from error


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write ``files`` in their order, each whole or not at all. Raises StorageError."""
    for path, content in files.items():
        with writing(path):
            LocalFileSystem().replace_file(path, content)
