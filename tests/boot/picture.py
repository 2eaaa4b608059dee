"""Owns the image that is tested: built by ``image/build`` when its inputs changed, and never written to."""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import dataclass
from pathlib import Path

INPUTS = ("appliance", "drivers", "hw_sim", "systemd", "image", "pyproject.toml", "requirements.lock", "README.md")
KEPT = 2
"""Images in the cache: the one of now and the one before."""


@dataclass(frozen=True, slots=True)
class Image:
    """A disk image, and beside it what its boot loader would load."""

    disk: Path
    cpu: str = "Haswell-noTSX"
    """The oldest processor that the image's kernels are compiled for."""

    @property
    def kernel(self) -> Path:
        return self.disk.with_name(self.disk.name + ".vmlinuz")

    @property
    def initrd(self) -> Path:
        return self.disk.with_name(self.disk.name + ".initrd")

    @property
    def arguments(self) -> str:
        return self.disk.with_name(self.disk.name + ".arguments").read_text(encoding="utf-8").strip()

    def overlay(self, folder: Path) -> Path:
        """A disk that starts as the image and keeps what is written to itself."""
        path = folder / "disk.qcow2"
        command = ["qemu-img", "create", "-q", "-f", "qcow2", "-b", str(self.disk.resolve()), "-F", "raw", str(path)]
        subprocess.run(command, check=True)
        return path


def image_of(root: Path) -> Image:
    """The image of this source tree; building it takes some minutes. Raises CalledProcessError."""
    cache = root / ".cache" / "image"
    cache.mkdir(parents=True, exist_ok=True)
    disk = cache / f"kingfisher-{key_of(root)}.img"
    found = Image(disk)
    if not (disk.exists() and found.kernel.exists() and found.initrd.exists()):
        older = sorted(cache.glob("kingfisher-*.img"), key=lambda path: path.stat().st_mtime)
        for path in older[: len(older) - KEPT + 1]:
            for part in cache.glob(f"{path.name}*"):
                part.unlink()
        subprocess.run([root / "image" / "build", disk, cache], check=True)
    return found


def key_of(root: Path) -> str:
    """16 hexadecimal digits that change with everything that goes into the image, but Debian's own packages."""
    digest = hashlib.sha256()
    for name in INPUTS:
        path = root / name
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(root)}\0".encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]
