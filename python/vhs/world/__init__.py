"""The processes that train one run together: this one alone, or the ranks of torch.distributed."""

from vhs.world.ranks import is_rank, joined
from vhs.world.world import ALONE, Alone, World

__all__ = ["ALONE", "Alone", "World", "is_rank", "joined"]
