"""The geometric path of the joints."""

from robustopt.path.path import Path, build_path

__all__ = ["Path", "build_path"]
