"""The service: opens the devices, runs the heartbeat, executes what the machine asks for."""
