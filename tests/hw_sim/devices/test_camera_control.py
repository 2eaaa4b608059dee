"""The camera answers as GenCP and USB3 Vision say, and its own description of itself works."""

from __future__ import annotations

import array
import hashlib
import io
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import pytest
import usb.core
import usb.util
from genicam.genapi import AbstractPort, EAccessMode, NodeMap, OutOfRangeException, is_writable

from tests.hw_sim.conftest import Bench
from tests.hw_sim.devices.host import GencpError, U3vHost

WIDTH_REGISTER, MODEL, USER_NAME = 0x200000, 0x044, 0x184


@pytest.fixture
def camera(bench: Bench) -> U3vHost:
    return U3vHost(bench.wires.usb_backend, "KF-CAM-L")


def status(camera: U3vHost, code: int, payload: bytes) -> int:
    return camera.command(code, payload)[0]


def read_command(address: int, size: int, reserved: int = 0) -> bytes:
    return struct.pack("<QHH", address, reserved, size)


# ---------------------------------------------------------------------------------------------- descriptors


def test_the_bus_shows_two_cameras_with_three_interfaces_each(bench: Bench) -> None:
    devices = list(usb.core.find(find_all=True, backend=bench.wires.usb_backend))
    assert len(devices) == 2
    assert len({(d.bus, d.address) for d in devices}) == 2
    for device in devices:
        assert (device.bDeviceClass, device.bDeviceSubClass, device.bDeviceProtocol) == (0xEF, 0x02, 0x01)
        assert (device.bcdUSB, device.bMaxPacketSize0, device.speed) == (0x0300, 9, usb.util.SPEED_SUPER)
        (configuration,) = list(device)
        assert configuration.bNumInterfaces == 3
        association = bytes(configuration.extra_descriptors)
        assert association[:2] == bytes([8, 11])
        assert association[2:7] == bytes([0, 3, 0xEF, 0x05, 0x00])
        interfaces = list(configuration)
        assert [(i.bInterfaceClass, i.bInterfaceSubClass, i.bInterfaceProtocol) for i in interfaces] == [
            (0xEF, 0x05, protocol) for protocol in (0, 1, 2)
        ]
        directions = [[e.bEndpointAddress >> 7 for e in i] for i in interfaces]
        assert [sorted(d) for d in directions] == [[0, 1], [1], [1]]
        for endpoint in (e for i in interfaces for e in i):
            assert (endpoint.bmAttributes & 3, endpoint.wMaxPacketSize) == (2, 1024)
            assert list(endpoint.extra_descriptors[:2]) == [6, 48], "SuperSpeed companion"


def test_the_device_info_descriptor_names_the_camera(bench: Bench, camera: U3vHost) -> None:
    interface = camera.device[0][(0, 0)]
    info = bytes(interface.extra_descriptors)
    assert (info[0], info[1], info[2]) == (20, 0x24, 0x01)
    minor, major, u3v_minor, u3v_major = struct.unpack_from("<HHHH", info, 3)
    assert (major, u3v_major) == (1, 1)
    assert camera.u32(0x000) == major << 16 | minor
    sbrm = camera.u64(0x1D8)
    assert camera.u32(sbrm) == u3v_major << 16 | u3v_minor
    texts = [usb.util.get_string(camera.device, index) for index in info[11:19]]
    guid, vendor, model, _, version, _, serial, _ = texts
    assert serial == "KF-CAM-L"
    assert len(guid) == 12
    assert guid == camera.device.serial_number
    assert camera.read(0x004, 64).rstrip(b"\0").decode() == vendor
    assert camera.read(0x0C4, 64).rstrip(b"\0").decode() == version
    assert camera.read(MODEL, 64).rstrip(b"\0").decode() == model
    assert info[19] & 0x08, "SuperSpeed is supported"


