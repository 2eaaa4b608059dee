"""Everything that the setup can be asked for, on a pretended instrument whose programs only write down how they were called."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from kingfisher_setup import build, main, placed, target, trial, versions
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout
from tests.systemd.installation import make

PROGRAM = """#!/bin/sh
echo "${0##*/} $*" >> LOG
case "$*" in
*version_info*) echo " PYTHON " ;;
*dpkg-query*libegl1) echo not-installed ;;
*dpkg-query*udev) exit 1 ;;
*dpkg-query*) echo "installed " ;;
esac
"""
"""Every program of the instrument, by links."""
NAMES = ("chroot", "systemctl", "systemd-sysusers", "systemd-tmpfiles", "udevadm", "update-grub", "usermod", "apt-get")
LOCK = """--index-url x
numpy==2.0 \\
    --hash=sha256:aa
    # via
    #   kingfisher
    #   numba
Foo.Bar==1 --hash=sha256:bb
    # via numpy
pytest==9 --hash=sha256:cc
    # via kingfisher
setuptools==70 --hash=sha256:dd
"""


@dataclass
class Pretended:
    root: Path
    tree: Path
    programs: Path

    @property
    def layout(self) -> Layout:
        return Layout(self.root)

    def python(self, version: str) -> None:
        """Let the instrument's Python be of this version."""
        log = self.programs / "log"
        text = PROGRAM.replace("LOG", str(log)).replace("PYTHON", version)
        (self.programs / "any").write_text(text)
        (self.programs / "any").chmod(0o755)

    def called(self) -> list[str]:
        """What was called since the last question, without the root."""
        log = self.programs / "log"
        said = log.read_text() if log.exists() else ""
        log.unlink(missing_ok=True)
        return [line.removeprefix(f"chroot {self.root} ").rstrip() for line in said.splitlines()]

    def setup(self, *words: str) -> int:
        return main.main([*words, "--root", str(self.root)])


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Pretended]:
    """A small source tree, and an image with nothing on it."""
    made = Pretended(tmp_path / "root", tmp_path / "tree", tmp_path / "programs")
    made.root.mkdir()
    made.programs.mkdir()
    made.python("3.11")
    for name in NAMES:
        (made.programs / name).symlink_to("any")
    for name, text in {
        "appliance/__init__.py": '"""Words."""\n__version__ = "1.2.3"\n', "appliance/rigs/kingfisher.toml": "[board]\n[keys]\n",
        "appliance/__pycache__/a.pyc": "old", "drivers/__init__.py": "", "drivers/output/__init__.py": "",
        "drivers/output/drm.py": "# drm\n", "hw_sim/__init__.py": "", "systemd/install": "#!/bin/sh\n",
        "systemd/kingfisher.service": "[Unit]\n", "systemd/kingfisher.sysusers": "u kingfisher\n",
        "pyproject.toml": '[project]\ndependencies = ["NumPy>=2"]\n[build-system]\nrequires = ["setuptools"]\n',
        "requirements.lock": LOCK, "README.md": "", "LICENSE": "", "notes.txt": "mine", "wheels/a.whl": "", "wheels/b.txt": "",
    }.items():  # fmt: skip
        (made.tree / name).parent.mkdir(parents=True, exist_ok=True)
        (made.tree / name).write_text(text)
    (made.tree / "systemd/install").chmod(0o700)
    shadow = made.root / "etc/shadow"
    shadow.parent.mkdir()
    shadow.write_text("root:*:\nkingfisher-pull:!:\n")
    monkeypatch.setattr(main, "TREE", made.tree)
    monkeypatch.setattr(target, "PATH", str(made.programs))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(0, 0, 1_500_000_000))  # type: ignore[attr-defined]
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    before = os.umask(0o077)
    yield made
    os.umask(before)


def built(there: Pretended) -> str:
    return build.build(there.layout, there.tree, there.tree / "wheels", lambda _: None)


def test_a_version_is_whole_and_made_where_it_stays(there: Pretended) -> None:
    (half := there.layout.version(build.name_of(there.tree))).mkdir(parents=True)
    (half / "left").touch()
    name = built(there)
    inside, folder = f"/opt/kingfisher/versions/{name}", there.layout.version(name)
    assert name.startswith("1.2.3-")
    venv, *pips, warm, compiled, checked = [
        line.replace(inside, "@") for line in there.called() if "version_info" not in line
    ][:6]
    assert (venv, warm, compiled) == (
        "/usr/bin/python3 -m venv @", "@/bin/kingfisher warm --common", "@/bin/python -m compileall -q @/lib @/systemd",
    )  # fmt: skip
    assert [pip.split("--no-compile ")[1] for pip in pips] == [
        "--require-hashes --find-links @/wheels -r @/packages.txt", "--no-build-isolation @/source",
    ]  # fmt: skip
    assert all("--no-index" in pip for pip in pips)
    assert checked.startswith("@/bin/python -c")
    assert {path.name for path in folder.iterdir()} == {"packages.txt", "systemd", "complete"}
    pins = (folder / "packages.txt").read_text()
    assert [line.split("==")[0] for line in pins.splitlines() if "==" in line] == ["numpy", "Foo.Bar", "setuptools"]
    assert (folder / "systemd/drivers/output/drm.py").read_text() == "# drm\n"
    assert [(folder / "systemd" / one).stat().st_mode & 0o777 for one in ("install", "kingfisher.service")] == [
        0o755,
        0o644,
    ]
    assert (folder / "systemd/install").stat().st_mtime % 1 == 0
    assert there.layout.rig.read_text() == "[board]\n[keys]\n"


