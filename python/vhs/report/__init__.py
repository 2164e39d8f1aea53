"""`vhs report`: one HTML page about a run, or about all runs of a directory."""

from vhs.report.command import report

__all__ = ["report"]
