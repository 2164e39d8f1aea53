"""What the paper reports: success after 500,000 updates of an episode each, in a room of its own making."""

SUCCESS = {
    "task1": {"vhs": 0.914, "pg": 0.906, "gdan": 0.872, "a3c": 0.231, "gcsl": 0.075},
    "task2": {"vhs": 0.920, "pg": 0.896, "gdan": 0.743, "a3c": 0.155, "gcsl": 0.087},
    "task3": {"vhs": 0.895, "pg": 0.318, "gdan": 0.133, "a3c": 0.042, "gcsl": 0.042},
}
"""Share of successful episodes by task and method (its table of final success rates)."""

REFERENCE_RATE = SUCCESS["task2"]["gdan"]
"""The rate by which its sample efficiency is counted: that of the strongest baseline from elsewhere."""
