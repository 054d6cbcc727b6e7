"""Trajectories in the formats of controllers and planners: tables, messages, programs and arrays."""