def test_a_name_changes_with_every_file_that_counts_and_what_is_built_stays(there: Pretended) -> None:
    name = built(there)
    (there.tree / "appliance/__pycache__/a.pyc").write_text("new")
    (there.tree / "notes.txt").write_text("others")
    there.layout.rig.write_text("mine")
    there.called()
    assert (built(there), there.called()) == (name, [])
    (there.tree / "LICENSE").write_text("another")
    assert built(there) != name
    assert there.layout.rig.read_text() == "mine"


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda tree: (tree / "LICENSE").unlink(), "LICENSE not found"),
        (lambda tree: (tree / "appliance/__init__.py").write_text(""), "states no __version__"),
        (lambda tree: (tree / "wheels/a.whl").unlink(), "no wheels there"),
        (lambda tree: (tree / "requirements.lock").write_text("pip==1\n"), "does not pin numpy, setuptools"),
    ],
)
def test_what_a_version_cannot_be_made_of_is_named(there: Pretended, spoil: object, said: str) -> None:
    assert callable(spoil)
    spoil(there.tree)
    with pytest.raises(SetupError, match=said):
        built(there)
    assert versions.installed(there.layout) == ()


def test_packages_for_another_python_are_not_fetched(there: Pretended) -> None:
    there.python("3.1")
    with pytest.raises(SetupError, match=r"has Python 3.1, this machine 3\.\d+: .* give --wheels"):
        build.build(there.layout, there.tree, None, lambda _: None)


def test_debian_packages_that_are_missing_are_named(there: Pretended, capsys: pytest.CaptureFixture[str]) -> None:
    assert target.missing_packages(there.layout) == ("libegl1", "udev")
    assert "dpkg-query -W -f ${db:Status-Status} libpython3.11" in there.called()
    assert there.setup("install") == 1
    assert "lacks these Debian packages, install them there first: libegl1 udev" in capsys.readouterr().err
    there.python("3.10")
    with pytest.raises(SetupError, match=r"Python 3.10; 3.11 or later"):
        target.needed_packages(there.layout)
    (there.programs / "chroot").unlink()
    assert target.needed_packages(there.layout)[:2] == ("python3", "python3-venv")
    with pytest.raises(SetupError, match="`chroot`: No such file or directory; install it"):
        target.run(there.layout, ["true"])


def test_a_program_that_fails_says_its_last_words(there: Pretended) -> None:
    here = Layout(Path("/"))
    for command, said in (("echo out; exit 3", r"failed \(exit code 3\):\nout"), ("seq 9 >&2; exit 1", r"\n2\n.*\n9$")):
        with pytest.raises(SetupError, match=f"(?s){said}"):
            target.run(here, ["/bin/sh", "-c", f"PATH=/bin:/usr/bin; {command}"])
    with pytest.raises(SetupError, match="did not end within 0 s"):
        target.run(here, ["/bin/sleep", "9"], timeout_s=0.01)
    assert target.run(here, ["/bin/sh", "-c", "echo $A $HOME"], {"A": "a"}) == "a /root\n"
    carried = target.carried({"PIP_CERT": "c", "http_proxy": "p", "HOME": "h"})
    assert carried == {"PIP_CERT": "c", "http_proxy": "p"}


