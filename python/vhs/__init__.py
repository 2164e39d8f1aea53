"""Hindsight goals for reinforcement learning from images."""
