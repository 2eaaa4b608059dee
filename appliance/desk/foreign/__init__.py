"""Import of foreign frames: the image set description, decoding by it, and tests of it on the images."""
