"""Which atoms are near each other: binning, search, lists with a skin."""

from minimd.core.neighbors.queries import neighbor_list

__all__ = ["neighbor_list"]
