"""Light besides the projector's: daylight, waves, torches, and the two laser pointers."""
