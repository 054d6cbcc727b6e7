"""The geometric path of the coordinates."""

from robustopt.path.build import build_path
from robustopt.path.footsteps import Place, Stance
from robustopt.path.path import Path

__all__ = ["Path", "Place", "Stance", "build_path"]
