"""Keys and sticks of the transfer, and that its units and its server's settings are what the documents promise."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from kingfisher_transfer import addresses, keys, main, serving, stick
from kingfisher_transfer.keys import KeysError
from kingfisher_transfer.serving import Places, make_host_key

SYSTEMD = Path(__file__).parents[2] / "systemd"
needs_keygen = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="openssh-client is not installed")
ED25519 = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIOMqqnkVzrm0SdG6UOoqKLsabgH5C9okWi0dh2l9GKJl anna@desk"
OTHER = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIJPnXHpGi7uRB2Qm0dNPRPhzZQAHZwAUGLbBlMDWDTsg bert@desk"


@needs_keygen
def test_keys_are_enrolled_once_listed_and_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "authorized_keys"
    assert keys.enrolled(path) == []
    data = f"# of the office\n\n{ED25519}\r\n{OTHER}\n{OTHER}\n".encode()
    assert [key.comment for key in keys.enrol(path, data)] == ["anna@desk", "bert@desk"]
    assert keys.enrol(path, data) == []
    assert path.read_text() == f"{ED25519}\n{OTHER}\n"
    assert path.stat().st_mode & 0o777 == 0o644, "sshd reads it as the user who comes in"
    first = keys.enrolled(path)[0]
    assert re.fullmatch(r"SHA256:[A-Za-z0-9+/]{43}", first.fingerprint)
    assert keys.forget(path, {first.fingerprint}) == [first]
    assert path.read_text() == f"{OTHER}\n"


@needs_keygen
@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"-----BEGIN OPENSSH PRIVATE KEY-----\n", "line 1: a private key; never give it away"), (f'command="sh" {ED25519}'.encode(), "line 1: no public key"),
        (f"{ED25519}\nssh-dss {ED25519.split()[1]} x\n".encode(), "line 2: no public key"), (b"ssh-ed25519 " + b"A" * 68 + b" x\n", "ssh-keygen takes it for no key"),
        (ED25519.replace("IOMqq", "IO").encode(), "ssh-keygen takes it for no key"), (b"ssh-ed25519 short x", "no public key"),
        (b"\x00\xff" * 400, "no public key"), (b"#" * (keys.MOST_BYTES + 1), "at most"), (2048, "at least 3072"),
    ],
)  # fmt: skip
def test_one_bad_line_and_no_key_of_the_file_is_enrolled(tmp_path: Path, data: bytes | int, said: str) -> None:
    """A number stands for an RSA key of so many bits; one of 3072 is taken."""
    path = tmp_path / "authorized_keys"
    keys.enrol(path, OTHER.encode())
    with pytest.raises(KeysError, match=re.escape(said)):
        keys.enrol(path, rsa(tmp_path, data) if isinstance(data, int) else data)
    assert path.read_text() == f"{OTHER}\n"
    assert not isinstance(data, int) or len(keys.parsed(rsa(tmp_path, 3072))) == 1


def rsa(folder: Path, bits: int) -> bytes:
    made = folder / f"rsa{bits}"
    subprocess.run(["ssh-keygen", "-q", "-t", "rsa", "-b", str(bits), "-N", "", "-f", made], check=True, timeout=60)
    return made.with_suffix(".pub").read_bytes()


@needs_keygen
def test_the_list_of_keys_is_kept_by_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    both, path = tmp_path / "both.pub", tmp_path / "keys"
    both.write_text(f"{ED25519}\n{OTHER}\n")

    def typed(*words: object) -> tuple[int, list[str], str]:
        monkeypatch.setattr(sys, "argv", ["x", "--keys", str(path), *map(str, words)])
        code, said = main.main(), capsys.readouterr()
        return code, [line.split()[-1] for line in said.out.splitlines()], said.err

    anna, bert = "anna@desk", "bert@desk"
    for verb in (("enrol", both), ("list",)):
        assert typed(*verb) == (0, [anna, bert], "2 enrolled\n")
    first = keys.enrolled(path)[0].fingerprint
    assert typed("forget", first, "SHA256:another")[0] == 1
    assert typed("forget", first) == (0, [anna], "1 forgotten\n")
    assert typed("forget", "--all") == (0, [bert], "1 forgotten\n")
    monkeypatch.setattr(keys, "MOST_KEYS", 1)
    assert typed("enrol", both)[0] == 1
    code, _, said = typed("stick", "/dev/none")
    assert (code, "the transfer is off" in said) == (0, True)


@needs_keygen
def test_a_stick_enrols_and_forgets(tmp_path: Path) -> None:
    plugged, path = tmp_path / "stick", tmp_path / "authorized_keys"
    plugged.mkdir()
    assert stick.of_folder(plugged, path) == ""
    (plugged / "kingfisher-keys.pub").write_text(f"{ED25519}\n{OTHER}\n")
    assert stick.of_folder(plugged, path).startswith("2 keys enrolled, SHA256:")
    assert stick.of_folder(plugged, path) == "all its keys are enrolled already"
    (plugged / "kingfisher-keys.pub").rename(plugged / "kingfisher-forget.pub")
    assert stick.of_folder(plugged, path).startswith("2 keys forgotten")
    assert path.read_text() == ""
    (plugged / "kingfisher-forget.pub").write_bytes(b"#" * (keys.MOST_BYTES + 1))
    with pytest.raises(KeysError, match="at most"):
        stick.of_folder(plugged, path)


@needs_keygen
@pytest.mark.parametrize(
    "make",
    [lambda path, secret: path.symlink_to(secret), lambda path, _: os.mkfifo(path), lambda path, _: path.mkdir()],
)
def test_a_stick_makes_nobody_read_the_instruments_own_files(
    tmp_path: Path, make: Callable[[Path, Path], None]
) -> None:
    plugged, secret = tmp_path / "stick", tmp_path / "secret"
    plugged.mkdir()
    secret.write_text(ED25519)
    make(plugged / "kingfisher-keys.pub", secret)
    with pytest.raises(KeysError):
        stick.of_folder(plugged, tmp_path / "authorized_keys")
    assert not (tmp_path / "authorized_keys").exists()


@needs_keygen
def test_a_stick_is_mounted_for_reading_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen from the program that mounts: one of that name stands before the system's."""
    plugged, programs, heard = tmp_path / "stick", tmp_path / "bin", tmp_path / "heard"
    plugged.mkdir()
    programs.mkdir()
    (plugged / "kingfisher-keys.pub").write_text(f"{ED25519}\n")
    for name, does in (("mount", 'cp "$6"/* "$7"'), ("umount", 'rm "$2"/*')):
        (programs / name).write_text(f'#!/bin/sh\necho "${{0##*/}} $*" >> {heard}\n{does}\n')
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    there = places(tmp_path)
    assert main._stick(plugged, there) == 0
    assert there.news.read_text().startswith("1 keys enrolled")
    mounted, let_go = heard.read_text().splitlines()
    words = mounted.split()
    assert set(words[words.index("-o") + 1].split(",")) == {"ro", "nosuid", "nodev", "noexec"}
    assert let_go == f"umount -- {words[-1]}"
    (programs / "mount").write_text("#!/bin/sh\necho no medium >&2\nexit 1\n")
    assert main._stick(plugged, there) == 1
    assert there.news.read_text() == "refused: mount: no medium"