def test_binary_object_store(camera: U3vHost) -> None:
    bos = camera.device.ctrl_transfer(0x80, 0x06, 0x0F00, 0, 255).tobytes()
    assert struct.unpack_from("<H", bos, 2)[0] == len(bos)
    kinds = []
    at = bos[0]
    while at < len(bos):
        kinds.append(bos[at + 2])
        at += bos[at]
    assert kinds == [2, 3]


def test_an_unknown_request_stalls(camera: U3vHost) -> None:
    for kind, request, value in ((0x80, 0x06, 0x0200 | 9), (0xC0, 0x42, 0), (0x80, 0x06, 0x0300 | 99)):
        with pytest.raises(usb.core.USBError) as caught:
            camera.device.ctrl_transfer(kind, request, value, 0, 8)
        assert (caught.value.errno, caught.value.backend_error_code) == (32, -9)


def test_at_480_mbit_the_descriptors_change(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(faults=("camera.left slow",))
    slow = U3vHost(bench.wires.usb_backend, "KF-CAM-L")
    assert (slow.device.speed, slow.device.bcdUSB, slow.device.bMaxPacketSize0) == (3, 0x0210, 64)
    endpoints = [e for i in slow.device[0] for e in i]
    assert {e.wMaxPacketSize for e in endpoints} == {512}
    assert all(not e.extra_descriptors for e in endpoints)
    assert slow.u32(slow.u64(0x1D8) + 0x40) == 4, "current speed: high"
    fast = U3vHost(bench.wires.usb_backend, "KF-CAM-R")
    assert fast.u32(fast.u64(0x1D8) + 0x40) == 8


# ---------------------------------------------------------------------------------------------- GenCP


def test_errors_of_the_control_channel(camera: U3vHost) -> None:
    cases = [
        (0x0810, b"", 0x8001, "unknown command"),
        (0x0800, read_command(0x7_0000_0000, 4), 0x8003, "hole"),
        (0x0800, read_command(0x300, 4), 0x8003, "past the bootstrap registers"),
        (0x0800, read_command(0x000, 4)[:-1], 0x8002, "short"),
        (0x0800, read_command(0x000, 0), 0x8002, "nothing"),
        (0x0800, read_command(0x004, 1013), 0x8002, "longer than an acknowledge"),
        (0x0800, read_command(WIDTH_REGISTER + 2, 4), 0x8005, "not aligned"),
        (0x0800, read_command(WIDTH_REGISTER, 3), 0x8005, "not a multiple of four"),
        (0x0802, struct.pack("<Q", MODEL) + b"mine", 0x8004, "read only"),
        (0x0802, struct.pack("<Q", 0x200014) + b"\1\0\0\0", 0x8004, "read only"),
        (0x0802, struct.pack("<Q", WIDTH_REGISTER) + struct.pack("<I", 100), 0x8002, "not a step"),
        (0x0802, struct.pack("<Q", WIDTH_REGISTER) + struct.pack("<I", 4000), 0x8002, "too wide"),
        (0x0802, struct.pack("<Q", WIDTH_REGISTER), 0x8002, "no data"),
        (0x0800, read_command(0x200104, 4), 0x8006, "write only"),
        (0x0802, struct.pack("<Q", 0x7_0000_0000) + b"\0\0\0\0", 0x8003, "hole"),
    ]
    for code, payload, expected, why in cases:
        assert status(camera, code, payload) == expected, why
    assert camera.read(MODEL, 7) == b"KFC1920", "it goes on working, and strings need no alignment"


def test_a_header_that_lies_about_its_length(camera: U3vHost) -> None:
    packet = struct.pack("<IHHHH", 0x43563355, 0x4000, 0x0800, 99, 17) + read_command(0, 4)
    camera.device.write(0x01, packet)
    answer = camera.device.read(0x81, 1024, 500).tobytes()
    assert struct.unpack("<IHHHH", answer) == (0x43563355, 0x800E, 0x0801, 0, 17)


def test_what_is_no_command_is_not_answered(camera: U3vHost) -> None:
    for packet in (b"", b"U3V", b"GVCP" + bytes(20)):
        camera.device.write(0x01, packet)
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        camera.device.read(0x81, 1024, 50)
    assert (caught.value.errno, caught.value.backend_error_code) == (110, -7)


def test_a_write_without_acknowledge_is_done_silently(camera: U3vHost) -> None:
    payload = struct.pack("<Q", USER_NAME) + b"diver's left"
    packet = struct.pack("<IHHHH", 0x43563355, 0, 0x0802, len(payload), 5) + payload
    camera.device.write(0x01, packet)
    assert camera.read(USER_NAME, 64).rstrip(b"\0") == b"diver's left"


def test_a_command_that_does_not_fit_stalls_the_endpoint(camera: U3vHost) -> None:
    with pytest.raises(usb.core.USBError) as caught:
        camera.device.write(0x01, bytes(2000))
    assert caught.value.errno == 32


def test_an_answer_that_does_not_fit_overflows(camera: U3vHost) -> None:
    camera.device.write(0x01, struct.pack("<IHHHH", 0x43563355, 0x4000, 0x0800, 12, 9) + read_command(MODEL, 64))
    with pytest.raises(usb.core.USBError) as caught:
        camera.device.read(0x81, 16, 100)
    assert caught.value.errno == 75


def test_a_long_command_is_announced_and_the_next_one_is_too_early(camera: U3vHost) -> None:
    start = struct.pack("<Q", 0x200104) + struct.pack("<I", 1)
    camera.device.write(0x01, struct.pack("<IHHHH", 0x43563355, 0x4000, 0x0802, len(start), 70) + start)
    pending = struct.unpack("<IHHHHHH", camera.device.read(0x81, 1024, 500).tobytes())
    assert pending[2:5] == (0x0805, 4, 70)
    assert pending[6] > 0, "the time to wait in ms"
    camera.device.write(0x01, struct.pack("<IHHHH", 0x43563355, 0x4000, 0x0800, 12, 71) + read_command(0, 4))
    busy = struct.unpack("<IHHHH", camera.device.read(0x81, 1024, 500).tobytes())
    assert busy[1:] == (0x8007, 0x0801, 0, 71)
    done = struct.unpack("<IHHHHHH", camera.device.read(0x81, 1024, 500).tobytes())
    assert done[1:] == (0, 0x0803, 4, 70, 0, 4)


def test_the_clock_is_latched_and_is_the_cameras_own(bench: Bench) -> None:
    clock = bench.wires.clock
    drifts = []
    for serial in ("KF-CAM-L", "KF-CAM-R"):
        camera = U3vHost(bench.wires.usb_backend, serial)
        readings = []
        for _ in range(2):
            camera.put(0x1F8, 1)
            readings.append((clock.now_ns(), camera.u64(0x1F0)))
            assert camera.u64(0x1F0) == readings[-1][1], "latched"
            clock.sleep_s(0.4)
        (host_a, camera_a), (host_b, camera_b) = readings
        assert abs((camera_b - camera_a) / (host_b - host_a) - 1) < 0.02
        assert abs(camera_a - host_a) > 1e8, "its zero is not the host's"
        drifts.append(camera_a - host_a)
    assert drifts[0] != drifts[1]


# ---------------------------------------------------------------------------------------------- the description


class Port(AbstractPort):  # type: ignore[misc]
    """Register access for the node map, over the wire."""

    def __init__(self, camera: U3vHost) -> None:
        super().__init__()
        self.camera = camera

    def read(self, address: int, length: int) -> bytes:
        return self.camera.read_long(address, length)

    def write(self, address: int, data: bytes) -> None:
        self.camera.write(address, bytes(data))

    def get_access_mode(self) -> Any:
        return EAccessMode.RW


@pytest.fixture
def nodes(camera: U3vHost) -> Any:
    address, size, _ = camera.description_url()
    with zipfile.ZipFile(io.BytesIO(camera.read_long(address, size))) as archive:
        (name,) = archive.namelist()
        xml = archive.read(name).decode()
    node_map = NodeMap()
    node_map.load_xml_from_string(xml)
    port = Port(camera)
    node_map.connect(port, "Device")
    yield node_map
    del node_map, port


def test_the_manifest_describes_the_file_it_points_to(camera: U3vHost) -> None:
    address, size, schema = camera.description_url()
    assert schema >> 10 & 0x3F == 1, "zip"
    assert hashlib.sha1(camera.read_long(address, size)).digest() == camera.read(camera.u64(0x1D0) + 8 + 24, 20)


def test_features_read_the_camera(nodes: Any) -> None:
    expected = {
        "DeviceVendorName": "Kingfisher",
        "DeviceModelName": "KFC1920",
        "DeviceSerialNumber": "KF-CAM-L",
        "DeviceFirmwareVersion": "1.2.0",
        "SensorWidth": 160,
        "SensorHeight": 120,
        "WidthMax": 160,
        "Width": 160,
        "Height": 120,
        "PayloadSize": 19200,
        "PixelFormat": "Mono8",
        "AcquisitionMode": "Continuous",
        "TriggerSelector": "FrameStart",
        "TriggerMode": "Off",
        "TriggerSource": "Line0",
        "TriggerActivation": "RisingEdge",
        "ExposureMode": "Timed",
        "ExposureTime": 5000.0,
        "Gain": 0.0,
    }
    assert {name: nodes.get_node(name).value for name in expected} == expected
    assert 15 < nodes.get_node("DeviceTemperature").value < 45
    before = nodes.get_node("TimestampLatchValue").value
    nodes.get_node("TimestampLatch").execute()
    assert nodes.get_node("TimestampLatchValue").value > before


def test_limits_are_real(nodes: Any) -> None:
    width, exposure, gain = (nodes.get_node(name) for name in ("Width", "ExposureTime", "Gain"))
    assert (width.min, width.max, width.inc) == (16, 160, 8)
    width.value = 80
    nodes.get_node("OffsetX").value = 80
    assert width.max == 80
    assert nodes.get_node("PayloadSize").value == 80 * 120
    with pytest.raises(OutOfRangeException):
        width.value = 88
    assert (exposure.min, exposure.max) == (20.0, 1_000_000.0)
    exposure.value = 12_000.4
    assert exposure.value == 12_000.0, "the camera says what it really set"
    gain.value = 3.14
    assert gain.value == pytest.approx(3.1)
    assert gain.max == 24.0
    with pytest.raises(OutOfRangeException):
        gain.value = 24.1


def test_the_stream_locks_the_shape(nodes: Any, camera: U3vHost) -> None:
    nodes.get_node("TLParamsLocked").value = 1
    assert not is_writable(nodes.get_node("Width").get_access_mode())
    assert is_writable(nodes.get_node("ExposureTime").get_access_mode())
    camera.set_up_stream()
    with pytest.raises(GencpError) as caught:
        camera.put(WIDTH_REGISTER, 80)
    assert caught.value.args[0] == 0x8006, "the camera itself refuses, whatever the host's node map thinks"


# ---------------------------------------------------------------------------------------------- stream registers


def test_the_stream_registers_are_written_before_the_stream_runs(camera: U3vHost) -> None:
    assert camera.u32(camera.sirm) >> 24 <= 10
    assert camera.u64(camera.sirm + 8) == 19200
    assert (camera.u32(camera.sirm + 0x10), camera.u32(camera.sirm + 0x14)) == (52, 32)
    camera.set_up_stream()
    assert camera.u32(camera.sirm + 4) == 1
    with pytest.raises(GencpError) as caught:
        camera.put(camera.sirm + 0x1C, 1024)
    assert caught.value.args[0] == 0x8006


@pytest.mark.parametrize(
    ("offset", "value", "expected"),
    [(0x1C, 1024, 0xA004), (0x18, 48, 0xA004), (0x2C, 28, 0xA004), (0x24, 3, 0xA003)],
)
def test_a_stream_that_cannot_carry_a_block_is_not_enabled(
    camera: U3vHost, offset: int, value: int, expected: int
) -> None:
    camera.set_up_stream()
    camera.put(camera.sirm + 4, 0)
    camera.put(camera.sirm + offset, value)
    with pytest.raises(GencpError) as caught:
        camera.put(camera.sirm + 4, 1)
    assert caught.value.args[0] == expected


def test_a_halted_stream_endpoint_must_be_cleared_first(camera: U3vHost) -> None:
    camera.set_up_stream()
    camera.put(camera.sirm + 4, 0)
    camera.device.ctrl_transfer(0x02, 0x03, 0, 0x83)
    assert camera.device.ctrl_transfer(0x82, 0x00, 0, 0x83, 2)[0] == 1
    with pytest.raises(usb.core.USBError) as stalled:
        camera.device.read(0x83, array.array("B", bytes(52)), 50)
    assert stalled.value.errno == 32
    with pytest.raises(GencpError) as caught:
        camera.put(camera.sirm + 4, 1)
    assert caught.value.args[0] == 0xA002
    camera.device.clear_halt(0x83)
    camera.put(camera.sirm + 4, 1)
    assert camera.device.ctrl_transfer(0x82, 0x00, 0, 0x83, 2)[0] == 0


# ---------------------------------------------------------------------------------------------- the bus


def test_two_owners_of_an_interface(bench: Bench, camera: U3vHost) -> None:
    camera.read(0, 4)  # claims it
    other = next(
        d
        for d in usb.core.find(find_all=True, backend=bench.wires.usb_backend)
        if usb.util.get_string(d, 7) == "KF-CAM-L"
    )
    with pytest.raises(usb.core.USBError) as caught:
        usb.util.claim_interface(other, 0)
    assert caught.value.errno == 16
    usb.util.dispose_resources(camera.device)
    usb.util.claim_interface(other, 0)
    usb.util.dispose_resources(other)


def test_an_unplugged_camera_is_gone_and_another_one_when_it_comes_back(bench: Bench, camera: U3vHost) -> None:
    camera.put(0x200304, 7777)
    address = camera.device.address
    bench.world.fault("camera.left off")
    for call in (lambda: camera.read(0, 4), lambda: camera.device.read(0x83, 52, 100)):
        with pytest.raises(usb.core.USBError) as caught:
            call()
        assert (caught.value.errno, caught.value.backend_error_code) == (19, -4)
    assert len(list(usb.core.find(find_all=True, backend=bench.wires.usb_backend))) == 1
    bench.world.clear_faults()
    with pytest.raises(usb.core.USBError):
        camera.read(0, 4)
    again = U3vHost(bench.wires.usb_backend, "KF-CAM-L")
    assert again.device.address != address
    assert again.u32(0x200304) == 5000, "it has forgotten its settings"


def test_a_waiting_transfer_ends_when_the_cable_is_pulled(bench: Bench, camera: U3vHost) -> None:
    bench.world.fault("camera.left off at_s=0.2")
    with pytest.raises(usb.core.USBError) as caught:
        camera.device.read(0x83, 52, 5000)
    assert caught.value.errno == 19


def test_a_reset_keeps_the_handle_and_forgets_the_settings(camera: U3vHost) -> None:
    camera.put(0x200304, 7777)
    camera.device.reset()
    assert camera.u32(0x200304) == 5000


def test_a_device_reset_by_register_leaves_the_bus(bench: Bench, camera: U3vHost) -> None:
    packet = struct.pack("<Q", 0x200500) + struct.pack("<I", 1)
    camera.device.write(0x01, struct.pack("<IHHHH", 0x43563355, 0, 0x0802, len(packet), 5) + packet)
    with pytest.raises(usb.core.USBError) as caught:
        camera.read(0, 4)
    assert caught.value.errno == 19
    assert U3vHost(bench.wires.usb_backend, "KF-CAM-L").u32(0) == 0x0001_0003
