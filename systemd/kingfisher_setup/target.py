"""Owns how a program is run on the instrument: here, or below the root of its image."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
LIBRARIES = ("libegl1", "libgl1", "libgl1-mesa-dri", "libusb-1.0-0", "systemd", "udev")
"""Debian packages behind the wheels (drawing without a window system, cameras), and what starts and names things."""
UDEV = Path("/run/udev/control")
"""The socket is there while udev runs; systemd leaves it out where devices are not its own, as in a container."""
BOOTED = Path("/run/systemd/system")
"""sd_booted(3): the folder is there where systemd is the first process."""


def run(
    layout: Layout, command: Sequence[str], more: Mapping[str, str] | None = None, timeout_s: float = 3600.0
) -> str:
    """What the command prints. Raises SetupError with the last lines of its stderr when it fails or takes too long."""
    inside = list(command) if layout.live else ["chroot", str(layout.root), *command]
    environment = {"PATH": PATH, "HOME": "/root", "LANG": "C.UTF-8", **(more or {})}
    try:
        done = subprocess.run(
            inside, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout_s
        )
    except subprocess.TimeoutExpired as error:
        raise SetupError(f"`{' '.join(command)}` did not end within {timeout_s:.0f} s") from error
    except OSError as error:
        raise SetupError(f"`{inside[0]}`: {error.strerror}; install it") from error
    if done.returncode != 0:
        said = "\n".join((done.stderr.strip() or done.stdout.strip()).splitlines()[-8:])
        raise SetupError(f"`{' '.join(command)}` failed (exit code {done.returncode}):\n{said}")
    return done.stdout


def needed_packages(layout: Layout) -> tuple[str, ...]:
    """Debian packages that must be on the instrument. Raises SetupError where there is no Python of its own."""
    try:
        version = run(layout, ["/usr/bin/python3", "-c", "import sys; print('%d.%d' % sys.version_info[:2])"])
    except SetupError:
        return ("python3", "python3-venv", "libpython3.11", *LIBRARIES)
    version = version.strip()
    if tuple(map(int, version.split("."))) < (3, 11):
        raise SetupError(f"{layout.root}: Python {version}; 3.11 or later is needed: use Debian 12 or later")
    return ("python3", "python3-venv", f"libpython{version}", *LIBRARIES)


def missing_packages(layout: Layout) -> tuple[str, ...]:
    """Those of them that are not installed."""
    return tuple(name for name in needed_packages(layout) if not _installed(layout, name))


def install_packages(names: Sequence[str]) -> None:
    """On this machine. Raises SetupError."""
    apt = ["apt-get", "-q", "-y", "-o", "DPkg::Lock::Timeout=300", "-o", "Dpkg::Use-Pty=0"]
    quiet = {"DEBIAN_FRONTEND": "noninteractive"} | carried(os.environ)
    here = Layout(Path("/"))
    try:
        run(here, [*apt, "install", "--no-install-recommends", *names], quiet)
    except SetupError:  # the lists may be old
        run(here, [*apt, "update"], quiet)
        run(here, [*apt, "install", "--no-install-recommends", *names], quiet)


def carried(environment: Mapping[str, str]) -> dict[str, str]:
    """What of the environment says where packages come from."""
    names = ("http_proxy", "https_proxy", "no_proxy")
    return {name: value for name, value in environment.items() if name in names or name.startswith("PIP_")}


def systemctl(layout: Layout, *arguments: str, timeout_s: float = 120.0) -> str:
    """Ask systemd for something; on a mounted image there is nothing to ask. Raises SetupError."""
    return (
        run(layout, ["systemctl", "--no-ask-password", *arguments], timeout_s=timeout_s) if runs_systemd(layout) else ""
    )


def runs_systemd(layout: Layout) -> bool:
    """systemd is this machine's first process."""
    return layout.live and BOOTED.is_dir() and shutil.which("systemctl") is not None


def _installed(layout: Layout, name: str) -> bool:
    query = ["dpkg-query", "-W", "-f", "${db:Status-Status}", name]
    try:
        return run(layout, query).strip() == "installed"
    except SetupError:
        return False
