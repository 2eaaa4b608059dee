"""The link to an instrument: whom it believes, with which keys it comes, and what is made of refusals; a server in this process."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import asyncssh
import pytest

from appliance.cli import main
from appliance.store.pull import source as sources
from appliance.store.pull.source import LinkLost, NotThere, PullError, RemoteEntry, SshLink, Unreadable

LIMIT_S = 20.0
MB = 1 << 20


@dataclass(frozen=True)
class Server:
    """A server that shows a folder to one key."""

    root: Path
    port: int
    key: str
    """Its host key, as it stands in a file of known ones."""
    identity: Path
    known_hosts: Path

    @property
    def link(self) -> SshLink:
        return SshLink("127.0.0.1", self.port, self.identity, self.known_hosts, LIMIT_S)


def new_key(path: Path) -> Any:
    key = asyncssh.generate_private_key("ssh-ed25519")
    key.write_private_key(str(path))
    return key


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Server]]:
    """Starts servers, which end with the test; ``sftp``: whether it gives files."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    servers: list[Any] = []

    def start(sftp: bool = True) -> Server:
        root, identity = tmp_path / "root", tmp_path / "id"
        (root / "data" / "scans").mkdir(parents=True, exist_ok=True)
        host_key = asyncssh.generate_private_key("ssh-ed25519")
        new_key(identity).write_public_key(str(tmp_path / "enrolled"))
        files = {"sftp_factory": lambda channel: asyncssh.SFTPServer(channel, chroot=str(root).encode())}

        async def listening() -> Any:
            return await asyncssh.listen(
                "127.0.0.1", 0, server_host_keys=[host_key], authorized_client_keys=str(tmp_path / "enrolled"),
                **files if sftp else {},
            )  # fmt: skip

        servers.append(asyncio.run_coroutine_threadsafe(listening(), loop).result(LIMIT_S))
        port = servers[-1].get_port()
        line = f"[127.0.0.1]:{port} {host_key.export_public_key().decode().strip()}"
        (tmp_path / "known").write_text(f"{line}\n")
        return Server(root, port, line, identity, tmp_path / "known")

    yield start
    for one in servers:
        loop.call_soon_threadsafe(one.close)
    loop.call_soon_threadsafe(loop.stop)
    thread.join(LIMIT_S)
    loop.close()


def refused(link: SshLink) -> str:
    with pytest.raises(PullError) as error, link():
        pass
    return str(error.value)


def test_files_and_folders_are_listed_without_links_and_files_read_from_anywhere(
    serve: Callable[..., Server], monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve()
    data = bytes(k % 251 for k in range(5 * MB // 2))
    scans = server.root / "data" / "scans"
    (scans / "f").write_bytes(data)
    (scans / "a").mkdir()
    (scans / "link").symlink_to("f")
    Path(os.fsdecode(os.fsencode(scans) + b"/\xff")).write_bytes(b"")
    with server.link() as source:
        odd, folder, file = sorted(source.listing("scans"), key=lambda entry: (entry.name.isprintable(), entry.name))
        assert not odd.name.isprintable(), "no name that is taken"
        assert (folder.name, folder.folder) == ("a", True)
        assert file == RemoteEntry("f", len(data), False)
        assert [one.name for one in source.listing("")] == ["scans"]
        assert [len(one) for one in source.read("scans/f", 0, 1 << 40)] == [MB, MB, MB // 2]
        assert b"".join(source.read("scans/f", 7, MB + 9)) == data[7 : MB + 9]
        for ask in (lambda: source.listing("gone"), lambda: list(source.read("gone", 0, 9))):
            with pytest.raises(NotThere):
                ask()
        with pytest.raises(Unreadable):
            list(source.read("scans/a", 0, 9))
        monkeypatch.setattr(sources, "MOST_NAMES", 3)
        assert len(source.listing("scans")) == 3
        monkeypatch.setattr(sources, "MOST_NAMES", 2)
        with pytest.raises(Unreadable, match="2 names"):
            source.listing("scans")


def test_an_unknown_or_changed_host_key_is_refused_and_an_unknown_ones_line_lets_the_next_call_in(
    serve: Callable[..., Server],
) -> None:
    server = serve()
    server.known_hosts.unlink()
    said = refused(server.link)
    assert said.endswith(f"{server.known_hosts} and call again: {server.key}")
    server.known_hosts.write_text(said.rpartition("call again: ")[2] + "\n")
    with server.link():
        pass
    for kind in ("ssh-ed25519", "ecdsa-sha2-nistp256"):
        other = asyncssh.generate_private_key(kind).export_public_key().decode()
        server.known_hosts.write_text(f"[127.0.0.1]:{server.port} {other}")
        assert f"`ssh-keygen -R '[127.0.0.1]:{server.port}' -f {server.known_hosts}`" in refused(server.link)


def test_a_name_of_the_users_configuration_brings_address_key_and_known_hosts(
    serve: Callable[..., Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve()
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".ssh").mkdir()
    (tmp_path / ".ssh" / "config").write_text(
        f"Host reef\n Hostname 127.0.0.1\n IdentityFile {server.identity}\n UserKnownHostsFile {server.known_hosts}\n"
    )
    with linked("reef", server.port)() as source:
        assert source.listing("scans") == []


def test_a_key_that_is_given_is_the_only_one_that_is_tried_and_no_agent_is_asked(
    serve: Callable[..., Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve()
    with socket.socket(socket.AF_UNIX) as agent:
        agent.bind(str(tmp_path / "agent"))
        agent.listen()
        agent.settimeout(0)
        monkeypatch.setenv("SSH_AUTH_SOCK", str(tmp_path / "agent"))
        with server.link():
            pass
        new_key(tmp_path / "other")
        other = replace(server.link, identity=tmp_path / "other")
        assert "does not accept this key" in refused(other)
        with pytest.raises(BlockingIOError):
            agent.accept()
    (tmp_path / "other").write_text("no key\n")
    assert "cannot be read: " in refused(other)


def linked(host: str, port: int, limit_s: float = LIMIT_S) -> SshLink:
    """With the user's own keys and known hosts."""
    return SshLink(host, port, None, None, limit_s)


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def test_nobody_there_is_told_at_first_and_waited_for_once_there_was_a_link(serve: Callable[..., Server]) -> None:
    both = "[Errno 111] Connect call failed ('::1', 9, 0, 0), [Errno 111] Connect call failed ('127.0.0.1', 9)"
    found = linked("reef", 9)._error_of(asyncssh, OSError(f"Multiple exceptions: {both}"))
    assert (type(found), "port 9" in str(found)) == (PullError, True), "at any address of a name"
    port = free_port()
    assert f"port {port}" in refused(linked("127.0.0.1", port))
    link = serve().link
    with link():
        pass
    link.port = port
    with pytest.raises(LinkLost), link():
        pass
    assert "SFTP" in refused(serve(sftp=False).link), "a server without files"


def test_a_server_that_says_nothing_is_a_lost_link_after_the_limit() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(LinkLost, match="no data"), linked("127.0.0.1", other.getsockname()[1], 0.2)():
            pass


def test_without_the_library_one_sentence_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "asyncssh", None)
    assert main(["archive", "pull", "reef", "--out", str(tmp_path / "desk")]) == 1
    assert "pip install 'kingfisher-3d[desk]'" in capsys.readouterr().err
    assert not (tmp_path / "desk").exists()
