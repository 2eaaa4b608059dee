"""Runs inside the virtual machine, as root: plugs in what the host exports, and does what the test asks for.

Standard library only. It plays the part of cables and of a person with a root shell; the instrument does not know it.
"""

from __future__ import annotations

import fcntl
import json
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

HOST, GUEST, MASK = "10.0.2.2", "10.0.2.15", "255.255.255.0"
PORT = Path("/dev/virtio-ports/kingfisher.agent")
VHCI = Path("/sys/devices/platform/vhci_hcd.0")
BUS_IDS = ("1-1", "1-2", "1-3", "1-4")
SUPER_SPEED = 5
FREE = "004"
_SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCSIFFLAGS = 0x8916, 0x891C, 0x8914
_IFF_UP = 1


def bring_up_network() -> None:
    """The one interface, by hand: nothing in the image waits for a network or configures one."""
    deadline = time.monotonic() + 60
    while True:
        names = [name for _, name in socket.if_nameindex() if name != "lo"]
        if names or time.monotonic() > deadline:
            break
        time.sleep(0.1)
    name = names[0].encode().ljust(16, b"\0")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for request, address in ((_SIOCSIFADDR, GUEST), (_SIOCSIFNETMASK, MASK)):
            value = struct.pack("<HH4s8x", socket.AF_INET, 0, socket.inet_aton(address))
            fcntl.ioctl(control, request, name + value)
        fcntl.ioctl(control, _SIOCSIFFLAGS, name + struct.pack("<H14x", _IFF_UP))


def ports() -> list[tuple[bool, int, bool]]:
    """(SuperSpeed, number, free) of each port of the virtual host controller."""
    found = []
    for line in (VHCI / "status").read_text().splitlines()[1:]:
        hub, port, state = line.split()[:3]
        found.append((hub == "ss", int(port), state == FREE))
    return found


def read_exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise OSError("the exporter hung up")
        data += part
    return data


def attach(bus_id: str, port: int) -> int:
    """Import one device and give its connection to the kernel; the port of the virtual controller. Raises OSError."""
    with socket.create_connection((HOST, port), 5.0) as connection:
        connection.settimeout(10.0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(struct.pack(">HHI", 0x0111, 0x8003, 0) + bus_id.encode().ljust(32, b"\0"))
        if read_exactly(connection, 8)[7]:
            raise OSError(f"{bus_id} is not to be had")
        record = read_exactly(connection, 312)
        bus, number, speed = struct.unpack_from(">III", record, 288)
        wants_super = speed == SUPER_SPEED
        free = next(index for is_super, index, is_free in ports() if is_super == wants_super and is_free)
        connection.settimeout(None)
        (VHCI / "attach").write_text(f"{free} {connection.fileno()} {bus << 16 | number} {speed}")
        return free


def keep_attached(port: int) -> None:
    """Plug each device in, and in again whenever it has left and is back."""
    where: dict[str, int] = {}
    while True:
        busy = {index for _, index, free in ports() if not free}
        for bus_id in BUS_IDS:
            if where.get(bus_id) in busy:
                continue
            where.pop(bus_id, None)
            try:
                where[bus_id] = attach(bus_id, port)
            except (OSError, StopIteration) as error:
                print(f"{bus_id}: {error}", flush=True)
        time.sleep(0.5)


def obey(command: dict[str, object]) -> dict[str, object]:
    """``run``: a shell command with a time limit."""
    try:
        done = subprocess.run(
            ["/bin/sh", "-c", str(command["run"])],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=float(str(command.get("timeout_s", 60))),
        )
    except subprocess.TimeoutExpired as expired:
        return {"rc": 124, "out": (expired.stdout or b"").decode(errors="replace")}
    return {"rc": done.returncode, "out": done.stdout.decode(errors="replace")}


def main() -> None:
    for module in ("virtio_console", "virtio_net", "vhci_hcd", "usbhid", "cdc_acm"):
        subprocess.run(["modprobe", module], check=False)
    bring_up_network()
    threading.Thread(target=keep_attached, args=(int(sys.argv[1]),), daemon=True).start()
    deadline = time.monotonic() + 60
    while not PORT.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    with PORT.open("r+b", buffering=0) as port:
        port.write(b'{"hello": %d}\n' % time.monotonic_ns())
        pending = b""
        while True:
            data = port.read(65536)
            if not data:
                time.sleep(0.1)  # nobody has the other end open
                continue
            pending += data
            while b"\n" in pending:
                line, pending = pending.split(b"\n", 1)
                command = json.loads(line)
                answer = {"id": command["id"], **obey(command)}
                port.write(json.dumps(answer).encode() + b"\n")


if __name__ == "__main__":
    main()
