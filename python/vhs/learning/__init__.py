"""Learning: what an update does with finished episodes, and the methods made of it."""
