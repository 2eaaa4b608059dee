"""Steps that verbs at the desk share: find scans and objects, check output files, open scans, write files.

Modules that compute are imported where they are needed, so that a wrong word is reported before they are loaded.
"""

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
"""Spacing of an object's points; that of a scan in the middle of the volume is 0.16."""
OBJECT = "object:"
"""Prefix of an object's name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WithObjects(WithCalibration):
    """A verb of scans and objects."""

    spacing: float = option(
        "--spacing",
        "distance in mm between the points of an object or a comparison (0.3)",
        default=SPACING_MM,
        parse=number(0.02, 20.0, "mm"),
        metavar="MM",
    )

    def solved(self, options: ScanOptions, name: str) -> tuple[Path, StoredObject]:
        """Return the storage root and a solved object, and print which scans were added since.

        Raises ObjectError for one that is not solved, before anything that computes is loaded.
        """
        from appliance.desk import ADDED_SINCE, read_solved_object

        root = library_root(options)
        stored = read_solved_object(root, name)
        if stored.added_since:
            complain(
                f"object '{stored.name}': without {', '.join(stored.added_since)}, {ADDED_SINCE}", as_json=self.json
            )
        return root, stored


def object_name(word: str) -> str | None:
    """Return NAME of ``object:NAME``; ``None`` if ``word`` is no object."""
    return word.removeprefix(OBJECT) if word.startswith(OBJECT) else None


def find_scan(options: ScanOptions, scan: str) -> Path:
    """Return the folder of ``scan``, given by its number or folder; its content is not checked.

    Raises UnknownScan, UsageError.
    """
    return scan_folder(scan) or Library(library_root(options)).entry(scan).folder


def library_root(options: ScanOptions) -> Path:
    """Return the storage root in which numbers of scans are searched. Raises ConfigError, UsageError."""
    return options.root or root_of_rig(options.rig)


def scan_in_list(listed: Path, scan: str) -> str:
    """Return the scan that a list names: a folder relative to the list, or a number in the storage root."""
    return str(listed.parent / scan) if "/" in scan else scan


@contextmanager
def open_scans(
    options: ScanOptions, scans: Sequence[str], share: float = 1.0, check: Callable[[], None] = lambda: None
) -> Iterator[tuple[Sequence[SourceScan], ProgressLine]]:
    """Open ``scans``, by their numbers or folders, with every byte of their frames compared with its checksum.

    Comparing has the ``share`` of the progress; ``check`` is called before it, and may load modules that compute. Files
    that can be made again (cloud, preview) or found elsewhere (calibration, rig file) need not be whole. Raises
    UnknownScan, ScanError, UsageError.
    """
    from appliance.cli.kernels import compile_kernels

    folders = [find_scan(options, scan) for scan in scans]  # a wrong number is reported before minutes of compiling
    compile_kernels()
    check()
    from appliance.store import SourceScan

    with ProgressLine() as progress:
        sources = []
        for k, folder in enumerate(folders):
            progress(f"comparing checksums of {folder.name}", share * k / len(folders))
            sources.append(SourceScan.open(folder, options, whole=True))
        yield sources, progress


def check_folder(what: str, folder: Path, holds: str) -> None:
    """Raise UsageError if ``folder``, the operand ``what``, does not exist.

    ``holds`` is the content that it should have, for the remedy.
    """
    if not folder.is_dir():
        raise UsageError(f"{what} {folder}: no such folder; give the one that holds {holds}")


def check_writable(out: Path | None, name: str = "--out") -> None:
    """Raise UsageError for a path of option ``name`` that cannot become a file, before any work."""
    if out is None:
        return
    if out.is_dir():
        raise UsageError(f"{name} {out}: is a folder; give the name of a file in it, for example {out / 'cloud.ply'}")
    if out.exists() and not out.is_file():
        raise UsageError(f"{name} {out}: is not a regular file and would be replaced; give the name of a file")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{name} {out}: there is no folder {out.parent}; make it first, or give another one")


def check_writable_as(out: Path, what: str) -> None:
    """Raise UsageError for a path that cannot become a file of ``what``, before any work.

    MissingLibraryError where the library for its format is absent.
    """
    check_writable(out)
    check_suffix(out, what)


def check_suffix(out: Path, what: str) -> None:
    """Raise the errors of ``check_writable_as`` that depend on the suffix alone."""
    from appliance.desk import ExportError, check_file

    try:
        check_file(out, what)
    except ExportError as error:
        raise UsageError(f"--out {error}") from error


def check_page(out: Path) -> None:
    """Raise UsageError for a path that cannot become a file, or whose suffix is not that of a page."""
    check_writable(out)
    if out.suffix.lower() != PAGE_SUFFIX:
        raise UsageError(f"--out {out}: a page is written as {PAGE_SUFFIX}; give {out.with_suffix(PAGE_SUFFIX).name}")


def check_new_folder(out: Path) -> None:
    """Raise UsageError for a folder of ``--out`` that cannot be made."""
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out}: is a file; give a folder, which is made if it is not there")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn errors of the disk inside the block into a StorageError with ``path`` and the option for another one."""
    try:
        yield
    except (StorageError, OSError) as error:
        # StorageError has its own remedy; another OSError (a vanished folder, say) gets one by its number.
        refusal = error if isinstance(error, StorageError) else StorageError.of("cannot write", path, error)
        remedy = f"{refusal.remedy}; --out FILE writes elsewhere"
        raise StorageError("cannot write", path, refusal.reason, remedy) from error


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write ``files`` in their order, each as a whole or not at all. Raises StorageError."""
    for path, content in files.items():
        with writing(path):
            LocalFileSystem().replace_file(path, content)