def places(top: Path) -> Places:
    """A transfer that is on."""
    (top / "note").touch()
    return Places(*(top / name for name in ("note", "status", "sshd.conf", "host_key", "authorized_keys", "news")))


@needs_keygen
@pytest.mark.parametrize(
    ("server", "state", "reason", "starts"),
    [
        ("trap 'rm $0; exit' TERM; while :; do sleep 0.05; done", "on", "", 1),
        ("trap '' TERM; exec sleep 60", "on", "", 1),
        ("exit 1", "failed", "sshd ends by itself; `journalctl -u kingfisher-transfer` says why", 3),
        (None, "failed", "No such file or directory; install openssh-server", 0),
        ("no host key", "failed", "no host key: ", 0),
    ],
)
def test_the_screen_is_told_how_the_transfer_stands_until_it_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, server: str | None, state: str, reason: str, starts: int
) -> None:
    there, sshd, stopping, told = places(tmp_path), tmp_path / "sshd", threading.Event(), list[dict[str, object]]()
    if server is not None:
        sshd.write_text(f'#!/bin/sh\necho "$$ $*" >> {tmp_path}/starts\n{server}\n')
        sshd.chmod(0o755)
    if server == "no host key":
        (tmp_path / "host_key").mkdir()  # in the way of one
    there.authorized.write_text(f"{ED25519}\n")
    there.news.write_text("n" * 600)
    for name, value in {"SSHD": str(sshd), "LOOK_S": 0.05, "END_S": 0.3}.items():
        monkeypatch.setattr(serving, name, value)

    def ready() -> None:
        told.append(json.loads(there.status.read_text()))
        there.note.unlink() if starts == 1 else threading.Timer(0.2, stopping.set).start()

    assert serving.serve(there, ready, stopping) == (0 if state == "on" else 1)
    (once,) = told
    assert reason in str(once.pop("reason"))
    assert once == {"state": state, "addresses": addresses.of_this_machine(), "keys": 1, "news": "n" * 500}
    assert there.status.stat().st_mode & 0o777 == 0o644, "the appliance is another user"
    started = (tmp_path / "starts").read_text().splitlines() if starts else []
    assert [line.split(maxsplit=1)[1] for line in started] == [f"-D -e -f {there.config}"] * starts
    if str(server).startswith("trap 'rm"):
        assert not sshd.exists(), "it was asked to end"
    assert not any(Path(f"/proc/{line.split()[0]}").exists() for line in started), "no server is left"
    there.authorized.write_text("no key")
    serving._tell(there, state, "")
    assert json.loads(there.status.read_text())["keys"] is None


