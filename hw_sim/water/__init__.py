"""The water between instrument and object: attenuation, scattering, and particles, bubbles and fish in it."""
