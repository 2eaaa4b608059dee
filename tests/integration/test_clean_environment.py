"""Everything that a desk does with an archive, from a wheel, in an environment with nothing but the locked packages that ``kingfisher-3d[desk]`` requires."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import venv
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

from appliance.base.distribution import DISTRIBUTION
from hw_sim.scene import Scene
from tests.support.commands import ROOT
from tests.support.foreign_sets import convention, make_set
from tests.support.rendered import render_scan
from tests.support.stored import origin_of, store

POSES = {"000001": (0.0, 0.0, 545.0, 5.0, -8.0, 12.0), "000002": (35.0, -20.0, 550.0, -3.0, 4.0, 22.0)}
SIZE_PX = (400, 300)


def required(name: str, extra: str = "") -> set[str]:
    """Return the distributions that one requires, with those that they require, by their names here."""
    found: set[str] = set()
    waiting = [(name, extra)]
    while waiting:
        one, of = waiting.pop()
        for text in metadata.requires(one) or ():
            wanted = Requirement(text)
            if wanted.marker is not None and not wanted.marker.evaluate({"extra": of}):
                continue
            dependency = metadata.distribution(wanted.name).metadata["Name"]
            if dependency not in found:
                found.add(dependency)
                waiting += [(dependency, ""), *((dependency, extra) for extra in wanted.extras)]
    return found


def bring(distribution: str, packages: Path) -> None:
    """Link an installed distribution's files to another environment's packages: the locked version, and no network."""
    here = metadata.distribution(distribution)
    for file in here.files or ():
        if ".." in file.parts or "__pycache__" in file.parts:
            continue  # programs name their own environment's interpreter
        target = packages / file
        target.parent.mkdir(parents=True, exist_ok=True)
        source = Path(str(here.locate_file(file)))
        try:
            os.link(source, target)
        except OSError:
            shutil.copy2(source, target)


@dataclass(frozen=True)
class Desk:
    """The clean environment, and an empty folder that everything is called from."""

    python: Path
    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        return {"PATH": "/usr/bin:/bin", "HOME": str(self.folder), "LANG": "C.UTF-8"}

    def __call__(self, *words: object, code: int = 0) -> str:
        program = self.python.with_name("kingfisher")
        done = subprocess.run(
            [str(program), *map(str, words)], cwd=self.folder, env=self.environment, capture_output=True, text=True,
            timeout=1200, check=False,
        )  # fmt: skip
        assert done.returncode == code, f"{words}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
        assert "Traceback" not in done.stderr, done.stderr
        return done.stdout

    def json(self, *words: object) -> Any:
        return json.loads(self(*words, "--json"))


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    tree = tmp_path / "tree"
    tree.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    for name in ("appliance", "drivers", "hw_sim"):
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    alone = ["--no-deps", "--no-index"]

    def call(*words: str) -> None:
        subprocess.run([*pip, *words], check=True, timeout=280, cwd=tmp_path, stdout=subprocess.DEVNULL)

    call("wheel", *alone, "--no-build-isolation", "-w", str(tmp_path), str(tree))
    shutil.rmtree(tree)
    (wheel,) = tmp_path.glob("kingfisher_3d-*.whl")
    venv.create(tmp_path / "venv", with_pip=False)
    python = tmp_path / "venv/bin/python"
    (packages,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    for distribution in sorted(required(DISTRIBUTION, "desk")):
        bring(distribution, packages)
    call("--python", str(python), "install", *alone, f"{wheel}[desk]")
    call("--python", str(python), "check")
    (tmp_path / "elsewhere").mkdir()
    return Desk(python, tmp_path / "elsewhere")


@pytest.fixture
def dive(tmp_path: Path) -> Path:
    """A storage root with two views of a shell, each with its calibration and rig file."""
    root = tmp_path / "dive"
    (root / "scans").mkdir(parents=True)
    (root / "calibration").mkdir()
    for name, pose in POSES.items():
        scan = render_scan(Scene(object="shell", pose=pose, ambient=0.01), "modelled", 5, SIZE_PX[0], 16)
        store(scan, root / "scans" / name, exposure_ms=12.0, origin=origin_of(scan.renderer.truth, *SIZE_PX))
    return root


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_a_desk_does_all_of_it_from_a_wheel_and_from_another_folder(desk: Desk, dive: Path, tmp_path: Path) -> None:
    """What comes of each call say other tests; here is only asked whether it works with what is installed."""
    code = "import importlib.util as u; print(*(u.find_spec(n) is not None for n in ('pytest', 'mypy', 'tests')))"
    listed = subprocess.run(
        [str(desk.python), "-c", code],
        cwd=desk.folder, env=desk.environment, capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert listed.stdout.split() == ["False"] * 3, "nothing of the developers' is there"

    packed, back = desk.folder / "packed", desk.folder / "back"
    assert desk.json("archive", "pack", dive, "--out", packed)["written"] == 2
    desk("archive", "unpack", packed, "--out", back)
    files = [path.relative_to(dive) for path in dive.rglob("scans/*/*")]
    assert all((back / name).read_bytes() == (dive / name).read_bytes() for name in files)
    desk("scans", "show", packed / "scans" / "000002", "left", "bright", "--out", "frame.png")
    here = desk.json("archive", "reprocess", packed, "--out", "out")
    assert (here["done"], here["failed"], here["left"]) == (2, 0, 0)
    desk("report", here["table"], "--out", "season.html")
    for name, more in (("scan.e57", ()), ("scan.las", ()), ("scan.npz", ()), ("scan.stl", ())):
        desk("cloud", packed / "scans" / "000001", *more, "--out", name)
    foreign = make_set(convention("three-steps"), tmp_path / "foreign", 240)
    assert desk.json("import", foreign.description, "--out", "foreign.ply")["points"] > 5000
    desk("object", "solve", "shell", "000001", "000002", "--root", back)
    desk("cloud", "object:shell", "--root", back, "--spacing", "1", "--out", "shell.ply")
    desk("report", "object:shell", "--root", back, "--spacing", "1", "--out", "shell.html")
    made = (
        "frame.png",
        "season.html",
        "scan.e57",
        "scan.las",
        "scan.npz",
        "scan.stl",
        "foreign.ply",
        "shell.ply",
        "shell.html",
    )
    assert all((desk.folder / name).stat().st_size > 5000 for name in made)
