"""The link to an instrument: how `ssh` is called, and what is made of its words; a program of that name stands in for it."""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from appliance.offline.pull.source import LinkLost, PullError
from appliance.offline.pull.ssh import Host, SshLink, _end, _last

USUAL = {
    "BatchMode": "yes", "StrictHostKeyChecking": "accept-new", "ConnectTimeout": "15", "ServerAliveInterval": "5",
    "ServerAliveCountMax": "3", "ClearAllForwardings": "yes", "ForwardAgent": "no", "ForwardX11": "no", "RequestTTY": "no",
    "ControlPath": "none",
}  # fmt: skip
GREETING = "".join(f"\\{byte:03o}" for byte in struct.pack(">IBI", 5, 2, 3))


@pytest.mark.parametrize(
    ("host", "more", "rest"),
    [
        (Host("reef"), {}, ["-p", "2222", "-s", "--", "kingfisher-pull@reef", "sftp"]),
        (Host("me@reef", 22), {}, ["-p", "22", "-s", "--", "me@reef", "sftp"]),
        (
            Host("reef", None, Path("/k"), Path("/seen")),
            {"UserKnownHostsFile": "/seen"},
            ["-p", "2222", "-o", "IdentitiesOnly=yes", "-i", "/k", "-s", "--", "kingfisher-pull@reef", "sftp"],
        ),
    ],
)
def test_ssh_is_called_so_that_it_never_asks_and_leads_nowhere_else(
    host: Host, more: dict[str, str], rest: list[str]
) -> None:
    settings = [word for name, value in {**USUAL, **more}.items() for word in ("-o", f"{name}={value}")]
    assert host.command(30.0) == ["ssh", *settings, *rest]


@pytest.mark.parametrize(("limit_s", "connect_s", "alive_s"), [(1.0, 1, 1), (3.0, 2, 1), (12.0, 6, 2), (60.0, 30, 10)])
def test_ssh_gives_up_before_we_do(limit_s: float, connect_s: int, alive_s: int) -> None:
    said = Host("reef").command(limit_s)
    assert f"ConnectTimeout={connect_s}" in said
    assert f"ServerAliveInterval={alive_s}" in said


def test_without_a_limit_of_its_own_a_link_is_given_thirty_seconds() -> None:
    assert SshLink(Host("reef"))._limit_s == 30.0


# --------------------------------------------------------------------------------------------- links


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """A program `ssh`, as a script."""
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")

    def write(script: str) -> None:
        (tmp_path / "ssh").write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        (tmp_path / "ssh").chmod(0o755)

    return write


def test_a_link_shows_the_storage_root_and_ends_with_its_block(program: Callable[[str], None], tmp_path: Path) -> None:
    program(f'echo "$*" > {tmp_path}/said; printf "{GREETING}"; cat > /dev/null; echo over > {tmp_path}/ended')
    with SshLink(Host("reef"))() as source:
        assert source._path("scans") == "data/scans"
        assert source._limit_s == 30.0
        assert not (tmp_path / "ended").exists()
    assert (tmp_path / "ended").exists()
    assert (tmp_path / "said").read_text().split() == Host("reef").command(30.0)[1:]


def test_without_ssh_its_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with (
        pytest.raises(PullError, match="`ssh` is not on this computer; install openssh-client"),
        SshLink(Host("reef"))(),
    ):
        pass


COMPLAINTS = [
    ("@@@@\nREMOTE HOST IDENTIFICATION HAS CHANGED!\n@@@@", r"another one than before.*ssh-keygen -R '\[reef\]:2222'"),
    ("Host key verification failed.", "another one than before"),
    ("reef: Permission denied (publickey).", "does not take this key. Enrol the public one"),
    ("ssh: Could not resolve hostname reef: Name or service not known", "no computer of that name is known"),
    ("connect to host reef port 2222: Connection refused", "nobody listens at port 2222; switch TRANSFER on"),
    ("WARNING: UNPROTECTED PRIVATE KEY FILE!\nbad permissions", "chmod 600 it"),
    ('Load key "/k": invalid format', "the private key cannot be read; give its file with --identity"),
    ("subsystem request failed on channel 0", "it has no SFTP; is this the instrument?"),
    ("command-line: line 0: Bad configuration option: x", "ssh does not understand its settings"),
]


