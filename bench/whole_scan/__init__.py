"""What a whole scan costs with all of its judges, from the last frame to what the diver and the disk have of it."""
