"""All scans of an archive worked through anew: by what is the task, where results lie, and who does it."""
