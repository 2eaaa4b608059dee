"""Finding and opening a camera over a pyusb backend of this test's own, and what each failure tells the operator."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import usb.backend.libusb1
import usb.core

from drivers.api import DeviceError, DeviceGone, DeviceRefused
from drivers.camera.usb import (
    FoundCamera,
    TransferOverflow,
    TransferStalled,
    TransferTimeout,
    Unplugged,
    UsbCamera,
    default_backend,
    find_camera,
    find_cameras,
    transfer_buffer,
)

DEVICE_INFO = bytes.fromhex("14 24 01 0300 0100 0000 0100 04 05 02 06 07 08 03 09 08".replace(" ", ""))


def usb_error(number: int) -> usb.core.USBError:
    return usb.core.USBError("failed", -1, number)


@dataclass
class Device:
    serial: str = "KF-CAM-L"
    vision: bool = True
    speed: int | None = 4
    open_error: int = 0
    claim_error: int = 0
    enumeration_error: int = 0
    transfer: usb.core.USBError | bytes = b""
    """What a bulk transfer does: raise this, or give these bytes."""
    claimed: list[int] = field(default_factory=list)
    timeouts_ms: list[int] = field(default_factory=list)
    written: list[tuple[int, int, bytes]] = field(default_factory=list)
    short_by: int = 0
    """Bytes that a write leaves out."""
    release_error: int = 0
    interrupts: bool = False
    """Each interface begins with an endpoint that is not bulk."""
    configured: int = 0
    """How often a configuration was set."""
    info: bytes = DEVICE_INFO
    string: bytes | None = None
    """In place of the serial number's descriptor."""
    iserial: int = 1
    halts_cleared: list[int] = field(default_factory=list)
    halt_error: int = 0
    is_open: bool = False
    configuration: int = 0


class Backend:
    """The part of ``usb.backend.IBackend`` that a camera needs, without a bus."""

    def __init__(self, *devices: Device) -> None:
        self._devices = devices

    def enumerate_devices(self) -> Iterator[Device]:
        return iter(self._devices)

    def get_device_descriptor(self, device: Device) -> Any:
        if device.enumeration_error:
            raise usb_error(device.enumeration_error)
        return SimpleNamespace(iSerialNumber=device.iserial, speed=device.speed, bus=1, address=7)

    def get_configuration_descriptor(self, device: Device, config: int) -> Any:
        return SimpleNamespace(bNumInterfaces=3 if device.vision else 1, bConfigurationValue=1)

    def get_interface_descriptor(self, device: Device, index: int, alt: int, config: int) -> Any:
        kind = (0xEF, 0x05) if device.vision else (0x08, 0x06)
        return SimpleNamespace(
            bInterfaceNumber=index,
            bNumEndpoints=(2 if index == 0 else 1) + int(device.interrupts),
            bInterfaceClass=kind[0],
            bInterfaceSubClass=kind[1],
            bInterfaceProtocol=index,
            extra_descriptors=list(device.info) if index == 0 else None,
        )

    def get_endpoint_descriptor(self, device: Device, number: int, index: int, alt: int, config: int) -> Any:
        if device.interrupts and number == 0:
            return SimpleNamespace(bmAttributes=3, bEndpointAddress=0x8F)
        number -= int(device.interrupts)
        return SimpleNamespace(bmAttributes=2, bEndpointAddress=(0x81 + index) if number == 0 else 0x01)

    def open_device(self, device: Device) -> Device:
        if device.open_error:
            raise usb_error(device.open_error)
        device.is_open = True
        return device

    def close_device(self, device: Device) -> None:
        device.is_open = False

    def get_configuration(self, device: Device) -> int:
        return device.configuration

    def set_configuration(self, device: Device, value: int) -> None:
        device.configuration = value
        device.configured += 1

    def claim_interface(self, device: Device, interface: int) -> None:
        if device.claim_error and interface == 2:
            raise usb_error(device.claim_error)
        device.claimed.append(interface)

    def release_interface(self, device: Device, interface: int) -> None:
        if device.release_error:
            raise usb_error(device.release_error)
        device.claimed.remove(interface)

    def ctrl_transfer(
        self, device: Device, kind: int, request: int, value: int, index: int, data: Any, timeout_ms: int
    ) -> int:
        assert (kind, request, value >> 8, index) == (0x80, 0x06, 0x03, 0x0409)
        text = (device.serial if value & 0xFF == 3 else "not the U3V serial").encode("utf-16-le")
        string = bytes([len(text) + 2, 3]) + text
        string = string if device.string is None else device.string
        assert 0 < timeout_ms <= 2000, "a device that does not answer is not waited for"
        data[: len(string)] = np.frombuffer(string, np.uint8)
        return len(string)

    def clear_halt(self, device: Device, endpoint: int) -> None:
        if device.halt_error:
            raise usb_error(device.halt_error)
        device.halts_cleared.append(endpoint)

    def bulk_write(self, device: Device, endpoint: int, interface: int, buffer: Any, timeout_ms: int) -> int:
        device.timeouts_ms.append(timeout_ms)
        device.written.append((endpoint, interface, bytes(memoryview(buffer))))
        if isinstance(device.transfer, usb.core.USBError):
            raise device.transfer
        return len(memoryview(buffer)) - device.short_by

    def bulk_read(self, device: Device, endpoint: int, interface: int, buffer: Any, timeout_ms: int) -> int:
        device.timeouts_ms.append(timeout_ms)
        if isinstance(device.transfer, usb.core.USBError):
            raise device.transfer
        memoryview(buffer)[: len(device.transfer)] = device.transfer
        return len(device.transfer)