@pytest.mark.parametrize(("said", "meant"), COMPLAINTS)
def test_a_complaint_that_stays_is_told_with_what_to_do(said: str, meant: str) -> None:
    found = SshLink(Host("me@reef"))._meant(said, LinkLost("the link broke"))
    assert isinstance(found, PullError)
    with pytest.raises(PullError, match=f"(?s)^me@reef: .*{meant}.* \\(ssh: "):
        raise found


@pytest.mark.parametrize(("linked", "error"), [(False, PullError), (True, LinkLost)])
def test_once_linked_an_instrument_that_starts_again_is_waited_for(
    linked: bool, error: type[Exception], program: Callable[[str], None]
) -> None:
    link = SshLink(Host("reef"))
    if linked:
        program(f'printf "{GREETING}"; cat > /dev/null')
        with link():
            pass
    for said in ("Connection refused", "Could not resolve hostname reef"):
        program(f'echo "ssh: {said}" >&2')
        with pytest.raises(error, match=f"reef: .*{said}"), link():
            pass
    program('echo "Permission denied (publickey)" >&2')
    with pytest.raises(PullError, match="does not take this key"), link():
        pass


def test_a_port_of_its_own_is_told() -> None:
    found = SshLink(Host("reef", 22))._meant("Connection refused", LinkLost(""))
    assert "nobody listens at port 22;" in str(found)


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("", "reef: the link broke"),
        ("one\n  two  \n\n", "reef: two"),
        ("one\n@@@ two @@@\nWarning: Permanently added 'reef' to the list of known hosts.\n", "reef: one"),
        ("x" * 201, "reef: " + "x" * 200),
    ],
)
def test_any_other_end_is_a_lost_link_with_the_last_line_that_tells_something(said: str, told: str) -> None:
    found = SshLink(Host("reef"))._meant(said, LinkLost("the link broke"))
    assert isinstance(found, LinkLost)
    assert str(found) == told
    assert _last(said) == told.removeprefix("reef: ").replace("the link broke", "")


class StubbornProgram:
    """A process that ends after so many requests; keeps what was asked of it, and how long was waited."""

    def __init__(self, ends_after: int) -> None:
        self.ends_after = ends_after
        self.asked: list[str] = []
        self.waits_s: list[float] = []
        self.stdin, self.stdout = self, None

    def close(self) -> None:
        self.asked.append("close")
        raise BrokenPipeError

    def terminate(self) -> None:
        self.asked.append("terminate")

    def kill(self) -> None:
        self.asked.append("kill")

    def wait(self, timeout_s: float) -> None:
        self.waits_s.append(timeout_s)
        if len(self.asked) <= self.ends_after:
            raise subprocess.TimeoutExpired("ssh", timeout_s)


@pytest.mark.parametrize(
    ("ends_after", "asked", "waits_s"),
    [
        (0, ["close"], [5.0]),
        (1, ["close", "terminate"], [5.0, 5.0]),
        (2, ["close", "terminate", "kill"], [5.0, 5.0, 5.0]),
        (9, ["close", "terminate", "kill"], [5.0, 5.0, 5.0]),
    ],
)
def test_a_program_is_asked_to_end_ever_more_firmly_and_never_waited_for_longer_than_a_quarter_of_a_minute(
    ends_after: int, asked: list[str], waits_s: list[float]
) -> None:
    process: Any = StubbornProgram(ends_after)
    _end(process)
    assert (process.asked, process.waits_s) == (asked, waits_s)
