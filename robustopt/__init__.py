"""Robust time-scaling of robot paths under frictional contact."""

__version__ = "0.1.0"
