"""The graphics card: two heads that share one vertical blank, and their output.

All calls with the world's lock held; the system calls of the processes that opened the card are in ``card_file.py``.
"""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hw_sim.devices import drm_abi as abi
from hw_sim.devices.head import (
    LIMITED_RANGE,
    MODES,
    PROJECTOR_MODES,
    RGB_AUTOMATIC,
    RGB_FULL,
    Connector,
    Crtc,
    Flip,
    FlipOwner,
    Framebuffer,
    Output,
    copy_mode,
    slower_mode,
)

PROJECTOR_SIZE = (1024, 768)


class Card:
    """The card and its two monitors. ``notify`` is called when a pending operation may have completed."""

    def __init__(
        self,
        notify: Callable[[], None],
        refresh_hz: float = 60.0,
        *,
        copies: bool = False,
        projector_px: tuple[int, int] = PROJECTOR_SIZE,
    ) -> None:
        """``copies``: it scans out a copy that is made on request, as virtual and USB cards do. ``projector_px``:
        raster of the projector's chip."""
        self.notify = notify
        self.copies = copies
        self.projector_px = projector_px
        offered = {**MODES, Output.PROJECTOR: PROJECTOR_MODES[projector_px]}
        self.modes = {
            output: tuple(slower_mode(mode, refresh_hz) for mode in modes) for output, modes in offered.items()
        }
        """The modes that each monitor can show."""
        self.connectors = {
            95: Connector(Output.PROJECTOR, 95, 94, abi.CONNECTOR_HDMI_A, 1, (0, 0), broadcast_rgb=RGB_AUTOMATIC),
            103: Connector(Output.DISPLAY, 103, 102, abi.CONNECTOR_DISPLAY_PORT, 1, (154, 86)),
        }
        self.crtcs = {51: Crtc(51, sequence=4807), 72: Crtc(72, sequence=4791)}
        self.framebuffers: dict[int, tuple[FlipOwner, Framebuffer]] = {}
        self.files: list[FlipOwner] = []
        self.master: FlipOwner | None = None
        self._ids = itertools.count(200)
        self._blank_ns = 0
        self.present = True
        self.show_console()

    def plug(self, present: bool) -> None:
        """Remove the card, as after a fatal reset, or return it; nodes that were open stay dead."""
        if present == self.present:
            return
        self.present = present
        for file in list(self.files):
            file.cut()
        for crtc in self.crtcs.values():
            self.switch_off(crtc)
        self.framebuffers.clear()
        self.files.clear()
        self.master = None
        if present:
            self.show_console()
        self.notify()

    def opened(self, file: FlipOwner) -> None:
        """Note a file that opened the node; the first is its master. Raises OSError(ENODEV) if the card is removed."""
        if not self.present:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        self.files.append(file)
        if self.master is None:
            self.master = file

    def released(self, file: FlipOwner) -> None:
        """Note a file that closed the node: its framebuffers go; the last one leaves the card to the console."""
        if file not in self.files:
            return  # opened before the card was removed
        for fb_id in [i for i, (owner, _) in self.framebuffers.items() if owner is file]:
            self.remove_framebuffer(fb_id)
        self.files.remove(file)
        if self.master is file:
            self.master = None
        if not self.files:
            self.show_console()

    def next_id(self) -> int:
        """Return a new object number."""
        return next(self._ids)

    def show_console(self) -> None:
        """Show the console, as the kernel does without a master: black, in the preferred modes."""
        for connector, crtc in zip(self.connectors.values(), self.crtcs.values(), strict=True):
            self.complete(crtc)
            crtc.mode, crtc.framebuffer, crtc.offset = copy_mode(self.modes[connector.output][0]), None, (0, 0)
            connector.crtc, connector.dpms = crtc, abi.DPMS_ON

    def remove_framebuffer(self, fb_id: int) -> None:
        """Remove a framebuffer; a head that shows it goes dark."""
        _, framebuffer = self.framebuffers.pop(fb_id)
        for crtc in self.crtcs.values():
            if crtc.framebuffer is framebuffer:
                self.switch_off(crtc)
            # drm_framebuffer_remove: engines that would show it are switched off, and their event still comes.
            elif crtc.pending is not None and crtc.pending.framebuffer is framebuffer:
                self.complete(crtc)
                self.switch_off(crtc)

    def switch_off(self, crtc: Crtc) -> None:
        """Switch an engine off: no mode, no image, no vertical blank; a pending flip still gets its event."""
        self.complete(crtc)
        crtc.mode, crtc.framebuffer = None, None
        for connector in self.connectors.values():
            if connector.crtc is crtc:
                connector.crtc = None

    def look_at(self, crtc: Crtc) -> None:
        """Copy the framebuffer of an engine, on a card that scans out copies."""
        if self.copies and crtc.framebuffer is not None:
            crtc.copied = crtc.framebuffer.pixels().copy()

    def connect(self, connector: Connector, crtc: Crtc) -> None:
        """Let an engine drive a connector, awake; an engine without a connector is switched off."""
        before, connector.crtc, connector.dpms = connector.crtc, crtc, abi.DPMS_ON
        if before is not None and not any(c.crtc is before for c in self.connectors.values()):
            self.switch_off(before)

    # ------------------------------------------------------------------------------------------ what others see

    def crtc(self, output: Output) -> Crtc | None:
        """Return the engine that drives an output; ``None`` while the output is dark."""
        connector = next(c for c in self.connectors.values() if c.output is output)
        return connector.crtc if connector.crtc is not None and self.lit(connector.crtc) else None

    def lit(self, crtc: Crtc) -> bool:
        """Return True if an engine has a mode and a monitor that is awake, and so vertical blanks."""
        awake = any(c.crtc is crtc and c.dpms == abi.DPMS_ON for c in self.connectors.values())
        return crtc.mode is not None and awake

    def flip_pending(self, output: Output) -> bool:
        """Return True if the next vertical blank brings a new image."""
        return self.pending(output) is not None

    def pending(self, output: Output) -> Flip | None:
        """Return the flip that waits for the next vertical blank; ``None``: there is none."""
        crtc = self.crtc(output)
        return crtc.pending if crtc is not None else None

    def vblank(self, time_ns: int, hold: Output | None = None) -> None:
        """Do the vertical blank of both heads; the flip of the output ``hold`` stays pending once more."""
        self._blank_ns = time_ns
        for output in Output:
            crtc = self.crtc(output)
            if crtc is not None:
                crtc.sequence = (crtc.sequence + 1) & 0xFFFFFFFF
                if output is not hold:
                    self.complete(crtc)

    def complete(self, crtc: Crtc) -> None:
        """Do the pending flip, if any, and send its event."""
        flip = crtc.pending
        if flip is not None:
            crtc.framebuffer, crtc.pending = flip.framebuffer, None
            self.look_at(crtc)
            if flip.owner is not None:
                flip.owner.deliver(flip.user_data, self._blank_ns, crtc)

    def projected(self) -> NDArray[np.uint8]:
        """Return a copy (768, 1024) uint8 of green at the projector, after the connector's range and the scaler."""
        width, height = self.projector_px
        crtc = self.crtc(Output.PROJECTOR)
        if crtc is None:
            return np.zeros((height, width), np.uint8)
        return self._at_the_projector(crtc.colour(1))

    def projected_colours(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]:
        """Return copies of red, green and blue as ``projected`` does green; equal channels share an array."""
        width, height = self.projector_px
        crtc = self.crtc(Output.PROJECTOR)
        if crtc is None:
            black = np.zeros((height, width), np.uint8)
            return black, black, black
        red, green, blue = (crtc.colour(channel) for channel in range(3))
        if np.array_equal(red, green):
            red = green
        if np.array_equal(blue, green):
            blue = green
        elif np.array_equal(blue, red):
            blue = red
        shown = {id(codes): self._at_the_projector(codes) for codes in (red, green, blue)}
        return shown[id(red)], shown[id(green)], shown[id(blue)]

    def _at_the_projector(self, codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
        width, height = self.projector_px
        if codes.shape != (height, width):
            # The projector's scaler repeats or drops pixels, as cheap ones do.
            rows, columns = (np.arange(n) * m // n for n, m in zip((height, width), codes.shape, strict=True))
            codes = codes[rows[:, None], columns]
        # Anything but Full may leave with codes 16..235, as drivers choose for monitors of video: fringes lose contrast.
        full = self.connectors[95].broadcast_rgb == RGB_FULL
        return codes if full else LIMITED_RANGE[codes]

    def displayed(self) -> NDArray[np.uint8]:
        """Return an (h, w, 3) uint8 RGB copy of the diver's display; black in its own size if it is dark."""
        crtc = self.crtc(Output.DISPLAY)
        if crtc is None:
            native = MODES[Output.DISPLAY][0]
            return np.zeros((native.vdisplay, native.hdisplay, 3), np.uint8)
        return np.stack([crtc.colour(channel) for channel in range(3)], axis=-1)
