"""Rotations, poses, camera models and their uncertainty, in numpy alone."""

from trigpoint.geometry.camera import CameraModel
from trigpoint.geometry.pose import Pose

__all__ = ["CameraModel", "Pose"]
