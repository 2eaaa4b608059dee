"""The simulated devices over USB/IP: a real kernel attaches them and binds its own drivers to them."""
