"""The wires of the simulated rig: thin ends under the real driver libraries, all leading to one world."""

from hw_sim.wires.in_process import ScriptFailedError, SimWires, open  # the name that rig files use

__all__ = ["ScriptFailedError", "SimWires", "open"]
