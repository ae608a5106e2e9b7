"""Keypoints of several cameras: which of them are one hand's, where they lie, which cameras are late or elsewhere."""

from torchhand.fit.keypoints.rig.lag import ViewLag
from torchhand.fit.keypoints.rig.refinement import RefinedCameras, refined_cameras
from torchhand.fit.keypoints.rig.triangulation import Triangulated, box_side_px, triangulated

__all__ = ["RefinedCameras", "Triangulated", "ViewLag", "box_side_px", "refined_cameras", "triangulated"]
