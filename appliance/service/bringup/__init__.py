"""Owns the recording part of the guided bring-up: each step's devices, and what they are asked; judging is ``appliance.bringup``'s."""
