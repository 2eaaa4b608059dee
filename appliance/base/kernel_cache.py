"""Owns where compiled kernels are kept, so that they are never compiled before a diver's eyes and never out of date.

numba looks only at the file of the kernel itself to see whether what it compiled before still holds: not at other files
whose functions were built in, not at its own version's flags. So each state of the program has a folder of its own,
named after everything that goes into a kernel. What an installation has compiled (``kernel_build``) may lie on a
read-only disk, where numba refuses to read; it is copied to a place that can be written, once per start of the machine.
A source tree has its kernels in ``.cache/numba`` beside its packages, whichever command needs them (``python -m
appliance.base.kernel_cache`` names it).

numba runs whatever machine code it finds in its folder. So a folder is only used when nobody but this user and root can
have written to it, or can exchange it later: it belongs to the user, is closed to everybody else, and every folder
above it belongs to the user or to root, and is sticky (as /tmp is) where others may write to it.

Kernels are compiled for one processor. An image that is made here and started there brings them for a level of
processors that is common enough (``COMMON``), and they are used where none were compiled for the processor itself.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any

from appliance.base.distribution import DISTRIBUTION

VARIABLE = "NUMBA_CACHE_DIR"
CPU_VARIABLES = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
COMPLETE = "complete"
"""A file that is written last: without it, a folder was left half made."""
MARKS = "pieces"
"""Folder of marks, one of each piece that was compiled here (``kernel_build``)."""
_PRIVATE = 0o700
_PROGRAM = Path(__file__).parents[1]
_CALLERS = frozenset({"points", "decode", "motion"})
"""Packages whose files without kernels decide which kinds of arrays the kernels beside them are given."""


@dataclass(frozen=True, slots=True)
class Processor:
    """Whom kernels are compiled for, in LLVM's words."""

    name: str
    features: str


COMMON_KERNELS = Processor("x86-64-v3", "")
"""Every x86 since 2013 to 2015; its features follow from the name."""
COMMON_NEEDS = frozenset(("avx", "avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2"))
"""The x86-64 psABI's level 3, by LLVM's names."""


class KernelOrigin(Enum):
    """The source of the kernels in use."""

    GIVEN = "given"
    """The environment names a place: whoever set it keeps it up to date."""
    READY = "ready"
    """Compiled before, in this place, at least in part."""
    SHIPPED = "shipped"
    """Copied from the installation."""
    EMPTY = "empty"
    """Nothing fits: they are compiled when first needed, which takes a minute and more."""


@dataclass(frozen=True, slots=True)
class KernelCache:
    """The folder that numba uses from now on."""

    path: Path
    origin: KernelOrigin


def this_processor() -> Processor:
    """Return the one that this process runs on."""
    import llvmlite.binding

    name: str = llvmlite.binding.get_host_cpu_name()
    features: str = llvmlite.binding.get_host_cpu_features().flatten()
    return Processor(name, features)


def runs_common(processor: Processor) -> bool:
    """Return True if kernels for ``COMMON`` run on ``processor``."""
    return {feature[1:] for feature in processor.features.split(",") if feature.startswith("+")} >= COMMON_NEEDS


def fingerprint(processor: Processor | None = None) -> str:
    """Return 16 hexadecimal digits that change with each kernel file, interpreter, compiler and processor (default:
    this one)."""
    return _fingerprints(processor or this_processor())[0]


def _fingerprints(*processors: Processor) -> list[str]:
    """Return the fingerprint for each of ``processors``; the kernel files are read once for all, which takes most of
    the time."""
    files = hashlib.sha256()
    for name, path in _kernel_files():
        files.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    versions = [metadata.version(package) for package in ("numba", "llvmlite", "numpy")]
    found = []
    for processor in processors:
        # Each of them can make other machine code of the same kernel.
        parts = (sys.version, platform.machine(), *versions, processor.name, processor.features)
        digest = files.copy()
        digest.update("\0".join(parts).encode())
        found.append(digest.hexdigest()[:16])
    return found


def stamps() -> str:
    """Return a text that changes when a kernel file was written anew, be it with the same text: numba goes by a
    file's time and size."""
    digest = hashlib.sha256()
    for name, path in _kernel_files():
        status = path.stat()
        digest.update(f"{name}\0{int(status.st_mtime)}\0{status.st_size}\0".encode())
    return digest.hexdigest()[:16]


def _kernel_files() -> Iterator[tuple[str, Path]]:
    """Yield every file of the program that kernels, or what decides which there are, are made of; by name, in order."""
    for package in _packages():
        for path in sorted((_PROGRAM.parent / package).rglob("*.py")):
            name = path.relative_to(_PROGRAM.parent)
            calls = not _CALLERS.isdisjoint(name.parts) or path.name == "warm.py"
            if calls or b"numba" in path.read_bytes():
                yield name.as_posix(), path


def _packages() -> list[str]:
    """Return the packages that came with this one, and this one, where they lie side by side."""
    try:
        named = (metadata.distribution(DISTRIBUTION).read_text("top_level.txt") or "").split()
    except metadata.PackageNotFoundError:
        named = []
    return sorted(name for name in {*named, _PROGRAM.name} if (_PROGRAM.parent / name).is_dir())


def shipped_kernels() -> Path:
    """Return the folder of what an installation compiled: within its own environment, so that it goes when that goes."""
    return Path(sys.prefix) / "share" / "kingfisher" / "kernels"


