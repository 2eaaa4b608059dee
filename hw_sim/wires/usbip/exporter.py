"""The exporter: a loopback socket at which each device of a world can be imported once at a time.

USB/IP has no authentication, so the socket is open to this machine only; a virtual machine reaches it through its host.
"""

from __future__ import annotations

import logging
import socket
import threading
from contextlib import suppress
from types import TracebackType
from typing import Self

from hw_sim.wires.usbip import messages
from hw_sim.wires.usbip.messages import ProtocolError
from hw_sim.wires.usbip.ports import BUS, Port, ports_of
from hw_sim.wires.usbip.session import JOIN_TIMEOUT_S, ConnectionClosedError, Session, receive
from hw_sim.world import World

LOG = logging.getLogger(__name__)
LOOPBACK = "127.0.0.1"
PORT = 3240
"""The default port of ``usbip attach``."""
MOST_CONNECTIONS = 16
ACCEPT_SLICE_S = 0.2
GREETING_TIMEOUT_S = 10.0


class Exporter:
    """Exports a world's devices in its context; ``port`` 0 selects a free one. Raises OSError."""

    def __init__(self, world: World, port: int = PORT) -> None:
        self._world = world
        with world.time.condition:
            self._ports = {port.bus_id: port for port in ports_of(world)}
        self._imported: set[str] = set()
        self._connections: set[socket.socket] = set()
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._door = socket.create_server((LOOPBACK, port))
        self._door.settimeout(ACCEPT_SLICE_S)
        self._thread = threading.Thread(target=self._accept_forever, name="usbip", daemon=True)

    @property
    def port(self) -> int:
        """The TCP port."""
        return int(self._door.getsockname()[1])

    @property
    def imported(self) -> frozenset[str]:
        """Bus ids of the devices that a host has imported."""
        with self._lock:
            return frozenset(self._imported)

    def cut(self) -> None:
        """Disconnect all devices from their hosts, as when a host is reset, which USB/IP would never notice."""
        with self._lock:
            connections = list(self._connections)
        for connection in connections:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join(JOIN_TIMEOUT_S)
        self._door.close()
        self.cut()
        with self._lock:
            threads = list(self._threads)
        for thread in threads:
            thread.join(JOIN_TIMEOUT_S)

    def _accept_forever(self) -> None:
        while not self._closing.is_set():
            try:
                connection, _ = self._door.accept()
            except TimeoutError:
                continue
            with self._lock:
                self._threads = [thread for thread in self._threads if thread.is_alive()]
                if len(self._connections) >= MOST_CONNECTIONS:
                    connection.close()
                    continue
                self._connections.add(connection)
                thread = threading.Thread(target=self._serve, args=(connection,), name="usbip-host", daemon=True)
                self._threads.append(thread)
            thread.start()

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection:
                # Small replies must not wait for each other: the host's kernel sends a request only after the reply.
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                connection.settimeout(GREETING_TIMEOUT_S)
                self._answer(connection)
        except (ConnectionClosedError, OSError):
            pass  # the host is gone
        except ProtocolError as error:
            LOG.warning("USB/IP: %s", error)
        finally:
            with self._lock:
                self._connections.discard(connection)

    def _answer(self, connection: socket.socket) -> None:
        code = messages.parse_operation(receive(connection, messages.OPERATION_BYTES))
        if code == messages.REQUEST_LIST:
            connection.sendall(self._list())
        elif code == messages.REQUEST_IMPORT:
            bus_id = messages.parse_bus_id(receive(connection, messages.BUS_ID_BYTES))
            self._import(connection, bus_id)
        else:
            raise ProtocolError(f"operation {code:#06x}; known are the list and the import of devices")

    def _list(self) -> bytes:
        with self._lock:
            free = [port for port in self._ports.values() if port.bus_id not in self._imported]
        with self._world.time.condition:
            records = [self._record(port, True) for port in free if port.function.plugged]
        return messages.operation(messages.REPLY_LIST) + len(records).to_bytes(4, "big") + b"".join(records)

    def _record(self, port: Port, with_interfaces: bool) -> bytes:
        function = port.function
        device, configuration = function.device_descriptor(), function.configuration_descriptor()
        return messages.record(port.bus_id, BUS, port.number, function.speed, device, configuration, with_interfaces)

    def _import(self, connection: socket.socket, bus_id: str) -> None:
        port = self._ports.get(bus_id)
        with self._lock:
            free = port is not None and bus_id not in self._imported
            if free:
                self._imported.add(bus_id)
        if port is None or not free:
            connection.sendall(messages.operation(messages.REPLY_IMPORT, messages.REFUSED))
            return
        try:
            with self._world.time.condition:
                record = self._record(port, False) if port.function.plugged else None
            if record is None:
                connection.sendall(messages.operation(messages.REPLY_IMPORT, messages.REFUSED))
                return
            connection.sendall(messages.operation(messages.REPLY_IMPORT) + record)
            # From here on the host may be silent without limit; ``cut`` and the end of the world wake the reader.
            connection.settimeout(None)
            Session(connection, port.function, self._world.time, bus_id).serve()
        finally:
            with self._lock:
                self._imported.discard(bus_id)
