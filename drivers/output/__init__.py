"""Pictures out: the projector and the diver's screen, by kernel mode setting or as a window on a desk."""
