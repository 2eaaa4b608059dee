"""The exported devices: each device of a world with its bus id, as a ``Function`` for sessions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hw_sim.devices.u3v_camera import U3vCamera
from hw_sim.devices.u3v_descriptors import Speed
from hw_sim.devices.usb_board import UsbBoard
from hw_sim.devices.usb_keypad import UsbKeypad
from hw_sim.world import World

BUS = 1


class Function(Protocol):
    """A device behind its endpoints. All calls with the world's lock held."""

    @property
    def speed(self) -> int:
        """Bus speed as Linux numbers it: 2 full, 3 high, 5 SuperSpeed."""

    @property
    def plugged(self) -> bool: ...

    @property
    def enumeration(self) -> int:
        """Number of times it appeared on the bus; another number is another device."""

    def attach(self) -> None:
        """Give the device to a host."""

    def detach(self) -> None:
        """Take the device from its host."""

    def device_descriptor(self) -> bytes: ...

    def configuration_descriptor(self) -> bytes: ...

    def control(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes:
        """Do a control transfer; return the data of an IN request. Raises Stall."""

    def write(self, endpoint: int, data: bytes) -> int:
        """Do a transfer to the device; return the bytes taken. Raises Stall."""

    def read(self, endpoint: int, buffer: memoryview) -> tuple[int, bool]:
        """Read the available data: return the bytes put into ``buffer``, and whether the transfer ends.

        Raises Stall, Overflow.
        """


class CameraFunction:
    """A camera as a ``Function``."""

    def __init__(self, camera: U3vCamera) -> None:
        self._camera = camera
        self.device_descriptor = camera.device_descriptor
        self.configuration_descriptor = camera.configuration_descriptor
        self.write = camera.write
        self.read = camera.read

    @property
    def speed(self) -> int:
        """SuperSpeed, or high speed after a fallback."""
        return 5 if self._camera.speed is Speed.SUPER else 3

    @property
    def plugged(self) -> bool:
        """It is on the bus."""
        return self._camera.plugged

    @property
    def enumeration(self) -> int:
        """Number of times it appeared there."""
        return self._camera.enumeration

    def attach(self) -> None:
        """No effect: its registers are unchanged, as it has had power all the time."""

    def detach(self) -> None:
        """No effect: it keeps running, as a camera whose host has died."""

    def control(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes:
        """Do a control transfer; return the data of an IN request. Raises Stall."""
        return self._camera.request(kind, request, value, index, length)


@dataclass(frozen=True, slots=True)
class Port:
    """A port of the bus with the device that is plugged into it."""

    bus_id: str
    number: int
    function: Function


def ports_of(world: World) -> tuple[Port, ...]:
    """Return the ports: 1-1 left camera, 1-2 right camera, 1-3 key pad, 1-4 board. The caller holds the lock."""
    functions: list[Function] = [CameraFunction(world.cameras["left"]), CameraFunction(world.cameras["right"])]
    functions += [UsbKeypad(world.keypad), UsbBoard(world.board, world.faults)]
    return tuple(Port(f"{BUS}-{i}", i + 1, function) for i, function in enumerate(functions, 1))
