"""Owns what is done with a new instrument at the bench, before it runs: its boards' firmware, and the guided bring-up,
one file a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .bench import (
        light_bench,  # Inside: the bench on the rig's devices
    )
    from .finding import (
        BringupError,  # A measurement of the bring-up could not be made; the text says which, and what to do
        Finding,  # Outcome of one check
    )
    from .flashing import (
        Part,  # Boards that have firmware of ours
        commands,  # Return what is typed to bring folder onto a module with MicroPython; each may be repeated
        instrument_values,  # Return what stands in the firmware's instrument.py, by name. Raises BringupError
        laid_out,  # Return every file of one firmware by its path on the microcontroller
    )
    from .guide import (
        GuideOptions,  # Wishes for one call of the guide
        Walked,  # Outcome of one call
        judge_together,  # Return the outcome of each step that is done by do, which found it
        keys_of,  # Return the keys that follow from one measurement: all or nothing
        walk,  # Walk the steps from where the last call ended, and stop at the first that is not good
    )
    from .kept import (
        GuideFolder,  # Reads and writes the folder. Every file is replaced whole
        StepRecord,  # One step that was done
    )
    from .page import (
        outcomes_page,  # Return a page about steps that were done outside of the guide as HTML
    )
    from .projector import (
        PROJECTOR_PAGE,  # Name of the projector's page
        measure_on_wall,  # Ask for a white wall, and measure the projector on it. Raises DeviceError, BringupError
        measure_projector,  # Measure everything; gain_db is that of the short exposures. Raises BringupError
        outcomes_in_order,  # Return the outcomes of the projector's steps and all their findings
    )
    from .rig_edit import (
        replace_rig,  # Replace a rig file and return where its old text is kept
        with_keys,  # Return the text of a rig file with values, everything else as it was
    )
    from .step import (
        GivenUp,  # The person gave up, or nobody is there: the guide ends, and what was done stays done
    )
    from .steps import (
        STEPS,  # The steps of the guided bring-up in their order
    )
    from .trigger import (
        fired,  # Fire PULSES triggers with delay, exposure (unless another one is given) and gain of the rig file
        trigger_findings,  # Judge what was recorded of PULSES triggers: counts first, then times
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
