"""The wires of the simulated rig: thin ends below the real driver libraries, all of one world."""

from hw_sim.wires.in_process import ScriptFailedError, SimWires, open  # the name that rig files use

__all__ = ["ScriptFailedError", "SimWires", "open"]
