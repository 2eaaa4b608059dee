"""The drivers: one package for each device, each behind a protocol of ``drivers.api``."""
