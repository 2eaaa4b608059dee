"""The verdict on identity: whether each recorded frame is the pattern that it should be."""
