"""What the setup can be asked for, on a pretended instrument whose programs only write down how they were called."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from kingfisher_setup import build, durable, main, placed, target, trial, versions
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout
from tests.systemd.installation import make

PROGRAM = """#!/bin/sh
echo "${0##*/} $*" >> LOG
case "$*" in *version_info*) echo " 3.11 " ;; *dpkg-query*) echo "installed " ;; *show*) echo NRestarts=2 ;; esac
"""
NAMES = "chroot systemctl systemd-sysusers systemd-tmpfiles udevadm update-grub usermod"
PINS = "numpy==2.0 \\\n    # via\n    #   kingfisher\nFoo.Bar==1\n    # via numpy\npytest==9\nsetuptools==70\n"
EMPTY = """drivers/__init__.py drivers/output/__init__.py drivers/output/drm.py hw_sim/__init__.py README.md LICENSE wheels/a.whl
systemd/install systemd/kingfisher.service systemd/kingfisher.sysusers appliance/__pycache__/a"""
TREE = dict.fromkeys(EMPTY.split(), "") | {
    "appliance/__init__.py": '__version__ = "1.2.3"\n',
    "appliance/store/rigs/kingfisher.toml": "rig",
    "pyproject.toml": '[project]\ndependencies = ["NumPy>=2"]\n[build-system]\nrequires = ["setuptools"]\n',
    "requirements.lock": PINS,
}


class Pretended:
    """A small source tree, and an image with nothing on it but a locked account."""

    def __init__(self, top: Path) -> None:
        self.layout, self.tree, self.programs = Layout(top / "root"), top / "tree", top / "programs"
        for name, text in TREE.items():
            durable.write(self.tree / name, text.encode())
        (self.tree / "systemd/install").chmod(0o700)
        durable.write(self.layout.at("/etc/shadow"), b"\nkingfisher-pull:!:\n")
        durable.write(self.programs / "log", b"")
        for name in NAMES.split():
            durable.write(self.programs / name, PROGRAM.replace("LOG", f"{self.programs}/log").encode(), 0o755)

    def called(self) -> list[str]:
        """What was called since the last question."""
        said = (self.programs / "log").read_text()
        (self.programs / "log").write_text("")
        return [line.removeprefix(f"chroot {self.layout.root} ").rstrip() for line in said.splitlines()]


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Pretended:
    made = Pretended(tmp_path)
    monkeypatch.setattr(main, "TREE", made.tree)
    monkeypatch.setattr(target, "PATH", str(made.programs))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(os, "umask", lambda _: 0)
    return made


def built(there: Pretended) -> str:
    return build.build(there.layout, there.tree, there.tree / "wheels", lambda _: None)


def test_a_version_is_whole_and_made_where_it_stays(there: Pretended) -> None:
    folder = there.layout.version(build.name_of(there.tree))
    durable.write(folder / "left half made", b"")
    inside = f"/opt/kingfisher/versions/{built(there)}"
    *made, checked = [line.replace(inside, "@") for line in there.called()][:6]
    assert [line.split("-q install --no-deps --no-index --no-compile ")[-1] for line in made] == [
        "/usr/bin/python3 -m venv @",
        "--require-hashes --find-links @/wheels -r @/packages.txt",
        "--no-build-isolation @/source",
        "@/bin/kingfisher setup compile --common",
        "@/bin/python -m compileall -q @/lib @/systemd",
    ]
    assert checked.startswith("@/bin/python -c")
    assert {path.name for path in folder.iterdir()} == {"packages.txt", "systemd", "complete"}
    assert (folder / "packages.txt").read_text() == PINS.replace("pytest==9\n", "")
    about = [(folder / "systemd" / name).stat() for name in ("install", "drivers/output/drm.py")]
    assert [(one.st_mode & 0o777, one.st_mtime % 1) for one in about] == [(0o755, 0), (0o644, 0)]
    assert there.layout.rig.read_text() == "rig"
    there.layout.rig.write_text("mine")
    (there.tree / "appliance/__pycache__/a").write_text("new")
    assert (built(there), there.called()) == (folder.name, []), "it is built already"
    (there.tree / "LICENSE").write_text("another")
    assert (built(there) != folder.name, there.layout.rig.read_text()) == (True, "mine")
    for name, said in (("requirements.lock", "not pin numpy, setuptools"), ("appliance/__init__.py", "no __version__")):
        (there.tree / name).write_text("")
        with pytest.raises(SetupError, match=said):
            built(there)
    shutil.rmtree(there.tree / "hw_sim")
    with pytest.raises(SetupError, match="hw_sim not found"):
        built(there)


def test_from_the_first_version_to_none(
    there: Pretended, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def after(verb: str, text: str, code: int = 0) -> str:
        """The version in use after ``verb``, which says ``text``."""
        words = [*verb.split(), "--wheels", str(there.tree / "wheels"), "--root", str(there.layout.root)]
        assert main.main(words) == code
        told = capsys.readouterr()
        assert text in told.out + told.err
        return str(versions.current(there.layout))

    after("status", "nothing is installed")
    first = after("install", "is installed; it starts when the image does")
    assert there.layout.rescue.readlink() == Path(f"versions/{first}/systemd")
    assert there.called()[-2:] == ["systemd-sysusers", "usermod --password * kingfisher-pull"]
    there.layout.at("/etc/shadow").write_text("\nkingfisher-pull:*:\n")
    (there.tree / "LICENSE").write_text("another")
    durable.write_json(there.layout.self_test, {"installation": first, "failed": ["keys"]})
    second = after("upgrade", f"is on trial from the next start on; {first} comes back if it fails")
    assert there.called()[-1] == "systemd-sysusers"
    assert versions.trial(there.layout) == versions.Trial(second, first, may_fail=("keys",))
    after("install", f"{second} is on trial; wait", 1)
    after("status", f"{second:<24} in use, on trial")
    assert after("rollback", f"{first} is in use again") == first
    after("status", f"last trial: {second} was taken back: taken back by hand")
    after("rollback", "there is no version before this one", 1)
    versions.switch(there.layout, second)
    after("status", f"{first:<24} before")
    assert after("rollback", "is in use again") == first
    after("uninstall", "are still there")
    left = (there.layout.program, there.layout.at("/etc/systemd/system/kingfisher.service"), there.layout.rig)
    assert [path.exists() for path in left] == [False, False, True]
    after("uninstall --purge", "uninstalled")
    assert [path.exists() for path in (there.layout.data, there.layout.rig.parent)] == [False, False]
    monkeypatch.setattr(main, "ROOT_FREE_MB", 1 << 40)
    after("install", "MB free; a version needs", 1)
    (there.programs / "chroot").unlink()
    after("install", "lacks these Debian packages, install them there first: python3 python3-venv", 1)
    monkeypatch.setattr(os, "geteuid", lambda: 7)
    after("rollback", "run it as root", 1)


def test_on_a_running_instrument_systemd_takes_notice(
    there: Pretended, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    layout, asked = there.layout, "systemctl --no-ask-password"
    monkeypatch.setattr(Layout, "live", True)
    monkeypatch.setenv("PATH", str(there.programs))
    monkeypatch.setattr(target, "BOOTED", tmp_path)
    monkeypatch.setattr(target, "UDEV", tmp_path / "udev")
    make(layout.root)
    durable.write(layout.at("/boot/grub/grub.cfg"), b"")
    versions.try_out(layout, "new")
    main.rollback(layout)
    first = ["systemd-sysusers", "usermod --password * kingfisher-pull", f"{asked} daemon-reload"]
    first += ["systemd-tmpfiles --create"]
    last = [f"{asked} try-restart systemd-journald.service", "update-grub"]
    restarted = f"{asked} restart --no-block kingfisher.service"
    assert there.called() == [*first, *last, restarted]
    assert "udev does not run" in capsys.readouterr().out
    for path in (tmp_path / "udev", unit := layout.at(placed.UNITS / placed.TRANSFER)):
        path.touch()
    main._system(layout)
    more = [f"{asked} restart {unit.name}", "udevadm control --reload", "udevadm trigger"]
    assert there.called() == [*first, *more, *last]
    with pytest.raises(SetupError, match="new was taken back: taken back by hand; old is in use again"):
        main._await_outcome(layout, "new")
    versions.accept(layout, versions.Trial("new", "old"))
    main._await_outcome(layout, "new")
    assert "new has passed its self-test and stays" in capsys.readouterr().out
    versions.switch(layout, "old")
    versions.try_out(layout, "new")
    assert (trial.watch(layout, 9.0), versions.current(layout)) == (0, "old")
    assert there.called()[-2:] == [f"{asked} reset-failed kingfisher.service", restarted]
    main.uninstall(layout, purge=False)
    assert there.called()[0] == f"{asked} disable --now kingfisher.service kingfisher-trial.service"
