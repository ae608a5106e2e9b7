"""What looks at a run while it goes on: streams for other programs, a page, and the recorder of its pictures."""

from torchhand.runs.live.watchers import opened_watchers, projector_of

__all__ = ["opened_watchers", "projector_of"]
