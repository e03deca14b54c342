"""Rotations, poses, camera models and their uncertainty, in numpy alone."""

from .camera import CameraModel
from .pose import Pose

__all__ = ["CameraModel", "Pose"]
