"""Check that environment contacts stay in their places: feet on the floor, a hand on its rail."""

from __future__ import annotations

import numpy as np

from robustopt.certificate.motion import Instants, stances
from robustopt.certificate.names import IN_PLACE
from robustopt.certificate.tally import Found, Tally
from robustopt.certificate.task import Task

DRIFT = 1e-4
"""Largest distance of a point of a standing foot from its place on the path [m]: a tenth of the accuracy of a robot."""


def check_places(task: Task, at: Instants, tally: Tally) -> None:
    """Check the distances of all contact points from their places on the path."""
    robot, path = task.robot, task.path
    for k, own in enumerate(path.stances):
        here = np.flatnonzero(stances(path, at) == k)
        found = robot.contact_points(path.evaluate(at.node_s, at.node_piece)[at.node[here]])
        away = [
            np.linalg.norm(found[name] - place.world(robot.contacts[name].points), axis=2).max(axis=1)
            for name, place in own.places.items()
        ]
        drift = np.max(away, axis=0)
        for t in tally.peaks(drift, here):
            tally.add(IN_PLACE, Found(float(drift[t]) / DRIFT, int(here[t]), IN_PLACE, {}))
        tally.tests += len(drift)
