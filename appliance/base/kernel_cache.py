"""The folder of compiled kernels: complete before a dive, and never out of date.

To see whether a compiled kernel still holds, numba looks only at the kernel's own file: not at other files whose
functions were built in, not at its own version. So each state of the program has a folder of its own, named after
everything that goes into a kernel. Kernels of an installation (``kernel_build``) may lie on a read-only disk, which
numba refuses to read; they are copied to a writable place, once per start of the computer. A source tree has its
kernels in ``.cache/numba`` beside its packages, whichever command needs them (``python -m appliance.base.kernel_cache``
prints it).

numba runs any machine code in its folder. So a folder is only used if no user but this one and root can have written to
it, or can exchange it later: it belongs to the user, is closed to all others, and every folder above it belongs to the
user or to root, and is sticky (as /tmp is) where others may write to it.

Kernels are compiled for one processor. A disk image is built on one computer and started on another: it brings kernels
for a common level of processors (``COMMON_KERNELS``), which are used if there are none for the processor itself.
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
"""File that is written last: without it, a folder is half filled."""
MARKS = "pieces"
"""Folder with a mark for each compiled piece (``kernel_build``)."""
_PRIVATE = 0o700
_PROGRAM = Path(__file__).parents[1]
_CALLERS = frozenset({"points", "decode", "motion"})
"""Packages whose files without kernels decide the types of the arrays that the kernels beside them are called with."""


@dataclass(frozen=True, slots=True)
class Processor:
    """Target of the compiler, by LLVM's names."""

    name: str
    features: str


COMMON_KERNELS = Processor("x86-64-v3", "")
"""Every x86 since 2013 to 2015; its features follow from the name."""
COMMON_NEEDS = frozenset(("avx", "avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2"))
"""Level 3 of the x86-64 psABI, by LLVM's names."""


class KernelOrigin(Enum):
    """The source of the kernels in use."""

    GIVEN = "given"
    """The environment names a folder; its owner keeps it up to date."""
    READY = "ready"
    """Compiled earlier in this folder, at least in part."""
    SHIPPED = "shipped"
    """Copied from the installation."""
    EMPTY = "empty"
    """No kernels fit: they are compiled at their first use, which takes a minute and more."""


@dataclass(frozen=True, slots=True)
class KernelCache:
    """The folder that numba uses from now on."""

    path: Path
    origin: KernelOrigin


def this_processor() -> Processor:
    """Return the processor of this computer."""
    import llvmlite.binding

    name: str = llvmlite.binding.get_host_cpu_name()
    features: str = llvmlite.binding.get_host_cpu_features().flatten()
    return Processor(name, features)


def runs_common(processor: Processor) -> bool:
    """Return True if kernels for ``COMMON_KERNELS`` run on ``processor``."""
    return {feature[1:] for feature in processor.features.split(",") if feature.startswith("+")} >= COMMON_NEEDS


def fingerprint(processor: Processor | None = None) -> str:
    """Return 16 hexadecimal digits that change with each kernel file, interpreter, compiler and processor.

    ``processor``: default is that of this computer.
    """
    return _fingerprints(processor or this_processor())[0]


def _fingerprints(*processors: Processor) -> list[str]:
    """Return the fingerprint for each of ``processors``.

    Reading the kernel files takes most of the time; they are read once for all.
    """
    files = hashlib.sha256()
    for name, path in _kernel_files():
        files.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    versions = [metadata.version(package) for package in ("numba", "llvmlite", "numpy")]
    fingerprints = []
    for processor in processors:
        # Each of them can make other machine code of the same kernel.
        parts = (sys.version, platform.machine(), *versions, processor.name, processor.features)
        digest = files.copy()
        digest.update("\0".join(parts).encode())
        fingerprints.append(digest.hexdigest()[:16])
    return fingerprints


def stamps() -> str:
    """Return a text that changes when a kernel file is written again, even with the same content.

    numba, too, goes by a file's time and size.
    """
    digest = hashlib.sha256()
    for name, path in _kernel_files():
        status = path.stat()
        digest.update(f"{name}\0{int(status.st_mtime)}\0{status.st_size}\0".encode())
    return digest.hexdigest()[:16]


def _kernel_files() -> Iterator[tuple[str, Path]]:
    """Yield every file of the program that kernels depend on, sorted by name."""
    for package in _packages():
        for path in sorted((_PROGRAM.parent / package).rglob("*.py")):
            name = path.relative_to(_PROGRAM.parent)
            calls = not _CALLERS.isdisjoint(name.parts) or path.name == "warm.py"
            if calls or b"numba" in path.read_bytes():
                yield name.as_posix(), path


def _packages() -> list[str]:
    """Return the names of this package and of those installed beside it."""
    try:
        named = (metadata.distribution(DISTRIBUTION).read_text("top_level.txt") or "").split()
    except metadata.PackageNotFoundError:
        named = []
    return sorted(name for name in {*named, _PROGRAM.name} if (_PROGRAM.parent / name).is_dir())


