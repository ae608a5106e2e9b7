"""What a live run shows of itself on a page, and what it keeps of its pictures when it is asked to record."""

from torchhand.runs.live.show import opened_show

__all__ = ["opened_show"]
