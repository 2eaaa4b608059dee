"""``import kingfisher`` works where the program is installed: from a wheel and from a source tree, in an environment of its own."""

from __future__ import annotations

import shutil
import site
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CHECK = """
import kingfisher
before = set(__import__("sys").modules)
from kingfisher import fuse, open_dive, Mesh
import appliance.surface.fusion, appliance.offline.scripting, appliance.surface.mesh
assert fuse.__wrapped__ is appliance.surface.fusion.fuse
assert open_dive.__wrapped__ is appliance.offline.scripting.open_dive
assert Mesh is appliance.surface.mesh.Mesh
print("numba" in before, kingfisher.__file__, appliance.__file__)
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """What of the source tree makes the distribution."""
    made = tmp_path / "tree"
    made.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, made)
    for name in ("appliance", "drivers", "hw_sim"):
        shutil.copytree(ROOT / name, made / name, ignore=shutil.ignore_patterns("__pycache__"))
    return made


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """The interpreter of a new environment that sees this one's packages, and nothing that is installed in place here."""
    venv.create(tmp_path / "venv", with_pip=False)
    (packages,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    # A folder that a .pth file names is only searched: the .pth files within, by which this tree is installed, do not count.
    (packages / "others.pth").write_text("\n".join(site.getsitepackages()))
    return tmp_path / "venv/bin/python"


def said(*words: object, cwd: Path) -> str:
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, capture_output=True, text=True, timeout=280, check=False,
        env={"PATH": "/usr/bin:/bin", "HOME": str(cwd), "NUMBA_CACHE_DIR": str(cwd / "numba")},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def installed(python: Path, tmp_path: Path, *what: object) -> tuple[str, Path, Path]:
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python)
    said(*pip, "install", "--no-deps", "--no-index", "--no-build-isolation", "--ignore-installed", *what, cwd=tmp_path)
    early, package, program = said(python, "-c", CHECK, cwd=tmp_path).split()
    return early, Path(package), Path(program)


def test_from_a_source_tree_it_is_the_tree_itself(tree: Path, python: Path, tmp_path: Path) -> None:
    early, package, program = installed(python, tmp_path, "-e", tree)
    assert early == "False", "nothing that computes is loaded before it is asked for"
    assert package == tree / "appliance/python/kingfisher/__init__.py"
    assert program == tree / "appliance/__init__.py"
