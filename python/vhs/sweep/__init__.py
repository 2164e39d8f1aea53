"""Sweeps: grids of configurations times seeds, or a search, trained and evaluated on the cores there are."""