def test_from_the_first_version_to_none(
    there: Pretended, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(target, "LIBRARIES", ())
    wheels = ("--wheels", str(there.tree / "wheels"))
    assert there.setup("install", *wheels) == 0
    first = versions.current(there.layout)
    assert first is not None
    assert there.layout.rescue.readlink() == Path(f"versions/{first}/systemd")
    assert f"{first} is installed; it starts when the image does" in capsys.readouterr().out
    assert there.called()[-2:] == ["systemd-sysusers", "usermod --password * kingfisher-pull"]
    (there.root / "etc/shadow").write_text("root:*:\nkingfisher-pull:*:\n")
    (there.tree / "LICENSE").write_text("another")
    there.layout.self_test.parent.mkdir(parents=True)
    there.layout.self_test.write_text(f'{{"installation": "{first}", "failed": ["keys"]}}')
    assert there.setup("upgrade", *wheels) == 0
    second = versions.current(there.layout)
    assert f"{second} is on trial from the next start on; {first} comes back if it fails" in capsys.readouterr().out
    assert there.called()[-1] == "systemd-sysusers"
    on_trial = versions.trial(there.layout)
    assert on_trial is not None
    assert (on_trial.version, on_trial.previous, on_trial.may_fail) == (second, first, ("keys",))
    assert there.setup("install") == 1
    assert f"{second} is on trial; wait" in capsys.readouterr().err
    assert there.setup("status") == 0
    assert sorted(capsys.readouterr().out.splitlines()) == sorted(
        [f"{first:<24}".rstrip(), f"{second:<24} in use, on trial"]
    )
    assert there.setup("rollback") == 0
    assert (versions.current(there.layout), f"{first} is in use again" in capsys.readouterr().out) == (first, True)
    assert there.setup("rollback") == 1
    assert "there is no version before this one" in capsys.readouterr().err
    versions.switch(there.layout, str(second))
    assert there.setup("rollback") == 0
    assert versions.current(there.layout) == first
    capsys.readouterr()
    there.setup("status")
    told = capsys.readouterr().out
    assert f"{first:<24} in use" in told
    assert f"{second:<24} before" in told
    assert f"last trial: {second} was taken back: taken back by hand" in told
    assert there.setup("uninstall") == 0
    assert not there.layout.program.exists()
    assert not list((there.root / "etc").rglob("*kingfisher*.service"))
    assert there.layout.rig.exists()
    (there.root / "var/cache/kingfisher").mkdir(parents=True)
    assert there.setup("uninstall", "--purge") == 0
    assert [path.name for path in (there.root / "var/lib", there.root / "var/cache") if list(path.iterdir())] == []
    assert not there.layout.rig.parent.exists()
    there.setup("status")
    assert "nothing is installed" in capsys.readouterr().out


def test_who_may_not_and_what_has_no_room_is_refused(
    there: Pretended, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(target, "LIBRARIES", ())
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(0, 0, 1_499_000_000))  # type: ignore[attr-defined]
    assert there.setup("install") == 1
    assert "has 1499 MB free; a version needs 1500 MB" in capsys.readouterr().err
    monkeypatch.setattr(os, "geteuid", lambda: 7)
    assert there.setup("rollback") == 1
    assert "run it as root" in capsys.readouterr().err
    assert there.setup("status") == 0
    assert main.main(["status", "--root", str(there.root / "none")]) == 1
    assert "no such folder" in capsys.readouterr().err


class Live(Layout):
    """A folder that is taken for the instrument itself."""

    live = True  # type: ignore[assignment]


def test_on_a_running_instrument_systemd_takes_notice(
    there: Pretended, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    layout = Live(there.root)
    monkeypatch.setenv("PATH", str(there.programs))
    monkeypatch.setattr(target, "BOOTED", tmp_path)
    monkeypatch.setattr(target, "UDEV", tmp_path / "udev")
    one = make(there.root)
    (there.root / "boot/grub").mkdir(parents=True)
    (there.root / "boot/grub/grub.cfg").touch()
    versions.try_out(layout, "new")
    main.rollback(layout)
    asked = "systemctl --no-ask-password"
    restarted = f"{asked} restart --no-block kingfisher.service"
    noticed = [
        "systemd-sysusers", "usermod --password * kingfisher-pull", f"{asked} daemon-reload", "systemd-tmpfiles --create",
        f"{asked} try-restart systemd-journald.service", "update-grub",
    ]  # fmt: skip
    assert there.called() == [*noticed, restarted]
    assert "udev does not run" in capsys.readouterr().out
    assert one.unit() == "old"
    (tmp_path / "udev").touch()
    (unit := layout.at(placed.UNITS / placed.TRANSFER)).touch()
    main._system(layout)
    tail = [f"{asked} restart {placed.TRANSFER}", "udevadm control --reload", "udevadm trigger"]
    assert there.called() == [*noticed[:4], *tail, *noticed[4:]]
    assert versions.outcome(layout) == versions.Outcome("new", False, "taken back by hand", "old")
    with pytest.raises(SetupError, match="new was taken back: taken back by hand; old is in use again"):
        main._await_outcome(layout, "new")
    with monkeypatch.context() as hurried:
        hurried.setattr(trial, "LIMIT_S", 0.0)
        with pytest.raises(SetupError, match="the trial has not ended"):
            main._await_outcome(layout, "newer")
    assert versions.try_out(layout, "new")
    at = versions.settle(layout)
    assert at is not None
    versions.accept(layout, at)
    main._await_outcome(layout, "new")
    assert "new has passed its self-test and stays" in capsys.readouterr().out
    assert unit.exists() is False, "no version has it"
    layout.at(placed.UNITS / "kingfisher-keys@.service").touch()
    there.called()
    main.uninstall(layout, purge=False)
    assert there.called()[0] == f"{asked} disable --now kingfisher.service kingfisher-trial.service"
