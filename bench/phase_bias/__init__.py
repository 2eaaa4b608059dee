"""What bends the phase of image-level scans without being noise, and what that does to points and artefacts."""
