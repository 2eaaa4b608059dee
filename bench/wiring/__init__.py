"""The plans of docs/build/wiring.md, drawn from the firmwares' pin data: ``./dev run python -m bench.wiring``."""
