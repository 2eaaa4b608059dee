"""A scan as it is recorded: arm, play, collect, and the witnesses that say whether it happened as planned."""