def shipped_kernels() -> Path:
    """Return the folder of an installation's kernels.

    It lies within the installation's own environment, so that it is removed with it.
    """
    return Path(sys.prefix) / "share" / "kingfisher" / "kernels"


def writable_folder(environment: Mapping[str, str]) -> Path:
    """Return the first that is set or writable of: the service's cache, the source tree's, the user's.

    Otherwise a folder that lasts until the computer is switched off.
    """
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
    folder_in_environment = os.environ.get(VARIABLE)
    exact, common = _fingerprints(this_processor(), COMMON_KERNELS)
    # A folder with our fingerprint was set by `./dev` or by a parent process: it is kept up to date like any other.
    if folder_in_environment and Path(folder_in_environment).name != exact:
        return KernelCache(Path(folder_in_environment), KernelOrigin.GIVEN)
    if folder_in_environment:
        writable = Path(folder_in_environment).parent
    installation = shipped or shipped_kernels()
    source, compiled_for = _shipped(installation / exact, installation / common)
    for parent in (writable or writable_folder(os.environ), _last_resort()):
        # Links are resolved, so that the folder checked here is the one that numba reads.
        folder = parent.resolve() / source.name
        try:
            origin = _fill(folder, source)
        except OSError:
            continue  # read-only, full, or another user's: try the next one
        point_at(folder, compiled_for)
        return KernelCache(folder, origin)
    folder = Path(tempfile.mkdtemp(prefix="kingfisher-kernels-"))
    point_at(folder)
    return KernelCache(folder, KernelOrigin.EMPTY)


def _shipped(exact: Path, common: Path) -> tuple[Path, Processor | None]:
    """Return the best folder of kernels of an installation, and the processor to compile for.

    ``exact`` holds those for this processor, ``common`` those for the common level. ``exact`` is returned also if both
    are missing. A processor of ``None``: this one, which numba finds by itself.
    """
    if (exact / COMPLETE).exists() or not (common / COMPLETE).exists():
        return exact, None
    is_supported = platform.machine() == "x86_64" and runs_common(this_processor())
    return (common, COMMON_KERNELS) if is_supported else (exact, None)


def point_at(folder: Path, processor: Processor | None = None) -> None:
    """Let numba use ``folder`` and compile for ``processor``, in this process and its children.

    ``processor``: ``None`` is that of this computer.
    """
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
    """Make ``folder`` usable.

    Raises OSError when that fails, or when another user could have put kernels there.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    # mkdir with the mode, not chmod after it: in between another user could write into a folder of /tmp.
    with suppress(FileExistsError):
        folder.mkdir(mode=_PRIVATE)
    _refuse_unless_private(folder)
    _try_writing(folder)
    if (folder / COMPLETE).exists():
        return KernelOrigin.READY
    if not (source / COMPLETE).exists():
        return KernelOrigin.READY if (folder / MARKS).is_dir() else KernelOrigin.EMPTY
    # The mark comes last. numba renames its files into place, so that two starts at once do no harm.
    shutil.copytree(source, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns(COMPLETE))
    folder.chmod(_PRIVATE)  # copytree gave it the mode of the source
    (folder / COMPLETE).touch()
    return KernelOrigin.SHIPPED


def _refuse_unless_private(folder: Path) -> None:
    """Raise PermissionError unless ``folder`` is a real folder that only this user can read or replace.

    A user who may rename entries of a folder above it could exchange it between this check and numba's reading.
    """
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid() or stat.S_IMODE(status.st_mode) & 0o077:
        raise PermissionError(
            f"{folder}: kernels are read only from a folder that belongs to this user, with mode 0700"
        )
    for above in folder.parents:
        parent_status = above.lstat()
        if others_may_exchange(parent_status.st_uid, parent_status.st_mode, os.geteuid()):
            raise PermissionError(f"{above}: others may exchange what lies in this folder; kernels there are not read")


def others_may_exchange(owner: int, mode: int, user: int) -> bool:
    """Return True if users other than ``user`` and root may rename entries of a folder.

    ``owner`` and ``mode`` are those of the folder. A link in the place of a folder counts as exchangeable, since its
    target was not checked.
    """
    if not stat.S_ISDIR(mode) or owner not in (0, user):
        return True
    # In a sticky folder only the entry's owner and the folder's may rename it. The group is not checked: on Debian the
    # groups that share a folder of root's are those of administrators.
    return bool(mode & stat.S_IWOTH) and not mode & stat.S_ISVTX


def _try_writing(folder: Path) -> None:
    with tempfile.TemporaryFile(dir=folder):
        pass


def _last_resort() -> Path:
    return Path(tempfile.gettempdir()) / f"kingfisher-kernels-{os.getuid()}"


if __name__ == "__main__":
    sys.stdout.write(f"{writable_folder(os.environ) / fingerprint()}\n")