def writable_folder(environment: Mapping[str, str]) -> Path:
    """Return the service's cache directory, else the source tree's, else the user's, else one that lasts until the
    machine is switched off."""
    # Set by systemd (CacheDirectory=), where the service may write although the root is read-only.
    if environment.get("CACHE_DIRECTORY"):
        return Path(environment["CACHE_DIRECTORY"].split(":")[0]) / "kernels"
    tree = _PROGRAM.parent
    if (tree / "pyproject.toml").is_file() and os.access(tree, os.W_OK):
        return tree / ".cache" / "numba"
    if environment.get("XDG_CACHE_HOME"):
        return Path(environment["XDG_CACHE_HOME"].split(":")[0]) / "kingfisher/kernels"
    home = environment.get("HOME")
    return Path(home) / ".cache/kingfisher/kernels" if home else _last_resort()


def use_kernel_cache(shipped: Path | None = None, writable: Path | None = None) -> KernelCache:
    """Point numba at kernels of exactly this program. Call before any module with kernels is imported.

    Never fails: without a place that can be written and trusted, the kernels go to a new temporary one.
    """
    given = os.environ.get(VARIABLE)
    own, common = _fingerprints(this_processor(), COMMON_KERNELS)
    # A folder with our own fingerprint was set by `./dev` or by a parent process: it is kept up like any other.
    if given and Path(given).name != own:
        return KernelCache(Path(given), KernelOrigin.GIVEN)
    if given:
        writable = Path(given).parent
    base = shipped or shipped_kernels()
    source, compiled_for = _shipped(base / own, base / common)
    for place in (writable or writable_folder(os.environ), _last_resort()):
        # Without links from here on: what is looked at is what numba reads.
        folder = place.resolve() / source.name
        try:
            origin = _fill(folder, source)
        except OSError:
            continue  # read-only, full, or somebody else's: the next one
        point_at(folder, compiled_for)
        return KernelCache(folder, origin)
    folder = Path(tempfile.mkdtemp(prefix="kingfisher-kernels-"))
    point_at(folder)
    return KernelCache(folder, KernelOrigin.EMPTY)


def _shipped(own: Path, common: Path) -> tuple[Path, Processor | None]:
    """Return the best that an installation has compiled: for this processor (``own``), else for the common level; where
    both miss, the first. With it, whom numba must be told to compile for; ``None``: this processor, which it finds by
    itself."""
    if (own / COMPLETE).exists() or not (common / COMPLETE).exists():
        return own, None
    runs = platform.machine() == "x86_64" and runs_common(this_processor())
    return (common, COMMON_KERNELS) if runs else (own, None)


def point_at(folder: Path, processor: Processor | None = None) -> None:
    """Let numba use ``folder``, and compile for ``processor`` (``None``: this one), in this process and those it
    starts."""
    os.environ[VARIABLE] = str(folder)
    if processor is not None:
        os.environ.update(zip(CPU_VARIABLES, (processor.name, processor.features), strict=True))
    if "numba" not in sys.modules:
        return  # it reads the environment when it is imported
    import numba

    config: Any = numba.config
    config.CACHE_DIR = str(folder)
    if processor is not None:
        config.CPU_NAME, config.CPU_FEATURES = processor.name, processor.features


def _fill(folder: Path, source: Path) -> KernelOrigin:
    """Make ``folder`` usable; raises OSError when it cannot be, or when somebody else could have put kernels there."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    # mkdir with the mode, not chmod after it: in between somebody else could write into a folder of /tmp.
    with suppress(FileExistsError):
        folder.mkdir(mode=_PRIVATE)
    _refuse_unless_private(folder)
    _try_writing(folder)
    if (folder / COMPLETE).exists():
        return KernelOrigin.READY
    if not (source / COMPLETE).exists():
        return KernelOrigin.READY if (folder / MARKS).is_dir() else KernelOrigin.EMPTY
    # The mark comes last; numba's own files are renamed into place, so that two starts at once do no harm.
    shutil.copytree(source, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns(COMPLETE))
    folder.chmod(_PRIVATE)  # copytree gave it the mode of the source
    (folder / COMPLETE).touch()
    return KernelOrigin.SHIPPED


def _refuse_unless_private(folder: Path) -> None:
    """Raises PermissionError unless ``folder`` is a real folder of this user that nobody else can look into or replace.

    Whoever may rename what lies in a folder above it could exchange it between this look and numba's reading.
    """
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise PermissionError(
            f"{folder}: kernels are read only from a folder that belongs to this user, with mode 0700"
        )
    for above in folder.parents:
        about = above.lstat()
        if others_may_exchange(about.st_uid, about.st_mode, os.geteuid()):
            raise PermissionError(f"{above}: others may exchange what lies in this folder; kernels there are not read")


def others_may_exchange(owner: int, mode: int, user: int) -> bool:
    """Return True if somebody else than ``user`` and root may rename what of theirs lies in a folder of ``owner`` with
    ``mode``.

    A link in the place of a folder counts as one that others may exchange, since what it leads to was not looked at.
    """
    if not stat.S_ISDIR(mode) or owner not in (0, user):
        return True
    # In a sticky folder an entry is renamed by its own owner or by the folder's, and by nobody else. Its group is not
    # asked: on a Debian the groups that share a folder of root's are those of its administrators.
    return bool(mode & stat.S_IWOTH) and not mode & stat.S_ISVTX


def _try_writing(folder: Path) -> None:
    with tempfile.TemporaryFile(dir=folder):
        pass


def _last_resort() -> Path:
    return Path(tempfile.gettempdir()) / f"kingfisher-kernels-{os.getuid()}"


if __name__ == "__main__":
    sys.stdout.write(f"{writable_folder(os.environ) / fingerprint()}\n")
