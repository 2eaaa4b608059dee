"""The wires of the simulated rig as device nodes for other processes: usbfs, hidraw, a terminal and DRM."""
