"""Scans through a real sshd with the very settings of the image: what it gives, what it refuses, and what a broken link costs.

Only what cannot be so in a test is changed in the settings: port, places of keys and root, and the user, who is ``nobody`` here.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from appliance.cli import main
from appliance.store import scan as stored
from appliance.store.library import Library
from appliance.store.manifest import Decision
from appliance.store.pull.source import SshLink
from kingfisher_transfer import keys, serving
from kingfisher_transfer.serving import Places
from tests.appliance.store.pull.instrument import FS, content, instrument, pulled
from tests.appliance.store.scenes import ORIGIN, record

SYSTEMD = Path(__file__).parents[2] / "systemd"
pytestmark = [
    pytest.mark.foreign,
    pytest.mark.skipif(not Path(serving.SSHD).exists(), reason="openssh-server is not installed; ./dev test --stage=foreign installs it"),
    pytest.mark.skipif(os.geteuid() != 0, reason="sshd shuts a user in (ChrootDirectory) only as root"),
]  # fmt: skip
USER = "nobody"
LIMIT_S = 20.0


@dataclass(frozen=True)
class Served:
    """A server that runs."""

    port: int
    places: Places
    root: Path
    """What it shows."""
    identity: Path
    known_hosts: Path

    def link(self) -> SshLink:
        return SshLink(f"{USER}@127.0.0.1", self.port, self.identity, self.known_hosts, LIMIT_S)

    def sftp(self, *lines: str) -> str:
        """Return what the sftp program says to each line; it goes on after a refusal."""
        options = (
            f"UserKnownHostsFile={self.known_hosts}",
            "StrictHostKeyChecking=yes",
            "IdentitiesOnly=yes",
            "BatchMode=yes",
        )
        settings = ["-F", "none", "-i", str(self.identity), *(word for option in options for word in ("-o", option))]
        done = subprocess.run(
            ["sftp", "-b", "-", *settings, "-P", str(self.port), f"{USER}@127.0.0.1"],
            input="".join(f"-{line}\n" for line in lines), capture_output=True, text=True, timeout=30, check=False,
        )  # fmt: skip
        return done.stdout + done.stderr

    def sessions(self) -> list[int]:
        """Return the processes that serve a link: those of this user that descend from this process."""
        words = ["pgrep", "-u", USER, "-f", f"sshd.*{USER}"]
        found = subprocess.run(words, capture_output=True, text=True, timeout=10, check=False).stdout.split()
        return [pid for pid in map(int, found) if _below(pid, os.getpid())]


def _below(pid: int, ancestor: int) -> bool:
    while pid > 1 and pid != ancestor:
        try:
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            return False
    return pid == ancestor


@contextmanager
def serving_at(top: Path, port: int) -> Iterator[Places]:
    """The program that serves, in this process, until the block ends."""
    settings = (SYSTEMD / "kingfisher-sshd.conf").read_text()
    places = Places(
        *(top / name for name in ("note", "status", "sshd.conf", "host_ed25519", "authorized_keys", "news"))
    )
    for name, value in (
        ("Port", f"{port}\nListenAddress 127.0.0.1"), ("HostKey", places.host_key), ("AuthorizedKeysFile", places.authorized),
        ("AllowUsers", USER), ("ChrootDirectory", top / "root"),
    ):  # fmt: skip
        settings, count = re.subn(rf"^{name} .*$", f"{name} {value}", settings, flags=re.MULTILINE)
        assert count == 1, name
    places.config.write_text(settings)
    places.note.touch()
    ready, stopping = threading.Event(), threading.Event()
    thread = threading.Thread(target=serving.serve, args=(places, ready.set, stopping))
    thread.start()
    try:
        assert ready.wait(30)
        yield places
    finally:
        stopping.set()
        thread.join(30)
        assert not thread.is_alive()


@pytest.fixture
def top() -> Iterator[Path]:
    """A folder whose parents are root's alone: sshd trusts no other."""
    Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="kingfisher-test-", dir="/run"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def served(top: Path, tmp_path: Path) -> Iterator[Served]:
    shown = top / "root"
    (shown / "instrument").mkdir(parents=True)
    shutil.move(instrument(tmp_path / "disk"), shown / "data")
    shutil.move(tmp_path / "disk" / "etc" / "kingfisher" / "rig.toml", shown / "instrument")
    identity = tmp_path / "id"
    made = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "desk", "-f", str(identity)]
    subprocess.run(made, check=True, timeout=30)
    keys.enrol(top / "authorized_keys", identity.with_suffix(".pub").read_bytes())
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = int(one.getsockname()[1])
    with serving_at(top, port) as places:
        known_hosts = tmp_path / "known_hosts"
        known_hosts.write_text(f"[127.0.0.1]:{port} {places.host_key.with_suffix('.pub').read_text()}")
        running = Served(port, places, shown, identity, known_hosts)
        yield running
        for pid in running.sessions():
            os.kill(pid, signal.SIGKILL)


def large_scan(root: Path, number: str) -> Path:
    """A scan of 24 MB."""
    chance = np.random.default_rng(1)
    frames = {side: chance.integers(0, 256, (3, 2000, 2000), np.uint8) for side in ("left", "right")}
    folder = root / "scans" / number
    raw = stored.write_raw(FS, folder, number, frames, record(), ORIGIN)
    stored.finish_scan(FS, folder, raw, Decision.KEPT, record(), None, None)
    return folder


