"""World time, its thread, and the date of the computer."""
