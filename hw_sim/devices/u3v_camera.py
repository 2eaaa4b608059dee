"""One USB3 Vision camera on the bus: descriptors, control requests, four bulk endpoints, power.

All calls with the world's lock held. Errors of the host raise ``Stall`` or ``Overflow``, as on the bus.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hw_sim.clocks import Clocks, Wander
from hw_sim.devices import u3v_descriptors as usb
from hw_sim.devices import u3v_registers
from hw_sim.devices.board import Shot
from hw_sim.devices.feature_book import FeatureBook
from hw_sim.devices.gencp_memory import AccessError, Status
from hw_sim.devices.picture import payload
from hw_sim.devices.power_on import POLITE, PowerOn
from hw_sim.devices.shutter import ROOM_BLOCKS, Exposure, Latent, ReadFrame, Settings, Shutter
from hw_sim.devices.u3v_control import MAX_COMMAND, ControlChannel
from hw_sim.devices.u3v_descriptors import Identity, Speed
from hw_sim.devices.u3v_stream import OVERRUN, Block, Overflow, Region, Setup, StreamPipe, StreamRules
from hw_sim.devices.usb_standard import Stall as Stall
from hw_sim.faults import FaultBook
from hw_sim.timing.world_time import WorldTime

LATENCY_SIGMAS = 4.0
"""Mean latency of a trigger input with jitter, in standard deviations: almost no pulse is early."""
ARMING_NS = 30_000_000
"""Start-up time of the sensor: longer than the response time, so that the host gets a PENDING_ACK."""
_GET_STATUS, _CLEAR_FEATURE, _SET_FEATURE, _GET_DESCRIPTOR = 0x00, 0x01, 0x03, 0x06
_GET_CONFIGURATION, _SET_CONFIGURATION, _GET_INTERFACE, _SET_INTERFACE = 0x08, 0x09, 0x0A, 0x0B
_ENDPOINT_HALT = 0


class U3vCamera:
    """A camera; ``name`` is its name in fault sentences, ``expose`` begins an image of its whole sensor."""

    def __init__(
        self,
        name: str,
        serial: str,
        sensor: tuple[int, int],
        time: WorldTime,
        faults: FaultBook,
        expose: Callable[[Exposure], Latent | None],
        temperature_c: Callable[[], float],
        seed: int,
        power_on: PowerOn = POLITE,
        clocks: Clocks | None = None,
    ) -> None:
        """``clocks``: errors of trigger and clock beyond a constant, and the meaning of a time stamp; ``None``: no
        errors, and time stamps of the start of an exposure."""
        """``sensor``: columns and rows of the picture that ``expose`` makes; a maker's sensor has a border around it."""
        self.name = name
        self._time, self._faults = time, faults
        self.power_on = power_on
        self.temperature_c = temperature_c
        rng = np.random.default_rng([seed, *serial.encode()])
        # No two cameras share a clock: offset and drift (crystals of 40 ppm) are drawn from the serial number.
        self._clock_offset_ns = int(rng.integers(10**9, 10**12))
        self._clock_ppm = float(rng.uniform(-40.0, 40.0))
        self._noise = rng
        self._jitter_ns = 0.0 if clocks is None else 1000.0 * clocks.camera_jitter_us
        self._jitter = np.random.default_rng([seed, *serial.encode(), 1])
        self._wander = None if clocks is None else Wander(clocks, (seed, *serial.encode(), 2))
        self._stamps_at_end = clocks is not None and clocks.stamps_at_end == 1
        maker = power_on.maker
        self.book = None if maker is None else FeatureBook(maker, sensor, power_on.saved, self)
        """The values of a maker's features; ``None`` for the usual camera."""
        self.rules = StreamRules() if maker is None else maker.stream
        self.sensor = sensor if self.book is None else self.book.sensor
        self.usb_ids = (usb.VENDOR_ID, usb.PRODUCT_ID) if maker is None else (maker.vendor_id, maker.product_id)
        """USB numbers of vendor and product."""
        guid = f"{self.usb_ids[0]:04X}{int(rng.integers(0, 2**32)):08X}"
        names = ("Kingfisher", "KFC1920", "KFC") if maker is None else (maker.vendor, maker.model, maker.family)
        self.identity = Identity(*names, "1.0", f"{self.sensor[0]}x{self.sensor[1]} mono", guid, serial, serial)
        self.speed = Speed.SUPER
        self.plugged = True
        self.enumeration = 0
        """Counts how often it appeared on the bus; a handle is good for one of them."""
        self.region: Region
        self._pipe = StreamPipe()
        self.shutter = Shutter(
            *(name, time, faults, expose, self._send),
            unread=lambda: self._pipe.blocks,
            link_ns=lambda: int(self.region.payload_bytes / self.speed.bytes_per_s * 1e9),
            rows=lambda: self.region.height / sensor[1] if self.book is None else self.book.rows,
            power_on=power_on,
        )
        self.streaming = False
        self._power_up()
        if power_on.left_halted:
            self._halted.add(usb.STREAM_IN)
            self._stuck.add(usb.STREAM_IN)
        self._memory = u3v_registers.build(self)
        self._control = ControlChannel(time, self._memory, self._write_duration_ns)

    def _power_up(self) -> None:
        x, y = self.power_on.offset_x_px, self.power_on.offset_y_px
        self.region = Region(self.sensor[0] - x, self.sensor[1] - y, x, y)
        self.setup = Setup()
        self.streaming = False
        self.user_name = self.identity.user_name.encode().ljust(64, b"\0")
        self._configuration = 1
        self._halted: set[int] = set()
        self._stuck: set[int] = set()
        """Endpoints that stay halted until the host has halted them itself."""
        self.once_enabled = False
        """The stream was enabled since the camera powered up."""
        self._swapped: Block | None = None
        """Lets the next one pass."""
        self._overrun_told = False
        self._pipe.clear()
        self.shutter.power_up()
        if self.book is not None:
            self.book.load(self.power_on.saved)
            self.features_changed("")

    def refresh(self, time_ns: int) -> None:
        """Check the faults again: the camera may leave the bus, come back, or come back slower."""
        plugged = self._faults.active(self.name, "off") is None
        speed = Speed.HIGH if self._faults.active(self.name, "slow") else Speed.SUPER
        if (plugged, speed) != (self.plugged, self.speed):
            self.plugged, self.speed = plugged, speed
            self.restart()

    # ------------------------------------------------------------------------------------------ behind the registers

    @property
    def settings(self) -> Settings:
        """The settings by the host."""
        return self.shutter.settings

    @property
    def acquiring(self) -> bool:
        """True while an acquisition runs."""
        return self.shutter.acquiring

    def clock_ns(self) -> int:
        """Return the camera's clock now."""
        return self._camera_time_ns(self._time.now_ns())

    def _camera_time_ns(self, time_ns: int) -> int:
        tick_ns = u3v_registers.TIMESTAMP_INCREMENT_NS
        ahead_ns = 0 if self._wander is None else self._wander.ahead_ns(time_ns)
        return (self._clock_offset_ns + int(time_ns * (1.0 + self._clock_ppm * 1e-6)) + ahead_ns) // tick_ns * tick_ns

    def start(self) -> None:
        """Execute AcquisitionStart. Raises AccessError."""
        if usb.STREAM_IN in self._halted:
            raise AccessError(Status.STREAM_ENDPOINT_HALTED)
        if self.power_on.needs_lock and self.book is not None and not self.book.number("TLParamsLocked"):
            raise AccessError(Status.ACCESS_DENIED)
        self._overrun_told = False
        if not self.acquiring:
            self._swapped = None
        self.shutter.start()

    def stop(self) -> None:
        """Execute AcquisitionStop."""
        self.shutter.stop()

    def software_trigger(self) -> None:
        """Execute TriggerSoftware."""
        if self.book is None or self.book.software_trigger_is_for_frames():
            self.shutter.software()
        else:
            self.shutter.software_hold()

    def trigger_mode_changed(self) -> None:
        """Note that TriggerMode was written."""
        self.shutter.trigger_mode_changed()

    def features_changed(self, name: str) -> None:
        """Apply a maker's features, of which ``name`` was written, to sensor and stream."""
        if self.book is not None:
            self.region = self.book.region
            self.shutter.settings = self.book.settings()
            if name == "TriggerMode":
                self.shutter.trigger_mode_changed()

    def restart(self) -> None:
        """Reset the camera (DeviceReset, or the cable): all state is lost, and it is a new device on the bus."""
        self.enumeration += 1
        self._control.reset()
        self._power_up()
        self._time.condition.notify_all()

    def stream(self, on: bool) -> None:
        """Set the stream interface's control bit. Raises AccessError."""
        if on and not self.streaming:
            if usb.STREAM_IN in self._halted:
                raise AccessError(Status.STREAM_ENDPOINT_HALTED)
            self.setup.check(self.region, self.rules)
            self.once_enabled = True
        if on != self.streaming:
            if not self.power_on.keeps_stale:
                self._pipe.clear()
            self._swapped = None
            self.streaming = on

    def _write_duration_ns(self, address: int) -> int:
        return ARMING_NS if address == u3v_registers.start_address(self.book) else 0

    # ------------------------------------------------------------------------------------------ frames

    @property
    def room(self) -> bool:
        """True if the host reads fast enough."""
        return self._pipe.blocks < min(ROOM_BLOCKS, self.power_on.memory_blocks)

    def line0(self, time_ns: int, width_ns: int, shot: Shot) -> None:
        """Handle a pulse of the trigger line."""
        if not self.plugged:
            return
        if self._jitter_ns:
            # The edge is passed on after a latency with jitter; no exposure begins before its pulse.
            time_ns += max(round(self._jitter_ns * (LATENCY_SIGMAS + self._jitter.standard_normal())), 0)
        self.shutter.line0(time_ns, width_ns, shot)

    def _send(self, sent_frame: ReadFrame) -> None:
        """Send a frame that is ready for the link, with the effects of a fault."""
        if not self.streaming or not self.plugged:
            return
        exposure = sent_frame.exposure
        time_ns = self._camera_time_ns(exposure.start_ns + (exposure.duration_ns if self._stamps_at_end else 0))
        if sent_frame.latent is None:
            # The first block that meets a full memory is still announced; later ones leave only a gap.
            if not self._overrun_told:
                self._overrun_told = True
                self._put(Block(sent_frame.block_id, time_ns, self.region, b"", OVERRUN))
            return
        self._overrun_told = False
        r = self.region
        block = Block(sent_frame.block_id, time_ns, r, self._payload(sent_frame.latent.image, sent_frame.block_id))
        frame, count = sent_frame.exposure.shot.frame, sent_frame.exposure.shot.count
        if self._strikes("intermittent", None, frame):
            return
        if self._swapped is None and self._changes_places(frame, count):
            self._swapped = block
            return
        block = self._spoil(block, frame)
        self._put(block)
        if self._strikes("wrong", "repeat", frame):
            self._put(block)
        if self._swapped is not None:
            self._put(self._swapped)
            self._swapped = None

    def _payload(self, image: NDArray[np.uint8], block_id: int) -> bytes | memoryview:
        r = self.region
        if self.book is None:
            pixels = image[r.offset_y : r.offset_y + r.height, r.offset_x : r.offset_x + r.width]
            return np.ascontiguousarray(pixels).reshape(-1).data
        return r.with_chunks(payload(image, self.sensor, self.book.processing, r), block_id)

    def _changes_places(self, frame: int | None, count: int | None) -> bool:
        """Return True if a frame is swapped with the next one.

        The last frame of a sequence has no next one, so that the one before it is used instead.
        """
        if self._strikes("wrong", "swap", frame):
            return True
        return (
            frame is not None and count is not None and frame == count - 2 and self._strikes("wrong", "swap", count - 1)
        )

    def _spoil(self, block: Block, frame: int | None) -> Block:
        if self._strikes("garbage", "truncate", frame):
            packet = self.speed.bulk_packet
            # Half of the payload and half a packet: the transfer ends with a short packet, as after an error of the link.
            half = len(block.payload) // 2 // packet * packet + packet // 2
            return replace(block, payload=block.payload[: min(half, len(block.payload) - 1)])
        if self._strikes("garbage", "leader", frame):
            return replace(block, spoilt_leader=self._noise.bytes(52))
        if self._strikes("garbage", "trailer", frame):
            return replace(block, spoilt_trailer=self._noise.bytes(32))
        return block

    def _strikes(self, verb: str, how: str | None, frame: int | None) -> bool:
        return self._faults.strike(self.name, verb, how, frame) is not None

    def _put(self, block: Block) -> None:
        self._pipe.send(block, self.setup)
        self._time.condition.notify_all()

    # ------------------------------------------------------------------------------------------ the bus

    def device_descriptor(self) -> bytes:
        """Return the device descriptor: 18 bytes."""
        return usb.device(self.speed, self.usb_ids)

    def configuration_descriptor(self) -> bytes:
        """Return the complete configuration descriptor."""
        return usb.configuration(self.speed)

    def request(self, kind: int, request: int, value: int, index: int, length: int) -> bytes:
        """Do a control transfer on endpoint 0; return the data of an IN request. Raises Stall."""
        answer = self._standard_in(kind, request, value, index) if kind & 0x80 else b""
        if answer is None or (not kind & 0x80 and not self._standard_out(kind, request, value, index)):
            raise Stall
        return answer[:length]

    def _standard_in(self, kind: int, request: int, value: int, index: int) -> bytes | None:
        match kind, request:
            # USB 3.2, 9.4: GET_DESCRIPTOR, GET_CONFIGURATION, GET_INTERFACE, GET_STATUS.
            case 0x80, 0x06:
                return self._descriptor(value >> 8, value & 0xFF)
            case 0x80, 0x08:
                return bytes([self._configuration])
            case 0x81, 0x0A:
                return b"\0" if index < 3 else None
            case ((0x80 | 0x81), 0x00):
                return b"\0\0"
            case 0x82, 0x00:
                return struct.pack("<H", index in self._halted)
            case _:
                return None

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        match kind:
            case 1:
                return usb.device(self.speed, self.usb_ids)
            case 2:
                return usb.configuration(self.speed) if index == 0 else None
            case 3:
                return usb.string(self.identity, index)
            case 15:
                return usb.bos(self.speed)
            case _:
                return None

    def _standard_out(self, kind: int, request: int, value: int, index: int) -> bool:
        match kind, request:
            # SET_CONFIGURATION, SET_INTERFACE, CLEAR_FEATURE and SET_FEATURE of ENDPOINT_HALT.
            case 0x00, 0x09:
                if value not in (0, 1):
                    return False
                self._configuration = value
                return True
            case 0x01, 0x0B:
                return index < 3 and value == 0
            case 0x02, 0x01 if value == _ENDPOINT_HALT:
                self.clear_halt(index)
                return True
            case 0x02, 0x03 if value == _ENDPOINT_HALT:
                self._halted.add(index)
                self._stuck.discard(index)
                if index == usb.STREAM_IN:
                    self._pipe.clear()
                return True
            case _:
                return False

    def clear_halt(self, endpoint: int) -> None:
        """Do CLEAR_FEATURE(ENDPOINT_HALT)."""
        if endpoint not in self._stuck:
            self._halted.discard(endpoint)

    def write(self, endpoint: int, data: bytes) -> int:
        """Do a bulk OUT transfer; return the number of bytes. Raises Stall."""
        if endpoint != usb.CONTROL_OUT or endpoint in self._halted or len(data) > MAX_COMMAND:
            raise Stall
        self._control.receive(data)
        return len(data)

    def read(self, endpoint: int, buffer: memoryview) -> tuple[int, bool]:
        """Do a bulk IN transfer of the available data; return the byte count, and whether the transfer ends.

        Raises Stall, Overflow.
        """
        if endpoint in self._halted:
            raise Stall
        match endpoint:
            case usb.CONTROL_IN:
                ack = self._control.take()
                if ack is None:
                    return 0, False
                if len(ack) > len(buffer):
                    raise Overflow
                buffer[: len(ack)] = ack
                return len(ack), True
            case usb.STREAM_IN:
                largest = self.power_on.largest_transfer_bytes
                if largest is not None and len(buffer) > largest:
                    raise Stall
                filled, done = self._pipe.read(buffer, self.speed.bulk_packet)
                if filled:
                    self._time.condition.notify_all()
                return filled, done
            case usb.EVENT_IN:
                return 0, False
            case _:
                raise Stall
