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
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from appliance.cli import main
from appliance.offline.pull.pulling import HowFar, pull
from appliance.offline.pull.source import PullError
from appliance.offline.pull.ssh import Host, SshLink
from appliance.storage import scan as stored
from appliance.storage.library import Library
from appliance.storage.manifest import Decision
from kingfisher_transfer import keys, serving
from kingfisher_transfer.serving import Places
from tests.appliance.offline.pull.instrument import FS, content, instrument, pulled
from tests.appliance.storage.scenes import ORIGIN, record

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

    @property
    def host(self) -> Host:
        return Host(f"{USER}@127.0.0.1", self.port, self.identity, self.known_hosts)

    def link(self, limit_s: float = LIMIT_S) -> SshLink:
        return SshLink(self.host, limit_s)

    def ssh(
        self, *options: str, command: tuple[str, ...] = (), stdin: bytes = b""
    ) -> subprocess.CompletedProcess[bytes]:
        settings = ["-o", f"UserKnownHostsFile={self.known_hosts}", "-o", "StrictHostKeyChecking=yes"]
        settings += ["-o", "IdentitiesOnly=yes", "-i", str(self.identity), "-p", str(self.port)]
        return subprocess.run(
            ["ssh", "-F", "none", *settings, *options, f"{USER}@127.0.0.1", *command],
            input=stdin, capture_output=True, timeout=30, check=False,
        )  # fmt: skip

    def sftp(self, *lines: str) -> str:
        """What the sftp program says to each line; it goes on after a refusal."""
        settings = ["-o", f"UserKnownHostsFile={self.known_hosts}", "-o", "StrictHostKeyChecking=yes"]
        settings += ["-o", "BatchMode=yes", "-o", "IdentitiesOnly=yes", "-i", str(self.identity), "-P", str(self.port)]
        done = subprocess.run(
            ["sftp", "-F", "none", "-b", "-", *settings, f"{USER}@127.0.0.1"],
            input="".join(f"-{line}\n" for line in lines), capture_output=True, text=True, timeout=30, check=False,
        )  # fmt: skip
        return done.stdout + done.stderr

    def sessions(self) -> list[int]:
        """Processes that serve a link."""
        return sorted(int(pid) for pid in subprocess.run(
            ["pgrep", "-u", USER, "-f", f"sshd.*{USER}"], capture_output=True, text=True, timeout=10, check=False,
        ).stdout.split() if _below(int(pid), os.getpid()))  # fmt: skip


def _below(pid: int, ancestor: int) -> bool:
    while pid > 1:
        if pid == ancestor:
            return True
        try:
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            return False
    return False


def new_key(path: Path) -> Path:
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "desk", "-f", path], check=True, timeout=30)
    return path


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextmanager
def serving_at(top: Path, port: int) -> Iterator[Places]:
    """The program that serves, in this process, until the block ends."""
    settings = (SYSTEMD / "kingfisher-sshd.conf").read_text()
    changed = {
        "Port": f"{port}\nListenAddress 127.0.0.1",
        "HostKey": str(top / "host_ed25519"),
        "AuthorizedKeysFile": str(top / "authorized_keys"),
        "AllowUsers": USER,
        "ChrootDirectory": str(top / "root"),
    }
    for name, value in changed.items():
        settings, count = re.subn(rf"^{name} .*$", f"{name} {value}", settings, flags=re.MULTILINE)
        assert count == 1, name
    (top / "sshd.conf").write_text(settings)
    places = Places(
        top / "note",
        top / "status.json",
        top / "sshd.conf",
        top / "host_ed25519",
        top / "authorized_keys",
        top / "news",
    )
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
    (top / "root").mkdir()
    made = instrument(tmp_path / "disk")
    shutil.move(made, top / "root" / "data")
    (top / "root" / "instrument").mkdir()
    shutil.move(tmp_path / "disk" / "etc" / "kingfisher" / "rig.toml", top / "root" / "instrument")
    identity = new_key(tmp_path / "id")
    keys.enrol(top / "authorized_keys", identity.with_suffix(".pub").read_bytes())
    port = free_port()
    with serving_at(top, port) as places:
        known_hosts = tmp_path / "known_hosts"
        known_hosts.write_text(f"[127.0.0.1]:{port} {places.host_key.with_suffix('.pub').read_text()}")
        one = Served(port, places, top / "root", identity, known_hosts)
        yield one
        for pid in one.sessions():
            os.kill(pid, signal.SIGKILL)


