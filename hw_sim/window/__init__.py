"""Windows into the simulated world, and a keyboard for its key pad: what ``kingfisher sim --window`` opens.

The windows live in a process of their own, so that drawing them takes nothing from the instrument's.
"""

from hw_sim.window.feed import WindowError, open_windows

__all__ = ["WindowError", "open_windows"]
