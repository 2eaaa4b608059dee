"""The projector's response: how a scan shows it, and the file that keeps it."""
