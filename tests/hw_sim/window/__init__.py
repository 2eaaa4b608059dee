"""The windows of the simulated world and the keyboard before them."""
