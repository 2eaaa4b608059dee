"""The workshop: firmware for a new instrument's boards, and its guided bring-up, one module a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .finding import (
        Finding,  # Result of one check
    )
    from .flashing import (
        Part,  # Boards that have firmware of ours
        commands,  # Return the shell commands that copy folder onto a module with MicroPython; each may be repeated
        firmware_files,  # Return every file of one firmware by its path on the microcontroller
        instrument_values,  # Return the values of the firmware's instrument.py, by name. Raises BringupError
    )
    from .guide import (
        GuideOptions,  # Options of one call of the guide
        GuideResult,  # Result of one call of the guide
        projector_report,  # Measure the projector of rig on a white wall before the instrument
        walk,  # Walk the steps from where the last call ended, and stop at the first that is not good
    )
    from .kept import (
        StepRecord,  # One step that was done
    )
    from .rig_edit import (
        replace_rig,  # Replace a rig file and return where its old text is kept
    )
    from .step import (
        GivenUp,  # The operator gave up or is absent: the guide ends, and finished steps stay finished
    )
    from .steps import (
        STEPS,  # The steps of the guided bring-up in their order
    )
    from .trigger import (
        measure_trigger,  # Fire PULSES triggers on the bench of rig and judge them. Raises DeviceError
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
