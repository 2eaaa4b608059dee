"""Windows into the simulated world, and a keyboard for its key pad: ``kingfisher sim --window``.

They are in a process of their own, so that drawing takes no time of the instrument's.
"""

from hw_sim.window.feed import WindowError, open_windows

__all__ = ["WindowError", "open_windows"]
