"""Owns how one version's folder is made: environment, packages, program, compiled kernels; usable only once it is whole."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from kingfisher_setup import durable, target, versions
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import PROGRAM, Layout
from kingfisher_setup.pins import runtime_pins

PACKAGES = ("appliance", "drivers", "hw_sim")
PARTS = (*PACKAGES, "systemd", "pyproject.toml", "requirements.lock", "README.md", "LICENSE")
"""What of a source tree goes onto an instrument."""
SHARED = ("drivers/__init__.py", "drivers/output/__init__.py", "drivers/output/drm.py")
"""What the safe screen has in common with the program."""
CHECK = """
import appliance.instrument.service.app, drivers.native, sys
from appliance.store.config import load_rig
load_rig(sys.argv[1])
"""
"""That all parts load and accept the rig file; nothing is opened."""

Say = Callable[[str], None]


def name_of(tree: Path) -> str:
    """The version's name, ``0.1.0-3f2a9c1b``: what it calls itself, and what it is. Raises SetupError."""
    text = (tree / "appliance" / "__init__.py").read_text(encoding="utf-8")
    found = re.search(r'^__version__ = "([0-9A-Za-z.+]+)"', text, re.MULTILINE)
    if found is None:
        raise SetupError(f"{tree}/appliance/__init__.py states no __version__; use a complete source tree")
    digest = hashlib.sha256()
    for path in _files(tree):
        digest.update(f"{path.relative_to(tree)}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return f"{found[1]}-{digest.hexdigest()[:8]}"


def build(layout: Layout, tree: Path, wheels: Path | None, say: Say) -> str:
    """Make the version of ``tree`` and return its name; one that is whole already is left as it is.

    ``wheels``: a folder with the wheels of all pinned packages; ``None``: they come from PyPI. Raises SetupError; what
    is half made then is removed by the next call.
    """
    _complete_tree(tree)
    name = name_of(tree)
    folder = layout.version(name)
    if versions.complete(layout, name):
        say(f"{name} is built already")
        return name
    durable.remove_tree(folder)
    folder.mkdir(parents=True)
    inside = PROGRAM / "versions" / name  # environments cannot be moved: it is made where it stays
    pins = folder / "packages.txt"
    pins.write_text(runtime_pins(tree), encoding="utf-8")
    say("packages")
    _wheels(layout, pins, wheels, folder / "wheels")
    target.run(layout, ["/usr/bin/python3", "-m", "venv", str(inside)])
    pip = [f"{inside}/bin/python", "-m", "pip", "--disable-pip-version-check", "--no-input", "-q", "install"]
    offline = ["--no-deps", "--no-index", "--no-compile"]
    target.run(
        layout,
        [*pip, *offline, "--require-hashes", "--find-links", f"{inside}/wheels", "-r", f"{inside}/packages.txt"],
    )
    say("program")
    _copy(tree, folder / "source")
    target.run(layout, [*pip, *offline, "--no-build-isolation", f"{inside}/source"])
    for shared in SHARED:  # with the safe screen, which uses no environment
        copy = folder / "source" / "systemd" / shared
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / "source" / shared, copy)
    shutil.move(folder / "source" / "systemd", folder / "systemd")
    rig = layout.rig if layout.rig.exists() else folder / "source" / "appliance" / "store" / "rigs" / "kingfisher.toml"
    if rig != layout.rig:
        durable.write(layout.rig, rig.read_bytes())
    for leftover in ("source", "wheels"):
        shutil.rmtree(folder / leftover)
    if not layout.live:
        _whole_seconds(folder)
    say("kernels (a minute)")
    # An image is started on another processor.
    target.run(layout, [f"{inside}/bin/kingfisher", "setup", "compile", *([] if layout.live else ["--common"])])
    target.run(layout, [f"{inside}/bin/python", "-m", "compileall", "-q", f"{inside}/lib", f"{inside}/systemd"])
    say("checks")
    target.run(layout, [f"{inside}/bin/python", "-c", CHECK, "/etc/kingfisher/rig.toml"])
    os.sync()  # tens of thousands of files: the whole disk at once, then the mark that says so
    durable.write(folder / versions.COMPLETE, f"{name}\n".encode())
    return name


def _whole_seconds(folder: Path) -> None:
    """Times of files without a fraction: what makes a file system from a folder keeps none, and numba, which compares them
    with those it compiled, would take every kernel for outdated.
    """
    for path in folder.rglob("*"):
        if not path.is_symlink():
            at_s = int(path.stat().st_mtime)
            os.utime(path, (at_s, at_s))


def _complete_tree(tree: Path) -> None:
    missing = [part for part in PARTS if not (tree / part).exists()]
    if missing:
        raise SetupError(f"{tree}: {', '.join(missing)} not found; run the setup from a complete source tree")


def _files(tree: Path) -> Iterator[Path]:
    for part in sorted(PARTS):
        path = tree / part
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                yield file


def _copy(tree: Path, to: Path) -> None:
    for file in _files(tree):
        copy = to / file.relative_to(tree)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
        copy.chmod(0o755 if os.access(file, os.X_OK) else 0o644)


def _wheels(layout: Layout, pins: Path, given: Path | None, to: Path) -> None:
    """All packages as files, beside the environment that they go into."""
    if given is not None:
        if not any(given.glob("*.whl")):
            raise SetupError(f"--wheels {given}: no wheels there; give a folder that `pip download` has filled")
        shutil.copytree(given, to, ignore=lambda _, names: [name for name in names if not name.endswith(".whl")])
        return
    theirs = target.run(layout, ["/usr/bin/python3", "-c", "import sys; print('%d.%d' % sys.version_info[:2])"])
    ours = "{}.{}".format(*sys.version_info[:2])
    if theirs.strip() != ours:
        raise SetupError(
            f"{layout.root} has Python {theirs.strip()}, this machine {ours}: fetch the packages there, give --wheels DIR"
        )
    here = Layout(Path("/"))
    with tempfile.TemporaryDirectory(prefix="kingfisher-setup-") as folder:
        target.run(here, [sys.executable, "-m", "venv", folder])
        fetch = [f"{folder}/bin/python", "-m", "pip", "--disable-pip-version-check", "--no-input", "-q", "download"]
        target.run(
            here,
            [*fetch, "--no-deps", "--require-hashes", "--only-binary", ":all:", "-r", str(pins), "-d", str(to)],
            target.carried(os.environ),
        )
