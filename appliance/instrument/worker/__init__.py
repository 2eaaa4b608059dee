"""The worker: the process beside the service that makes clouds and verdicts of scans."""
