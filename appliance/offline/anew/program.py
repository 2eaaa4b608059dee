"""Owns what stands for the program in the key of a result: everything of the installation that decides about points.

That is the program's own files, Python or not (the packaged rig files are TOML), and the libraries that compute. The processor is
not in it: kernels are compiled for each, and the last digits of a point may differ between two kinds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path

import appliance
from appliance import __version__

COMPUTING = ("numpy", "scipy", "numba", "llvmlite", "opencv-python-headless")
"""Distributions whose versions may change a point; codecs are not among them, for every decoded frame has its checksum."""
FILES = ("*.py", "*.toml")
DIGITS = 12


@cache
def program_digits() -> str:
    """Return version, digits of the program's files and versions of the libraries: results of two programs have different keys."""
    versions = {name: _version(name) for name in COMPUTING}
    return program_text(Path(appliance.__file__).parent, versions)


def program_text(top: Path, versions: Mapping[str, str]) -> str:
    """Return what stands for the program whose files lie below ``top``, with libraries of these ``versions`` by their names."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in FILES for path in top.rglob(pattern)):
        digest.update(path.relative_to(top).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    libraries = " ".join(f"{name} {version}" for name, version in versions.items())
    return f"kingfisher {__version__}-{digest.hexdigest()[:DIGITS]} {libraries}"


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:  # a library that somebody put there without its description
        return "?"
