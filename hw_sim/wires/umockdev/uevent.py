"""Messages to programs about devices that come and go, as udev sends them.

Listeners' sockets lie in the test bed's root, where the preload library puts them in place of netlink. Source: systemd
252, ``src/libsystemd/sd-device/device-monitor.c`` (monitor_netlink_header), ``src/basic/MurmurHash2.c``.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping
from pathlib import Path

_MAGIC = 0xFEEDCAFE
_NATIVE = struct.Struct("<III")
_NETWORK = struct.Struct(">IIII")
_HEADER_BYTES = 8 + 4 + _NATIVE.size + _NETWORK.size
_M = 0x5BD1E995


def murmur_hash(text: bytes) -> int:
    """Return MurmurHash2 with seed 0, 32 bits, for comparison by a listener's filter in the kernel."""
    h = len(text)
    aligned_size = len(text) // 4 * 4
    for (k,) in struct.iter_unpack("<I", text[:aligned_size]):
        k = k * _M & 0xFFFFFFFF
        k = (k ^ k >> 24) * _M & 0xFFFFFFFF
        h = (h * _M & 0xFFFFFFFF) ^ k
    if text[aligned_size:]:
        h = (h ^ int.from_bytes(text[aligned_size:], "little")) * _M & 0xFFFFFFFF
    h = (h ^ h >> 13) * _M & 0xFFFFFFFF
    return h ^ h >> 15


def message(action: str, device: str, number: int, properties: Mapping[str, str]) -> bytes:
    """Return a message to listeners.

    ``device``: path below ``/sys``; ``properties`` contain SUBSYSTEM and, if there is one, DEVTYPE.
    """
    head = {"ACTION": action, "DEVPATH": f"/{device}", "SEQNUM": str(number)}
    body = b"".join(f"{key}={value}\0".encode() for key, value in {**head, **properties}.items())
    kind = properties.get("DEVTYPE")
    hashes = (murmur_hash(properties["SUBSYSTEM"].encode()), murmur_hash(kind.encode()) if kind else 0)
    return (
        # struct monitor_netlink_header: magic and hashes are big endian, sizes in the machine's own order.
        b"libudev\0"
        + struct.pack(">I", _MAGIC)
        + _NATIVE.pack(_HEADER_BYTES, _HEADER_BYTES, len(body))
        + _NETWORK.pack(*hashes, 0, 0)
        + body
    )


def tell(root: Path, data: bytes) -> None:
    """Send a message to all listeners, and remove sockets without a listener."""
    for listener in sorted(root.glob("event[0-9]*")):
        with socket.socket(socket.AF_UNIX, socket.SOCK_RAW | socket.SOCK_NONBLOCK) as sender:
            try:
                sender.sendto(data, str(listener))
            except ConnectionRefusedError:
                listener.unlink(missing_ok=True)
            except (BlockingIOError, FileNotFoundError):
                continue  # a full socket loses messages, as the kernel's does; another has just gone
