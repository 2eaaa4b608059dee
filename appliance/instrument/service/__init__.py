"""The service: opens the devices, runs the cycle, and executes the machine's effects."""
