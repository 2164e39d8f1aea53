"""Sweeps: a grid of configurations times seeds, trained and evaluated on the cores there are."""
