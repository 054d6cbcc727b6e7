"""Certificates of several objects: each system is checked on its own, and small violations at single points count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import plan_of, scene, waiter

from robustopt.certificate import certify
from robustopt.certificate.balance import required
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import instants, motion, stances
from robustopt.certificate.part import part_of
from robustopt.certificate.task import task_of
from robustopt.certificate.world import build_world
from robustopt.solvers import Plan
from robustopt.solvers.plan import controls_of


def test_a_part_of_the_world_requires_what_the_whole_requires() -> None:
    plan = plan_of(waiter("side_by_side", "solver.collocation_points=20"), "reachability")
    task, at = task_of(plan), instants(plan, (0.5,))
    world = build_world(task.config, task.robot, task.path, stances(task.path, at))
    moving, _ = motion(task, at)
    values = world.sample(np.random.default_rng(0), len(at.s), corners=False)
    whole = body_loads(world, moving, values)
    assert len(world.systems) == 3
    for system in world.systems:
        part = part_of(world, system)
        own, mine = part.world(world, system), part.values(values)
        (same,) = own.systems
        assert len(own.bodies) < len(world.bodies)
        here = required(own, same, moving, part.loads(whole), mine)
        np.testing.assert_array_equal(required(world, system, moving, whole, values), here)
        np.testing.assert_array_equal(required(own, same, moving, body_loads(own, moving, mine), mine), here)
        theirs = system.contact_points(values.friction, values.shift)
        assert own.contacts[same.contacts[0]].name == world.contacts[system.contacts[0]].name
        np.testing.assert_array_equal(same.contact_points(mine.friction, mine.shift).point, theirs.point)
        np.testing.assert_array_equal(same.contact_points(mine.friction, mine.shift).mu, theirs.mu)


def raised(plan: Plan, k: int, share: float) -> Plan:
    """The plan with x 1 % higher at point k, or at a new point at a share of the interval after it."""
    s, piece, x = plan.s, plan.piece, plan.x.copy()
    if share > 0.0:
        new = [values[k] + share * (values[k + 1] - values[k]) for values in (s, x)]
        s, x, piece = np.insert(s, k + 1, new[0]), np.insert(x, k + 1, new[1]), np.insert(piece, k + 1, piece[k])
        k += 1
    x[k] *= 1.01
    return replace(plan, s=s, piece=piece, x=x, u=controls_of(np.diff(s), x))


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_one_percent_more_speed_at_one_point_fails(share: float) -> None:
    """Ten objects of different friction: wherever the contact limit of one of them binds."""
    objects = {
        f"box{k}": {
            "shape": "box",
            "size": [0.05, 0.05, 0.02],
            "mass": 0.1,
            "at": [0.1 * (k % 5) - 0.2, 0.1 * (k // 5)],
        }
        for k in range(10)
    }
    friction = {name: 0.3 + 0.02 * k for k, name in enumerate(objects)}
    plan = plan_of(
        scene(
            objects=objects,
            contact={"friction": friction},
            uncertainty={"friction": {"box3": [0.25, 0.5]}},
            solver={"collocation_points": 200},
        )
    )
    assert certify(plan).passed
    for k in np.random.default_rng(7).choice(np.flatnonzero([any("box3" in n for n in own) for own in plan.active]), 2):
        assert not certify(raised(plan, int(k), share)).passed