def found(*devices: Device) -> FoundCamera:
    return find_camera(Backend(*devices), "camera.left", "KF-CAM-L")


def opened(device: Device) -> UsbCamera:
    return UsbCamera("camera.left", found(device))


@pytest.mark.parametrize("interrupts", [False, True], ids=["bulk", "others before the bulk endpoints"])
def test_a_camera_is_found_by_the_serial_number_of_its_vision_descriptor(interrupts: bool) -> None:
    devices = (Device(vision=False), Device("KF-CAM-R"), Device("KF-CAM-L", interrupts=interrupts))
    camera = found(*devices)
    assert camera.serial == "KF-CAM-L"
    assert (camera.layout.control_in, camera.layout.control_out, camera.layout.stream_in) == (0x81, 0x01, 0x83)
    assert not any(device.is_open for device in devices), "looking leaves none open"


@pytest.mark.parametrize(
    ("devices", "kind", "said"),
    [
        ([Device("KF-CAM-R"), Device(vision=False)], DeviceGone, "KF-CAM-L not found; the bus has KF-CAM-R"),
        ([Device(open_error=errno.ENODEV), Device("KF-CAM-R")], DeviceGone, "KF-CAM-L not found; the bus has KF-CAM-R"),
        ([], DeviceGone, "no USB3 Vision camera"),
        ([Device(open_error=errno.EACCES)], DeviceRefused, "udev"),
    ],
)
def test_a_camera_that_is_not_found_is_gone_or_forbidden(
    devices: list[Device], kind: type[DeviceError], said: str
) -> None:
    with pytest.raises(kind, match=said) as caught:
        found(*devices)
    assert caught.value.device == "camera.left"


def test_a_device_that_leaves_during_enumeration_disturbs_nobody() -> None:
    leaving = Device("KF-CAM-R", enumeration_error=errno.ENODEV)
    assert [camera.serial for camera in find_cameras(Backend(leaving, Device()))] == ["KF-CAM-L"]


def test_opening_claims_control_and_stream_and_closing_returns_them() -> None:
    device = Device()
    camera = opened(device)
    assert device.claimed == [0, 2]
    assert device.configuration == 1
    camera.close()
    camera.close()
    assert device.claimed == []
    assert not device.is_open


@pytest.mark.parametrize("at", ["open_error", "claim_error"])
@pytest.mark.parametrize(
    ("number", "kind", "remedy"),
    [
        (errno.EBUSY, DeviceRefused, "Stop it, then try again"),
        (errno.EACCES, DeviceRefused, "Install the udev rules and re-plug it"),
        (errno.EPERM, DeviceRefused, "Install the udev rules and re-plug it"),
        (errno.ENODEV, DeviceGone, "Re-plug the camera"),
    ],
)
def test_each_failure_to_open_has_its_remedy_and_leaks_nothing(
    number: int, kind: type[DeviceError], remedy: str, at: str
) -> None:
    device = Device()
    camera = found(device)
    setattr(device, at, number)
    with pytest.raises(kind) as caught:
        UsbCamera("camera.left", camera)
    assert (caught.value.device, caught.value.remedy) == ("camera.left", remedy)
    assert device.claimed == []
    assert not device.is_open


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (usb_error(errno.EPIPE), TransferStalled),
        (usb_error(errno.EOVERFLOW), TransferOverflow),
        (usb_error(errno.ENODEV), Unplugged),
        (usb_error(errno.EIO), Unplugged),
        (usb.core.USBError("known by its number", -7, errno.ETIMEDOUT), TransferTimeout),
        (usb.core.USBTimeoutError("known by its kind", -7, None), TransferTimeout),
    ],
)
def test_each_failure_of_a_transfer_has_its_name(error: usb.core.USBError, kind: type[Exception]) -> None:
    camera = opened(Device(transfer=error))
    with pytest.raises(kind):
        camera.control().read(1024, 0.1)


def test_a_transfer_fills_the_callers_memory_and_never_waits_for_ever() -> None:
    device = Device(transfer=b"pixels")
    slot = np.zeros((2, 4), np.uint8)
    assert opened(device).stream().read_into(transfer_buffer(slot), 0.0) == 6
    assert slot.tobytes() == b"pixels\0\0"
    assert device.timeouts_ms == [1]  # libusb takes 0 for "no timeout"


