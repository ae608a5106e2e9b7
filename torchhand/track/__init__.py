"""Trackers: how a hand is found in a picture, followed through a video, lost and found again."""
