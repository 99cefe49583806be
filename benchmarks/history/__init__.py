"""Benchmarks for airspeed velocity: `asv run --python=same --set-commit-hash HEAD` records those of the checkout."""