def test_pyusbs_libusb_backend_fills_the_same_memory() -> None:
    """Pins how pyusb hands a buffer to libusb: by the address that ``buffer_info`` tells."""
    backend = object.__new__(usb.backend.libusb1._LibUSB)  # without the library: only its transfer routine is used
    backend._finalizer = lambda: None
    slot = np.zeros((2, 4), np.uint8)

    def libusb_bulk_transfer(handle: Any, endpoint: int, data: Any, length: int, done: Any, timeout_ms: int) -> int:
        assert (endpoint, length, timeout_ms) == (0x83, 8, 250)
        for i in range(length):
            data[i] = i + 1
        done._obj.value = length
        return 0

    read = backend._LibUSB__read
    assert read(libusb_bulk_transfer, SimpleNamespace(handle=None), 0x83, 2, transfer_buffer(slot), 250) == 8
    assert slot.tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]


@pytest.mark.parametrize(
    ("speed", "mbps"), [(1, 2), (2, 12), (3, 480), (4, 5000), (5, 10000), (6, 20000), (0, None), (None, None)]
)
def test_the_link_has_the_speed_that_the_host_says(speed: int | None, mbps: int | None) -> None:
    """libusb's names of speeds, rounded to whole Mbit/s; 0 is unknown."""
    assert found(Device(speed=speed)).link_speed_mbps == mbps


def test_a_halt_is_cleared_on_every_endpoint_of_a_pipe_and_only_a_camera_that_left_makes_it_fail() -> None:
    device = Device()
    camera = opened(device)
    camera.control().clear_halt()
    assert device.halts_cleared == [0x81, 0x01]
    camera.stream().clear_halt()
    assert device.halts_cleared == [0x81, 0x01, 0x83]
    device.halt_error = errno.EPIPE
    camera.stream().clear_halt()
    device.halt_error = errno.ENODEV
    with pytest.raises(Unplugged):
        camera.stream().clear_halt()


@pytest.mark.parametrize(("timeout_s", "timeout_ms"), [(0.25, 250), (1.0, 1000), (0.0004, 1), (0.0026, 3), (-1.0, 1)])
def test_a_transfer_waits_as_long_as_it_was_told(timeout_s: float, timeout_ms: int) -> None:
    device = Device(transfer=b"answer")
    pipe = opened(device).control()
    assert pipe.read(1024, timeout_s) == b"answer"
    pipe.write(b"command", timeout_s)
    assert device.timeouts_ms == [timeout_ms, timeout_ms]


def test_a_command_goes_out_whole_on_the_way_out_or_is_said_not_to() -> None:
    device = Device(transfer=b"")
    camera = opened(device)
    camera.control().write(b"command", 0.1)
    assert device.written == [(0x01, 0, b"command")]
    device.short_by = 1
    with pytest.raises(TransferTimeout, match="6 of 7 bytes written"):
        camera.control().write(b"command", 0.1)
    device.transfer = usb_error(errno.ENODEV)
    with pytest.raises(Unplugged):
        camera.control().write(b"command", 0.1)
    with pytest.raises(ValueError, match="no way out"):
        camera.stream().write(b"command", 0.1)  # type: ignore[attr-defined]


def test_a_configuration_that_is_active_is_not_set_again() -> None:
    for configuration, set_times in ((1, 0), (0, 1), (2, 1)):
        device = Device(configuration=configuration)
        opened(device)
        assert (device.configuration, device.configured) == (1, set_times)


def test_a_camera_that_was_unplugged_closes_silently() -> None:
    device = Device()
    camera = opened(device)
    device.release_error = errno.ENODEV
    camera.close()
    assert not device.is_open


def test_without_a_serial_number_of_its_own_the_devices_serves() -> None:
    nameless = DEVICE_INFO[:17] + b"\0" + DEVICE_INFO[18:]
    assert [camera.serial for camera in find_cameras(Backend(Device(info=nameless)))] == ["not the U3V serial"]
    assert [camera.serial for camera in find_cameras(Backend(Device(info=b"")))] == ["not the U3V serial"]


@pytest.mark.parametrize(
    "device",
    [Device(info=b"", iserial=0), Device(string=b"\x04\x09no string")],
    ids=["none", "not a string"],
)
def test_a_camera_without_a_readable_serial_number_may_be_the_one(device: Device) -> None:
    (nameless,) = find_cameras(Backend(device))
    assert (nameless.serial, nameless.unreadable) == (None, "")
    with pytest.raises(DeviceRefused, match="bus 1 address 7: no serial number"):
        found(device, Device("KF-CAM-R"))
    assert not device.is_open


def test_without_the_library_it_is_said_which_package_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda: None)
    with pytest.raises(DeviceGone, match=r"Install the package libusb-1\.0-0"):
        default_backend()
    backend = object()
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda: backend)
    assert default_backend() is backend
