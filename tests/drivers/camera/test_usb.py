"""Finding and opening a camera over a pyusb backend of this test's own, and what each failure tells the operator."""

from __future__ import annotations

import errno

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
from tests.drivers.camera.scripted import DEVICE_INFO, Bus, Device, usb_error


def found(*devices: Device) -> FoundCamera:
    return find_camera(Bus(*devices), "camera.left", "KF-CAM-L")


def opened(device: Device) -> UsbCamera:
    return UsbCamera("camera.left", found(device))


@pytest.mark.parametrize("interrupts", [False, True], ids=["bulk", "others before the bulk endpoints"])
def test_a_camera_is_found_by_the_serial_number_of_its_vision_descriptor_or_of_the_device(interrupts: bool) -> None:
    leaving = Device("KF-CAM-R", fails={"ask": errno.ENODEV})
    devices = (Device(vision=False), leaving, Device("KF-CAM-R"), Device("KF-CAM-L", interrupts=interrupts))
    camera = found(*devices)
    assert camera.serial == "KF-CAM-L"
    assert (camera.layout.control_in, camera.layout.control_out, camera.layout.stream_in) == (0x81, 0x01, 0x83)
    assert not any(device.is_open for device in devices), "looking leaves none open"
    for info in (DEVICE_INFO[:17] + b"\0" + DEVICE_INFO[18:], b""):
        assert [camera.serial for camera in find_cameras(Bus(Device(info=info)))] == ["not the U3V serial"]


def test_the_link_has_the_speed_that_the_host_says() -> None:
    """libusb's names of speeds, rounded to whole Mbit/s; 0 is unknown."""
    speeds_mbps = {1: 2, 2: 12, 3: 480, 4: 5000, 5: 10000, 6: 20000, 0: None, None: None}
    assert {speed: found(Device(speed=speed)).link_speed_mbps for speed in speeds_mbps} == speeds_mbps


@pytest.mark.parametrize(
    ("devices", "kind", "said"),
    [
        ([Device("KF-CAM-R"), Device(vision=False)], DeviceGone, "KF-CAM-L not found; the bus has KF-CAM-R"),
        ([Device(fails={"open": errno.ENODEV}), Device("KF-CAM-R")], DeviceGone, "the bus has KF-CAM-R"),
        ([], DeviceGone, "no USB3 Vision camera"),
        ([Device(fails={"open": errno.EACCES})], DeviceRefused, "udev"),
        ([Device(info=b"", iserial=0), Device("KF-CAM-R")], DeviceRefused, "bus 1 address 7: no serial number"),
        ([Device(string=b"\x04\x09no string")], DeviceRefused, "bus 1 address 7: no serial number"),
    ],
)
def test_a_camera_that_is_not_found_is_gone_or_forbidden(
    devices: list[Device], kind: type[DeviceError], said: str
) -> None:
    with pytest.raises(kind, match=said) as caught:
        found(*devices)
    assert caught.value.device == "camera.left"
    assert not any(device.is_open for device in devices)


@pytest.mark.parametrize("configuration", [0, 1, 2])
def test_opening_claims_control_and_stream_sets_no_configuration_anew_and_closing_returns_them(
    configuration: int,
) -> None:
    device = Device(configuration=configuration)
    camera = opened(device)
    assert device.claimed == [0, 2]
    assert device.log == ([] if configuration == 1 else [("configuration", 1)])
    camera.close()
    camera.close()
    assert (device.claimed, device.is_open) == ([], False)
    camera = opened(device)
    device.plugged = False
    camera.close()
    assert not device.is_open, "one that was unplugged closes silently"


@pytest.mark.parametrize("at", ["open", "claim"])
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
    device.fails[at] = number
    with pytest.raises(kind) as caught:
        UsbCamera("camera.left", camera)
    assert (caught.value.device, caught.value.remedy) == ("camera.left", remedy)
    assert (device.claimed, device.is_open) == ([], False)


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
def test_each_failure_of_a_transfer_has_its_name(
    error: usb.core.USBError, kind: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(what: str) -> None:
        raise error

    device = Device()
    pipe = opened(device).control()
    monkeypatch.setattr(device, "may", fail)
    with pytest.raises(kind):
        pipe.read(1024, 0.1)
    with pytest.raises(kind):
        pipe.write(b"command", 0.1)


@pytest.mark.parametrize(("timeout_s", "timeout_ms"), [(0.25, 250), (0.0004, 1), (0.0, 1), (0.0026, 3), (-1.0, 1)])
def test_a_transfer_waits_as_long_as_it_was_told_and_never_for_ever(timeout_s: float, timeout_ms: int) -> None:
    """0 is "no timeout" to libusb."""
    device = Device(configuration=1, answer=b"answer")
    camera = opened(device)
    assert camera.control().read(1024, timeout_s) == b"answer"
    camera.control().write(b"command", timeout_s)
    assert device.log == [("0x1 b'command'", 7)]
    slot = np.full((2, 4), 9, np.uint8)
    assert camera.stream().read_into(transfer_buffer(slot), timeout_s) == 6
    assert slot.tobytes() == b"answer\x09\x09"
    assert device.timeouts_ms == [timeout_ms] * 3
    device.short_by = 1
    with pytest.raises(TransferTimeout, match="6 of 7 bytes written"):
        camera.control().write(b"command", 0.1)
    with pytest.raises(ValueError, match="no OUT direction"):
        camera.stream().write(b"command", 0.1)  # type: ignore[attr-defined]


def test_a_halt_is_cleared_on_every_endpoint_of_a_pipe_and_only_a_camera_that_left_makes_it_fail() -> None:
    device = Device(configuration=1)
    camera = opened(device)
    camera.control().clear_halt()
    camera.stream().clear_halt()
    assert device.log == [("clear halt", 0x81), ("clear halt", 0x01), ("clear halt", 0x83)]
    device.fails["clear"] = errno.EPIPE
    camera.stream().clear_halt()
    device.plugged = False
    with pytest.raises(Unplugged):
        camera.stream().clear_halt()


def test_without_the_library_it_is_said_which_package_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    for backend in (None, object()):
        monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda backend=backend: backend)
        if backend is None:
            with pytest.raises(DeviceGone, match=r"libusb-1\.0-0"):
                default_backend()
        else:
            assert default_backend() is backend
