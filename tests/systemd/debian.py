"""Owns a real Debian in a folder with the program on it by its own setup.

Needs root, mmdebstrap and a network; or KINGFISHER_BASE, a tar of a Debian 12 with the packages, and KINGFISHER_WHEELS,
a folder of wheels.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
PACKAGES = (
    "python3", "python3-venv", "libpython3.11", "libegl1", "libgl1", "libgl1-mesa-dri", "libusb-1.0-0", "systemd",
    "systemd-sysv", "udev",
)  # fmt: skip
ELSEWHERE = [
    pytest.mark.long,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(os.geteuid() != 0, reason="a chroot needs root"),
    pytest.mark.skipif(shutil.which("mmdebstrap") is None, reason="mmdebstrap is missing: apt-get install mmdebstrap"),
]


def run(*command: object, check: bool = True) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=3000, check=False)
    assert not check or done.returncode == 0, done.stdout + done.stderr
    return done


def setup(tree: Path, root: Path, verb: str, *more: object, check: bool = True) -> str:
    """What ``systemd/install`` of a source tree says to ``verb``."""
    done = run(tree / "systemd" / "install", verb, "--root", root, *wheels(verb), *more, check=check)
    return done.stdout + done.stderr


def wheels(verb: str) -> list[str]:
    folder = os.environ.get("KINGFISHER_WHEELS")
    return ["--wheels", folder] if folder and verb in ("install", "upgrade") else []


def copied(tree: Path, to: Path) -> Path:
    ignored = shutil.ignore_patterns(".*", "__pycache__", "tests", "bench", "docs", "demo", "build")
    return Path(shutil.copytree(tree, to, ignore=ignored))


def newer(tree: Path, to: Path) -> Path:
    """Another source tree whose version begins with ``9.``."""
    copy = copied(tree, to)
    version = copy / "appliance" / "__init__.py"
    version.write_text(version.read_text().replace('__version__ = "', '__version__ = "9.'))
    return copy


@contextmanager
def debian(folder: Path) -> Iterator[Path]:
    """A Debian in ``folder``, which is gone afterwards."""
    base = os.environ.get("KINGFISHER_BASE")
    folder.mkdir(exist_ok=True)
    try:
        if base:
            folder.chmod(0o755)
            run("tar", "-C", folder, "-xf", base)
        else:
            include = ",".join(PACKAGES)
            run("mmdebstrap", "--quiet", "--variant=minbase", f"--include={include}", "bookworm", folder)
        yield folder
    finally:
        shutil.rmtree(folder)
