"""How light travels from a water point to a pixel and back: lens, port, water. Pure functions, no I/O."""
