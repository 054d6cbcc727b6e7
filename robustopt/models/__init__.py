"""Robots that come with the package, as MJCF files."""

from pathlib import Path

MODELS = Path(__file__).parent
