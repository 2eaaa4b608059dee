"""Devices as the host sees them: bytes in, bytes out, no I/O; their time is the world's."""