@needs_keygen
@pytest.mark.parametrize("left", [("key",), ("key", "key.pub"), (".key.draft", ".key.draft.pub")])
def test_half_a_host_key_of_a_power_cut_does_not_end_the_transfer_for_good(
    tmp_path: Path, left: tuple[str, ...]
) -> None:
    key = tmp_path / "state" / "key"
    key.parent.mkdir()
    for name in left:  # names that were durable before their content was
        (key.parent / name).write_bytes(b"")
    make_host_key(key)
    command = ["ssh-keygen", "-y", "-f", str(key)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    assert said.split()[:2] == key.with_suffix(".pub").read_text().split()[:2], "one pair"
    assert {path.name for path in key.parent.iterdir()} == {"key", "key.pub"}
    before = key.read_bytes()
    make_host_key(key)
    assert (key.read_bytes() == before, key.stat().st_mode & 0o777) == (True, 0o600), "a host key is made once"


def test_addresses_are_found_without_netlink_which_the_unit_forbids(monkeypatch: pytest.MonkeyPatch) -> None:
    """The C library lists interfaces by netlink: the transfer died of it in its first second."""
    assert "NETLINK" not in (SYSTEMD / "kingfisher-transfer.service").read_text()
    there = addresses.of_this_machine()

    def refused(*_: object) -> None:
        raise OSError(errno.EAFNOSUPPORT, "as under RestrictAddressFamilies=")

    monkeypatch.setattr(socket, "if_nameindex", refused)
    assert addresses.of_this_machine() == there


def test_addresses_of_the_link_alone_come_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = (
        "fe80000000000000021122fffe334455 02 40 20 80     eth0\n"
        "20010db8000000000000000000000007 02 40 00 00     eth0\n"
        "00000000000000000000000000000001 01 80 10 80       lo\n"
    )
    there = ["2001:db8::7", "fe80::211:22ff:fe33:4455"]
    assert addresses.of_inet6(told) == there
    (tmp_path / "lo").touch()
    (tmp_path / "inet6").write_text(3 * told)
    monkeypatch.setattr(addresses, "INTERFACES", tmp_path)
    monkeypatch.setattr(addresses, "INET6", tmp_path / "inet6")
    assert addresses.of_this_machine() == [there[0]] * 3 + there[1:]
    assert addresses._ipv4("lo") == "127.0.0.1"


def test_paths_of_units_settings_and_program_are_the_same_and_nothing_runs_before_the_note_is_there() -> None:
    from appliance.store.pull.source import PORT, SERVED, USER

    server, unit, one, users = (
        (SYSTEMD / f"kingfisher{name}").read_text()
        for name in ("-sshd.conf", "-transfer.service", ".service", ".sysusers")
    )
    usual = Places()
    told = {f"HostKey {usual.host_key}", f"AuthorizedKeysFile {usual.authorized}", f"Port {PORT}", f"AllowUsers {USER}"}
    assert told <= set(server.splitlines())
    (root,) = re.findall(r"^ChrootDirectory (\S+)$", server, re.MULTILINE)
    assert f"\nBindReadOnlyPaths=/var/lib/kingfisher:{root}/{SERVED}\n" in unit
    assert usual.config == SYSTEMD / "kingfisher-sshd.conf"
    # Who comes in reads and owns nothing: what the appliance writes its group may read and not write.
    assert f"\nm {USER} kingfisher\n" in users
    assert "\nUMask=0027\n" in one
    assert {"Nice=19", "CPUWeight=idle", "IOSchedulingClass=idle", "IOWeight=1"} <= set(unit.splitlines())
    for started in (unit, (SYSTEMD / "kingfisher-keys@.service").read_text()):
        assert "\nConditionPathExists=/run/kingfisher/transfer-on\n" in started
        assert "[Install]" not in started
    assert "RuntimeDirectory=kingfisher\n" in one, "in memory: the note is gone with the power"
