"""The program as it is installed: by its own name beside somebody else's, and imported from its source tree."""

from __future__ import annotations

import importlib
import re
import signal
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from appliance.base.distribution import DISTRIBUTION, EXTRA, other_program
from appliance.base.libraries import MissingLibraryError, needed
from appliance.cli import main

ROOT = Path(__file__).parents[2]
SOMEBODY_ELSES = re.compile(
    r"(?<![\w/.-])kingfisher(?:\[[a-z,]+\]|[=~><]=[0-9])|pip3? install (?:-\S+ )*['\"]?kingfisher(?![\w-])"
)
"""The name as pip is asked for it, with an extra or a version, or after ``pip install``."""


def somebody_elses(folder: Path, packages: str) -> None:
    """Leave a distribution called kingfisher 0.5.0 in ``folder``, with these packages of the top level."""
    info = folder / "kingfisher-0.5.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: kingfisher\nVersion: 0.5.0\nSummary: Download FASTQ\n")
    (info / "top_level.txt").write_text(packages)


def test_no_page_tells_to_install_somebody_elses_program() -> None:
    assert SOMEBODY_ELSES.search("pip install 'kingfisher[desk]'")
    assert SOMEBODY_ELSES.search("pip install -U kingfisher")
    assert not SOMEBODY_ELSES.search("pip install 'kingfisher-3d[desk]'")
    own = Path(__file__).relative_to(ROOT).as_posix()
    # git looks through 2,000 files in the time in which Python reads twenty.
    words = ["-e", "kingfisher\\[", "-e", "kingfisher[=~><]=", "-e", "pip3? install"]
    found = subprocess.run(
        ["git", "grep", "-I", "-E", *words, "--", ":!CHANGELOG.md", f":!{own}"], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )  # fmt: skip
    assert "docs/python.md:" in found.stdout
    telling = [line for line in found.stdout.splitlines() if SOMEBODY_ELSES.search(line.partition(":")[2])]
    assert telling == []


def test_the_name_is_that_of_the_project_file() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["name"] == DISTRIBUTION != "kingfisher"
    assert f"{DISTRIBUTION}[desk]" == EXTRA
    assert "desk" in project["optional-dependencies"]


def test_somebody_elses_program_beside_this_one_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert other_program() is None
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    somebody_elses(tmp_path, "kingfisher\n")
    said = other_program()
    assert said is not None
    assert "0.5.0: Download FASTQ" in said
    assert f"pip uninstall kingfisher, then install {DISTRIBUTION} again" in said
    with pytest.raises(MissingLibraryError) as refused:
        needed("no_such_library", "no-such-library", "a page")
    assert f"pip install '{EXTRA}'" in str(refused.value)
    assert str(refused.value).endswith(said)
    with pytest.raises(AttributeError, match=r"'opendive'.*another program called kingfisher"):
        _ = importlib.import_module("kingfisher").opendive
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().err == f"kingfisher: {said}\n"


def test_this_program_under_its_former_name_is_not_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    somebody_elses(tmp_path, "appliance\ndrivers\nhw_sim\nkingfisher\n")
    assert other_program() is None


def test_an_interruption_waits_until_a_library_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "struck_amidst.py").write_text("import os\nos.kill(os.getpid(), 2)\nsum(range(1000))\nWHOLE = True\n")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever started the tests may have it ignored
    try:
        with pytest.raises(KeyboardInterrupt):
            needed("struck_amidst", "struck-amidst", "a page")
    finally:
        signal.signal(signal.SIGINT, before)
    assert sys.modules.pop("struck_amidst").WHOLE
    # Only the main thread is interrupted, and another may load as well.
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(needed, "json", "json", "a page").result(10.0).__name__ == "json"


CHECK = """
import kingfisher
before = set(__import__("sys").modules)
from kingfisher import fuse, open_dive, Mesh
import appliance.desk.surface.fusion, appliance.desk.scripting, appliance.desk.surface.mesh
assert fuse.__wrapped__ is appliance.desk.surface.fusion.fuse
assert open_dive.__wrapped__ is appliance.desk.scripting.open_dive
assert Mesh is appliance.desk.surface.mesh.Mesh
print("numba" in before, kingfisher.__file__, appliance.__file__)
"""


def test_imported_from_a_source_tree_it_is_the_tree_itself(tmp_path: Path) -> None:
    """As this environment has it, which no folder or variable leads to it."""
    said = subprocess.run(
        [sys.executable, "-I", "-c", CHECK], cwd=tmp_path, capture_output=True, text=True, timeout=100, check=True
    )
    early, package, program = said.stdout.split()
    assert early == "False", "nothing that computes is loaded before it is asked for"
    assert Path(package) == ROOT / "appliance/desk/python/kingfisher/__init__.py"
    assert Path(program) == ROOT / "appliance/__init__.py"
