"""The wires of the simulated rig as device nodes: usbfs, hidraw, a terminal and DRM, for programs of other processes."""
