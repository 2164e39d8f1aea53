"""Runs on the disk: their directories, checkpoints, logs and evaluations, and how they are read back."""
