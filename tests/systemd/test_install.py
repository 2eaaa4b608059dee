"""The real setup in a real Debian: everything is there, the program runs as its user, upgrade and uninstall keep the data.

What it needs says ``tests.systemd.debian``; many minutes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.systemd.debian import ELSEWHERE, REPOSITORY, as_service, copied, debian, newer, run, setup

pytestmark = ELSEWHERE


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source tree as it is now: somebody may work on it meanwhile, and another tree is another version."""
    return copied(REPOSITORY, tmp_path_factory.mktemp("source") / "tree")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, tree: Path) -> Iterator[Path]:
    """A Debian with Kingfisher on it."""
    with debian(tmp_path_factory.mktemp("debian")) as folder:
        setup(tree, folder, "install")
        yield folder


def test_everything_is_in_its_place(root: Path, tree: Path) -> None:
    wants = root / "etc/systemd/system/multi-user.target.wants/kingfisher.service"
    assert os.readlink(wants) == "/etc/systemd/system/kingfisher.service"  # noqa: PTH115
    for name in ("kingfisher.service", "kingfisher-safe.service", "kingfisher-trial.service"):
        assert (root / "etc/systemd/system" / name).read_text() == (tree / "systemd" / name).read_text()
    assert "kingfisher:" in (root / "etc/passwd").read_text()
    assert (root / "etc/kingfisher/rig.toml").exists()
    verified = run("chroot", root, "systemd-analyze", "verify", "--man=no", "kingfisher.service", check=False)
    assert "kingfisher" not in verified.stderr  # now with the real programs


def test_the_program_runs_as_its_user_and_compiles_nothing(root: Path) -> None:
    assert as_service(root, "kingfisher", "version").stdout.startswith("kingfisher ")
    cache = root / "var/cache/kingfisher"
    cache.mkdir(exist_ok=True)
    run("chroot", root, "chown", "kingfisher:", "/var/cache/kingfisher")
    script = "from appliance import kernel_cache; print(kernel_cache.use().origin.value)"
    assert as_service(root, "/opt/kingfisher/current/bin/python", "-c", script).stdout.strip() == "shipped"


def test_the_safe_screen_runs_without_the_environment(root: Path) -> None:
    code = "import sys; sys.argv = ['x']; sys.path[:0] = ['/opt/kingfisher/rescue']; import kingfisher_safe.main"
    assert as_service(root, "/usr/bin/python3", "-I", "-S", "-c", code).returncode == 0


def test_a_second_call_changes_nothing(root: Path, tree: Path) -> None:
    before = {path: path.lstat().st_mtime_ns for path in (root / "opt/kingfisher").glob("versions/*/*")}
    assert "is built already" in setup(tree, root, "install")
    assert {path: path.lstat().st_mtime_ns for path in (root / "opt/kingfisher").glob("versions/*/*")} == before


def test_an_upgrade_is_tried_at_the_next_start_and_uninstalling_keeps_the_data(
    root: Path, tree: Path, tmp_path: Path
) -> None:
    scans = root / "var/lib/kingfisher/scans/000001"
    scans.mkdir(parents=True)
    (scans / "manifest.json").write_text("{}")
    rig = root / "etc/kingfisher/rig.toml"
    rig.write_text(rig.read_text().replace('"KF-0001"', '"KF-0042"'))
    upgrade = newer(tree, tmp_path / "newer")
    old = os.readlink(root / "opt/kingfisher/current")  # noqa: PTH115
    assert "on trial from the next start on" in setup(upgrade, root, "upgrade")
    on_trial = json.loads((root / "opt/kingfisher/trial.json").read_text())
    assert on_trial["version"].startswith("9.")
    assert f"versions/{on_trial['previous']}" == old
    assert "on trial" in setup(upgrade, root, "upgrade", check=False)  # not another one meanwhile
    setup(tree, root, "rollback")
    assert os.readlink(root / "opt/kingfisher/current") == old  # noqa: PTH115
    assert '"KF-0042"' in rig.read_text()
    setup(tree, root, "uninstall")
    assert not (root / "opt/kingfisher").exists()
    assert not list((root / "etc").rglob("*kingfisher*.service"))
    assert (scans / "manifest.json").exists()
    assert rig.exists()
    setup(tree, root, "uninstall", "--purge")
    assert not (root / "var/lib/kingfisher").exists()
    assert not rig.exists()
