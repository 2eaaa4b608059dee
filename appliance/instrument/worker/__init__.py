"""Everything that happens in the process beside the service: scans in, clouds and verdicts out."""
