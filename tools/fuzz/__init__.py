"""Mutated inputs and arguments for every command: nothing may break it. `python -m tools.fuzz` says how."""
