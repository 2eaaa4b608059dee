"""The running instrument: capture, laser pointers, the reconstruction's process, the machine, its screens, and the service that ties them."""