def test_everything_comes_through_the_server(
    served: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = tmp_path / "desk"
    typed = [
        "archive",
        "pull",
        f"{USER}@127.0.0.1:{served.port}",
        "--out",
        str(here),
        "--identity",
        str(served.identity),
    ]
    typed += ["--known-hosts", str(served.known_hosts), "--all", "--json"]
    assert main(typed) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["taken"], said["being_written"], said["links"]) == (8, 1, 1)
    theirs = content(served.root / "data")
    assert {path: content(here).get(path) for path in theirs} == theirs
    assert (here / "instrument" / "rig.toml").read_text() == 'serial = "KF-0001"\n'
    assert all(Library(here).verify(number).ok for number in ("000001", "000002", "000003"))
    assert main(typed) == 0
    assert json.loads(capsys.readouterr().out)["taken"] == 0
    told = json.loads(served.places.status.read_text())
    assert (told["state"], told["keys"]) == ("on", 1)
    assert served.places.host_key.stat().st_mode & 0o777 == 0o600


def test_nothing_can_be_written_even_where_the_user_may_and_nothing_else_is_seen(
    served: Served, tmp_path: Path
) -> None:
    subprocess.run(["chown", "-R", USER, served.root / "data"], check=True, timeout=30)
    subprocess.run(["chmod", "-R", "u+rwX", served.root / "data"], check=True, timeout=30)
    before = content(served.root)
    modes = {path: (path.stat().st_mode, path.stat().st_mtime_ns) for path in served.root.rglob("*")}
    mine = tmp_path / "mine"
    mine.write_text("x")
    tried = (
        f"put {mine} /data/scans/evil", f"put {mine} /data/scans/000001/manifest.json", "rm /data/scans/000001/cloud.ply",
        "rename /data/scans/000001 /data/scans/000009", "mkdir /data/evil", "rmdir /data/scans/.000005",
        "chmod 777 /data/scans", "symlink /etc /data/evil", "ln /data/scans/000001/cloud.ply /data/evil",
        f"reput {mine} /data/scans/000001/manifest.json", "chgrp 0 /data/scans/000001/manifest.json",
    )  # fmt: skip
    said = served.sftp(*tried, "ls -1 /", "ls -1 /etc", "ls -1 /data/../../../etc")
    # Two end before they are sent: the server offers no hard links, and half a file is no longer than one here.
    assert said.lower().count("permission denied") == len(tried) - 2, said
    assert ({"/data", "/instrument"} <= set(said.split()), said.count('/etc" not found')) == (True, 2), said
    assert content(served.root) == before
    assert {path: (path.stat().st_mode, path.stat().st_mtime_ns) for path in served.root.rglob("*")} == modes


def test_sshd_itself_understands_the_settings_so(served: Served) -> None:
    """Behind the forced command lies the user's shell, which lets nobody in either: only sshd's own word tells them apart."""
    who = f"user={USER},host=desk,addr=192.0.2.1"
    command = [serving.SSHD, "-T", "-C", who, "-f", str(served.places.config)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True).stdout
    found = dict(line.split(" ", 1) for line in said.splitlines() if " " in line)
    wanted = {
        "forcecommand": "internal-sftp -R -d /", "chrootdirectory": str(served.root), "authenticationmethods": "publickey",
        "passwordauthentication": "no", "kbdinteractiveauthentication": "no", "permitrootlogin": "no", "permittty": "no",
        "disableforwarding": "yes", "allowtcpforwarding": "no", "allowagentforwarding": "no", "allowstreamlocalforwarding": "no",
        "x11forwarding": "no", "permittunnel": "no", "permituserenvironment": "no", "permituserrc": "no", "usepam": "no",
        "allowusers": USER, "hostbasedauthentication": "no",
    }  # fmt: skip
    assert {name: found.get(name) for name in wanted} == wanted


def test_a_link_that_is_cut_in_a_file_is_opened_again_and_goes_on_there(served: Served, tmp_path: Path) -> None:
    large_scan(served.root / "data", "000007")
    here, armed = tmp_path / "desk", True
    cuts: list[list[int]] = []

    def far(_doing: str, _done: int, _of: int, done_bytes: int, _of_bytes: int) -> None:
        # What is on the way still comes after a cut; a link that was opened anew counts from nothing again.
        nonlocal armed
        armed = armed or done_bytes < 3_000_000
        if done_bytes > 5_000_000 and armed and len(cuts) < 2:
            cuts.append(served.sessions())
            for pid in cuts[-1]:
                os.kill(pid, signal.SIGKILL)
            armed = False

    done = pulled(served.link(), here, far=far)
    assert (len(cuts), all(cuts), done.links, done.is_complete) == (2, True, 3, True)
    came = content(here)
    assert content(here / "scans" / "000007") == content(served.root / "data" / "scans" / "000007")
    sizes = (len(data) for path, data in came.items() if "manifest" not in path and "incomplete.json" not in path)
    assert done.taken_bytes == sum(sizes), "nothing was taken twice"
