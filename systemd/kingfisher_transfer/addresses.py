"""Owns the addresses of this machine, as a person types them at the desk: asked of the kernel, without a program's help."""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import socket
import struct
from pathlib import Path

SIOCGIFADDR = 0x8915
"""Of linux/sockios.h: the IPv4 address of an interface."""
INTERFACES = Path("/sys/class/net")
INET6 = Path("/proc/net/if_inet6")
MOST = 4


def of_this_machine() -> list[str]:
    """Return the addresses of all interfaces but the loop, IPv4 first; at most ``MOST``."""
    # From the kernel's folder: `if_nameindex` asks by netlink, which the unit does not allow.
    found = []
    with contextlib.suppress(OSError):
        names = sorted(path.name for path in INTERFACES.iterdir() if path.name != "lo")
        found = [address for name in names if (address := _ipv4(name)) is not None]
    with contextlib.suppress(OSError):
        found += of_inet6(INET6.read_text("ascii"))
    return found[:MOST]


def of_inet6(text: str) -> list[str]:
    """Return the IPv6 addresses in the kernel's list that others can reach, those of the link alone last.

    Each line: address (32 digits), index, prefix, scope, flags, interface; all but the last hexadecimal (proc(5)).
    """
    found = []
    for line in text.splitlines():
        fields = line.split()
        if len(fields) == 6 and fields[5] != "lo":
            found.append(ipaddress.IPv6Address(bytes.fromhex(fields[0])))
    return [str(one) for one in sorted(found, key=lambda one: one.is_link_local)]


def _ipv4(name: str) -> str | None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            # struct ifreq: the name in 16 bytes, then a sockaddr_in whose address is its bytes 4 to 7.
            answer = fcntl.ioctl(asking.fileno(), SIOCGIFADDR, struct.pack("16s24x", name.encode()[:15]))
        except OSError:  # none given to it
            return None
    return socket.inet_ntoa(answer[20:24])