def large_scan(root: Path, number: str) -> Path:
    """A scan of 24 MB."""
    chance = np.random.default_rng(1)
    frames = {side: chance.integers(0, 256, (3, 2000, 2000), np.uint8) for side in ("left", "right")}
    folder = root / "scans" / number
    raw = stored.write_raw(FS, folder, number, frames, record(), ORIGIN)
    stored.finish(FS, folder, raw, Decision.KEPT, record(), None, None)
    return folder


# ------------------------------------------------------------------------------------------ what it gives


def test_everything_comes_through_the_server(
    served: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = tmp_path / "desk"
    typed = ["pull", f"{USER}@127.0.0.1", str(here), "--port", str(served.port), "--identity", str(served.identity)]
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


def test_the_screen_is_told_where_and_for_how_many(served: Served) -> None:
    told = json.loads(served.places.status.read_text())
    assert (told["state"], told["keys"]) == ("on", 1)
    assert served.places.host_key.stat().st_mode & 0o777 == 0o600


def test_without_the_note_nobody_listens(top: Path) -> None:
    (top / "root").mkdir()
    port = free_port()
    with serving_at(top, port) as places:
        socket.create_connection(("127.0.0.1", port), 5).close()
        key = places.host_key.read_bytes()
        places.note.unlink()
        deadline_s = time.monotonic() + 15
        while time.monotonic() < deadline_s:
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
            except ConnectionRefusedError:
                break
            time.sleep(0.2)
        else:
            raise AssertionError("it listens still")
    with serving_at(top, port) as places:
        assert places.host_key.read_bytes() == key, "the same instrument, the same host key"


def test_a_server_that_cannot_start_is_told_and_not_tried_for_ever(top: Path) -> None:
    (top / "root").mkdir()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with serving_at(top, int(taken.getsockname()[1])) as places:
            # A slow machine may see each of the three servers run for a moment.
            deadline_s = time.monotonic() + 30
            while (told := json.loads(places.status.read_text()))[
                "state"
            ] != "failed" and time.monotonic() < deadline_s:
                time.sleep(0.1)
            assert told["state"] == "failed"
            assert "sshd ends by itself" in told["reason"]


# --------------------------------------------------------------------------------------- what it refuses


def test_nothing_can_be_written_even_where_the_user_may(served: Served, tmp_path: Path) -> None:
    subprocess.run(["chown", "-R", USER, str(served.root / "data")], check=True, timeout=30)
    subprocess.run(["chmod", "-R", "u+rwX", str(served.root / "data")], check=True, timeout=30)
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
    said = served.sftp(*tried)
    # The other two end before they are sent: the server offers no hard links, and half a file is no longer than one here.
    assert said.lower().count("permission denied") == len(tried) - 2, said
    assert content(served.root) == before
    assert {path: (path.stat().st_mode, path.stat().st_mtime_ns) for path in served.root.rglob("*")} == modes


def test_nothing_is_seen_but_what_is_shown(served: Served) -> None:
    said = served.sftp("ls -1 /", "ls -1 /etc", "ls -1 /data/../../../etc")
    assert {"/data", "/instrument"} <= set(said.split())
    assert said.count("not found") == 2
    assert "passwd" not in said


@pytest.mark.parametrize("way", ["password", "keyboard-interactive", "none", "hostbased"])
def test_nobody_comes_in_without_a_key(served: Served, way: str) -> None:
    done = served.ssh(
        "-o", f"PreferredAuthentications={way}", "-o", "PubkeyAuthentication=no", "-o", "NumberOfPasswordPrompts=1",
        "-o", "BatchMode=no",
    )  # fmt: skip
    assert done.returncode == 255
    assert b"Permission denied (publickey)" in done.stderr, "only that one way is offered"


def test_another_user_does_not_come_in_even_with_the_key(served: Served) -> None:
    with pytest.raises(PullError, match="does not take this key"), replace_user(served, "root").link()():
        pass


def replace_user(served: Served, user: str) -> Served:
    class Other(Served):
        @property
        def host(self) -> Host:
            return replace(super().host, name=f"{user}@127.0.0.1")

    return Other(served.port, served.places, served.root, served.identity, served.known_hosts)


def test_sshd_itself_understands_the_settings_so(served: Served) -> None:
    """Behind the forced command lies the user's shell, which lets nobody in either: only sshd's own word tells them apart."""
    who = f"user={USER},host=desk,addr=192.0.2.1"
    said = subprocess.run(
        [serving.SSHD, "-T", "-C", who, "-f", served.places.config],
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
    ).stdout
    found = dict(line.split(" ", 1) for line in said.splitlines() if " " in line)
    wanted = {
        "forcecommand": "internal-sftp -R -d /", "chrootdirectory": str(served.root), "authenticationmethods": "publickey",
        "passwordauthentication": "no", "kbdinteractiveauthentication": "no", "permitrootlogin": "no", "permittty": "no",
        "disableforwarding": "yes", "allowtcpforwarding": "no", "allowagentforwarding": "no", "allowstreamlocalforwarding": "no",
        "x11forwarding": "no", "permittunnel": "no", "permituserenvironment": "no", "permituserrc": "no", "usepam": "no",
        "allowusers": USER,
    }  # fmt: skip
    assert {name: found.get(name) for name in wanted} == wanted


@pytest.mark.parametrize("options", [(), ("-tt",)])
def test_there_is_no_shell_and_no_command(served: Served, options: tuple[str, ...]) -> None:
    done = served.ssh(*options, command=("id; cat /etc/passwd",), stdin=b"id\nexit\n")
    assert b"uid=" not in done.stdout
    assert b"root:" not in done.stdout
    assert b"uid=" in subprocess.run(["id"], capture_output=True, timeout=10, check=True).stdout, "id would say so"


def test_no_way_leads_to_other_computers(served: Served) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        other.settimeout(2)
        port = other.getsockname()[1]
        done = served.ssh("-W", f"127.0.0.1:{port}")
        assert b"administratively prohibited" in done.stderr
        with pytest.raises(TimeoutError):
            other.accept()
    refused = served.ssh("-N", "-o", "ExitOnForwardFailure=yes", "-R", f"{free_port()}:127.0.0.1:{port}")
    assert refused.returncode == 255
    assert b"remote port forwarding failed" in refused.stderr


# ------------------------------------------------------------------------------------- a link that breaks


def test_a_link_that_is_cut_in_a_file_is_opened_again_and_goes_on_there(served: Served, tmp_path: Path) -> None:
    large_scan(served.root / "data", "000007")
    here = tmp_path / "desk"
    cuts: list[list[int]] = []
    armed = [True]

    def far(how: HowFar) -> None:
        # What is on the way still comes after a cut; a link that was opened anew counts from nothing again.
        if how.done_bytes < 3_000_000:
            armed[0] = True
        elif how.done_bytes > 5_000_000 and armed[0] and len(cuts) < 3:
            cuts.append(served.sessions())
            for pid in cuts[-1]:
                os.kill(pid, signal.SIGKILL)
            armed[0] = False

    done = pulled(served.link(), here, far=far)
    assert len(cuts) == 3
    assert all(cuts)
    assert done.links == 4
    assert done.whole
    assert content(here / "scans" / "000007") == content(served.root / "data" / "scans" / "000007")
    sizes = sum(
        len(data) for path, data in content(here).items() if "manifest" not in path and "incomplete.json" not in path
    )
    assert done.taken_bytes == sizes, "nothing was taken twice"


def test_a_call_that_was_ended_goes_on_with_the_next_call(served: Served, tmp_path: Path) -> None:
    large_scan(served.root / "data", "000007")
    here = tmp_path / "desk"

    class Ended(Exception):
        pass

    def end(how: HowFar) -> None:
        if how.done_bytes > 8_000_000:
            raise Ended

    with pytest.raises(Ended):
        pulled(served.link(), here, far=end)
    (half,) = (here / "scans" / ".000007.pulling").glob("frames_left.npy")
    kept = sum(path.stat().st_size for path in half.parent.iterdir() if path.name != ".wanted")
    assert kept > 8_000_000
    done = pulled(served.link(), here)
    assert done.whole
    assert done.taken_bytes < 24_100_000 - kept + 20_000


def test_a_link_that_falls_silent_is_given_up_and_opened_again(served: Served, tmp_path: Path) -> None:
    large_scan(served.root / "data", "000007")
    stopped: list[int] = []

    def far(how: HowFar) -> None:
        if how.done_bytes > 5_000_000 and not stopped:
            stopped.extend(served.sessions()[:1])
            os.kill(stopped[0], signal.SIGSTOP)

    begun_s = time.monotonic()
    done = pulled(served.link(2.0), tmp_path / "desk", far=far)
    assert done.whole
    assert done.links >= 2
    assert time.monotonic() - begun_s > 2.0
    os.kill(stopped[0], signal.SIGKILL)


def test_ctrl_c_ends_a_call_that_waits_for_a_silent_link_and_the_next_one_goes_on(
    served: Served, tmp_path: Path
) -> None:
    large_scan(served.root / "data", "000007")
    here = tmp_path / "desk"
    typed = [sys.executable, "-m", "appliance.cli", "pull", f"{USER}@127.0.0.1", str(here), "--port", str(served.port)]
    typed += ["--identity", str(served.identity), "--known-hosts", str(served.known_hosts)]
    with subprocess.Popen(typed, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as call:
        while not list(here.glob("scans/.000007.pulling/frames*")) and call.poll() is None:
            time.sleep(0.001)
        stopped = served.sessions()
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(1.0)
        call.send_signal(signal.SIGINT)
        assert call.communicate(timeout=30) == ("", "")
        assert call.returncode == 130
    for pid in stopped:
        os.kill(pid, signal.SIGKILL)
    assert not (here / "scans" / "000007").exists()
    assert main(typed[3:]) == 0
    assert content(here / "scans" / "000007") == content(served.root / "data" / "scans" / "000007")


# ---------------------------------------------------------------------------------------- clear refusals


def refused(link: SshLink, tmp_path: Path) -> str:
    with pytest.raises(PullError) as error:
        pulled(link, tmp_path / "desk")
    assert not (tmp_path / "desk" / "scans").exists()
    return str(error.value)


def test_a_key_that_is_not_enrolled_is_told(served: Served, tmp_path: Path) -> None:
    other = new_key(tmp_path / "other")
    assert "does not take this key" in refused(SshLink(replace(served.host, identity=other)), tmp_path)


def test_a_key_with_a_passphrase_comes_out_of_the_agent(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with subprocess.Popen(["ssh-agent", "-D", "-a", str(tmp_path / "agent")], stdout=subprocess.DEVNULL) as agent:
        monkeypatch.setenv("SSH_AUTH_SOCK", str(tmp_path / "agent"))
        while not (tmp_path / "agent").exists():
            time.sleep(0.01)
        identity = str(served.identity)
        subprocess.run(["ssh-keygen", "-q", "-p", "-N", "of the sea", "-f", identity], check=True, timeout=30)
        assert "one with a passphrase has to be in ssh-agent" in refused(served.link(), tmp_path)
        subprocess.run(["ssh-keygen", "-q", "-p", "-P", "of the sea", "-N", "", "-f", identity], check=True, timeout=30)
        subprocess.run(["ssh-add", "-q", identity], check=True, timeout=30)
        subprocess.run(["ssh-keygen", "-q", "-p", "-N", "of the sea", "-f", identity], check=True, timeout=30)
        with served.link()() as source:
            assert source.listing("scans")
        agent.terminate()


def test_another_host_key_is_told_and_not_believed(served: Served, tmp_path: Path) -> None:
    other = new_key(tmp_path / "other").with_suffix(".pub").read_text().rpartition(" ")[0]
    served.known_hosts.write_text(f"[127.0.0.1]:{served.port} {other}\n")
    said = refused(served.link(), tmp_path)
    assert "its host key is another one than before" in said
    assert f"ssh-keygen -R '[127.0.0.1]:{served.port}'" in said


def test_a_switched_off_transfer_is_told(served: Served, tmp_path: Path) -> None:
    said = refused(SshLink(replace(served.host, port=free_port())), tmp_path)
    assert "switch TRANSFER on in the instrument's menu" in said


def test_a_host_that_nobody_knows_is_told(served: Served, tmp_path: Path) -> None:
    said = refused(SshLink(replace(served.host, name="kingfisher.invalid")), tmp_path)
    assert "no computer of that name is known" in said


def test_a_full_disk_ends_the_call_early_and_room_lets_it_go_on(served: Served, tmp_path: Path) -> None:
    large_scan(served.root / "data", "000007")
    here = tmp_path / "small"
    here.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=10m", "tmpfs", str(here)], check=True, timeout=30)
    try:
        typed = ["pull", f"{USER}@127.0.0.1", str(here), "--port", str(served.port), "--identity", str(served.identity)]
        typed += ["--known-hosts", str(served.known_hosts)]
        assert main(typed) == 1
        assert sorted(path.name for path in (here / "scans").glob("0*")) == ["000001", "000002", "000003"]
        subprocess.run(["mount", "-o", "remount,size=60m", str(here)], check=True, timeout=30)
        assert main(typed) == 0
        assert Library(here).verify("000007").ok
    finally:
        subprocess.run(["umount", str(here)], check=True, timeout=30)


def test_pull_waits_between_attempts(served: Served, tmp_path: Path) -> None:
    (tmp_path / "desk").mkdir()
    waits: list[float] = []
    link = served.link()
    with link():
        pass
    os.rename(served.places.authorized, served.places.authorized.with_name("away"))  # noqa: PTH104
    with pytest.raises(PullError, match="does not take this key"):
        pull(link, tmp_path / "desk", FS, every=False, far=lambda _: None, wait=waits.append)
    assert waits == [], "a refusal is not tried again"
