"""Owns what the test adds to an image without changing a bit of it: a second initial RAM disk that fills ``/run``."""

from __future__ import annotations

import io
import stat
from pathlib import Path
from shlex import quote

AGENT = Path(__file__).parent / "guest" / "agent.py"

_AGENT_UNIT = """[Unit]
Description=The test's hands inside the machine
DefaultDependencies=no
After=systemd-udevd.service
[Service]
ExecStart=/usr/bin/python3 /run/kingfisher-test/agent.py {port}
StandardOutput=journal+console
"""


def with_files(initrd: bytes, exporter_port: int, files: dict[str, str]) -> bytes:
    """An initial RAM disk, and behind it a cpio archive (newc) whose script copies itself into /run.

    ``files`` by path below /run. The kernel finds the second archive at a multiple of four bytes.
    """
    unit = "systemd/system/kingfisher-test-agent.service"
    content = {
        "kingfisher-test/agent.py": AGENT.read_text(encoding="utf-8"),
        unit: _AGENT_UNIT.format(port=exporter_port),
        "systemd/system/sysinit.target.d/kingfisher-test.conf": f"[Unit]\nWants={Path(unit).name}\n",
        **files,
    }
    made = io.BytesIO()
    directories = {"scripts", "scripts/init-premount", "kingfisher-run"}
    for name in content:
        directories |= {f"kingfisher-run/{parent}" for parent in Path(name).parents if parent != Path()}
    for name in sorted(directories):
        _entry(made, name, stat.S_IFDIR | 0o755, b"")
    # The early user space has mkdir and cat, but no cp.
    order = "".join(
        f"mkdir -p {quote(f'/run/{Path(name).parent}')}\ncat {quote(f'/kingfisher-run/{name}')} >{quote(f'/run/{name}')}\n"
        for name in content
    )
    _entry(made, "scripts/init-premount/ORDER", stat.S_IFREG | 0o755, order.encode())
    for name, text in content.items():
        _entry(made, f"kingfisher-run/{name}", stat.S_IFREG | 0o644, text.encode())
    _entry(made, "TRAILER!!!", 0, b"")
    return initrd + bytes(-len(initrd) % 4) + made.getvalue()


def rig_drop_in(rig: str) -> str:
    """A drop-in that shows a service the test's rig file in the place of the image's."""
    return f"[Service]\nBindReadOnlyPaths=/run/kingfisher-test/rig.toml:{rig}\n"


def _entry(made: io.BytesIO, name: str, mode: int, data: bytes) -> None:
    encoded = name.encode() + b"\0"
    fields = (0, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(encoded), 0)
    made.write(b"070701" + b"".join(b"%08X" % field for field in fields) + encoded)
    made.write(bytes(-made.tell() % 4) + data)
    made.write(bytes(-made.tell() % 4))
