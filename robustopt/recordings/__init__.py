"""Recordings of joint positions: files of planners and loggers, read into the order of a robot's joints."""

from robustopt.recordings.read import Layout, Recording, read_recording

__all__ = ["Layout", "Recording", "read_recording"]
