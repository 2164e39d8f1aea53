"""Agents for others: pushed to the Hugging Face Hub with a card; `vhs.runs.remote` fetches them."""

from vhs.hub.push import push

__all__ = ["push"]
