"""Everything that talks to a device, each behind a protocol of ``drivers.api``."""
