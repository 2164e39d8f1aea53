"""Learners and what they learn from."""
