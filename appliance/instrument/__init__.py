"""The running instrument: capture, ranging, the worker, the machine, its screens, and the service."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .capture.grabber import (
        Grabber,  # Runs one camera in its own thread. A context manager: leaving it stops the thread, not the camera
        SideRecording,  # One side of a sequence being recorded. Filled by the camera's thread, read after done
        Timeouts,  # Time limits of a sequence. At 60 Hz and faster the seconds count, at slower rates the periods
    )
    from .capture.ledger import (
        Ledger,  # Records of the four witnesses. Flips and pulses are in order of arrival; frames by side
        SyncError,  # The board's vsync does not follow the projector's; the text gives the difference
        SyncMap,  # Board vsync count is the blank of flip; board time converts to host time around it
        synchronise,  # Ask the board until two queries agree (at most ten). Raises SyncError
    )
    from .capture.scan import (
        CaptureReport,  # Result of a capture. With a fault there is no cloud; the frames are evidence only
        ScanRecorder,  # Records sequences with open devices and loaded patterns (index = frame, idle = dark)
        ScanSettings,  # Settings of a sequence's trigger
    )
    from .capture.store import (
        FrameStore,  # Slots for one or more sequences of both cameras, allocated once
    )
    from .machine.ashore import (
        ASHORE,  # What to do ashore about a fault, by its code
    )
    from .service.air_live import (
        LiveOptions,  # Options for recording boards
        open_devices,  # Return cameras, board and projector, once all are open. Raises DeviceError for a missing one
        record_views,  # Record views into target up to the requested number; return how many are new
    )
    from .service.app import (
        run,  # Run the instrument until it is switched off; return the process's exit code
    )
    from .service.checkup import (
        ask_devices,  # Open each device, or only those of these names; return the health or the error of each
        check,  # Open every device once, one after the other, through the shipped drivers, and collect their health
        connected_devices,  # List the devices on the buses and on every graphics card. Never raises for a device
    )
    from .service.devices import (
        Devices,  # All devices, each kept open by its supervisor. A context manager
        output_spec,  # Return the driver's specification of an output in the rig file
    )
    from .service.recording import (
        DrawnPatterns,  # The sequence in use and its pictures. For the thread that owns GL
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
