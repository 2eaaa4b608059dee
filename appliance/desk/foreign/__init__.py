"""Frames that other rigs took: a description of what they show, decoding by it, and tests of whether it is true."""
