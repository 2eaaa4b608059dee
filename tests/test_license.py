"""Whoever gets the program gets its licence with it: stated in the package's metadata, and as the full text."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from email import message_from_string
from pathlib import Path

from kingfisher_setup.build import PARTS

ROOT = Path(__file__).parents[1]
METADATA = "import setuptools.build_meta as backend, sys; backend.prepare_metadata_for_build_wheel(sys.argv[1])"


def test_a_package_states_its_licence_and_brings_the_text(tmp_path: Path) -> None:
    tree, made = tmp_path / "tree", tmp_path / "made"
    tree.mkdir()
    made.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    subprocess.run([sys.executable, "-c", METADATA, str(made)], cwd=tree, check=True, capture_output=True, timeout=120)
    (folder,) = made.glob("*.dist-info")
    stated = message_from_string((folder / "METADATA").read_text(encoding="utf-8"))
    assert stated["License-Expression"] == "Apache-2.0"
    text = (folder / "licenses" / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in text
    assert "TERMS AND CONDITIONS FOR USE, REPRODUCTION, AND DISTRIBUTION" in text


def test_an_instrument_gets_every_file_that_the_package_is_made_of() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {project["readme"], *project["license-files"]} <= set(PARTS)


def test_the_licence_is_named_where_a_reader_looks_for_it() -> None:
    assert "[Apache License 2.0](LICENSE)" in (ROOT / "README.md").read_text(encoding="utf-8")
