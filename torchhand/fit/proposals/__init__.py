"""Proposed hands registered on the silhouettes that they were proposed for."""

from torchhand.fit.proposals.registration import ProposalRegistration

__all__ = ["ProposalRegistration"]
