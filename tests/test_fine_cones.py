"""Fine friction cones, `contact.cone_edges: auto`: facets in closed form, and rows imposed only where they bind."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scenes import duration, plan_of, scene, waiter
from scipy.spatial import cKDTree

from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.limits import cones, systems
from robustopt.limits.facets import slip_facets
from robustopt.limits.polygons import evaluate, facet_family
from robustopt.solvers.plan import interval_ends

SHAPES = {
    "square": [[1, 1], [-1, 1], [-1, -1], [1, -1]],
    "rectangle": [[1, 0.6], [-1, 0.6], [-1, -0.6], [1, -0.6]],
    "strip": [[1, 0.05], [-1, 0.05], [-1, -0.05], [1, -0.05]],
    "uneven": [[1, 0.3], [-0.5, 0.8], [-0.7, -0.6], [0.8, -1]],
    "triangle": [[1, 0.3], [-0.5, 0.8], [-0.7, -0.6]],
}
BLOCK = {"shape": "box", "size": [0.16, 0.06, 0.05], "mass": 0.5}
INTERVALS = {
    "friction": [0.4, 0.6],
    "contact_points": 0.002,
    "center_of_mass": {"block": [0.003, 0.003, 0.002]},
    "mass": {"block": [0.4, 0.6]},
}


@pytest.mark.parametrize("edges", [8, 16, 20, 24])
@pytest.mark.parametrize("shape", SHAPES)
def test_facets_in_closed_form_are_those_of_the_hull(shape: str, edges: int) -> None:
    corners = np.array(SHAPES[shape], dtype=float)
    hull = cones._unit_cone(tuple(map(tuple, corners.tolist())), edges)
    assert hull is not None
    slip = hull.facets[~hull.tips]
    found = slip_facets(corners, edges)
    assert cKDTree(found).query(slip)[0].max() < 1e-9
    assert cKDTree(slip).query(found)[0].max() < 1e-9


@pytest.mark.parametrize("shape", SHAPES)
def test_fine_facets_lie_between_two_exact_cones(shape: str) -> None:
    """They hold for all friction edges, and for all forces of the exact cone of 0.1 % less friction."""
    corners = np.array(SHAPES[shape], dtype=float)
    rows = cones._fine_cone(tuple(map(tuple, corners.tolist()))).facets
    points = np.column_stack([corners, np.zeros(len(corners))])
    assert (rows @ cones.wrench_generators(points, 1.0, cones.FINE_EDGES)).max() < 1e-9
    less = np.cos(np.pi / cones.FINE_EDGES)
    assert 1.0 - less < 1e-3
    assert (rows @ cones.wrench_generators(points, less, 1009)).max() < 1e-9


def turntable(**sections: object) -> Config:
    return scene("turntable", length=2.0, contact={"friction": 0.5}, solver={"collocation_points": 60}, **sections)


TASKS = {
    "off the axis": lambda: turntable(objects={"block": {**BLOCK, "at": [0.2, 0.07]}}),
    "centre of mass off": lambda: turntable(
        objects={"block": {**BLOCK, "center_of_mass": [0.03, 0.01, 0.0], "pressure": "free"}}
    ),
    "intervals": lambda: turntable(objects={"block": {**BLOCK, "at": [0.15, 0.1]}}, uncertainty=INTERVALS),
    "sweep": lambda: waiter("one_block", "solver.collocation_points=60", "contact.cone_edges=auto"),
}


@pytest.fixture
def finer(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """A patcher of the number of fine edges, without cones of another number before and after."""
    cones._fine_cone.cache_clear()
    yield monkeypatch
    cones._fine_cone.cache_clear()


@pytest.mark.parametrize("task", TASKS)
def test_fine_cones_cost_at_most_a_two_thousandth_of_the_duration(task: str, finer: pytest.MonkeyPatch) -> None:
    config = TASKS[task]()
    plan = plan_of(config, "reachability")
    coarse = duration(with_values(config, {"contact.cone_edges": 16}), "reachability")
    certificate = certify(plan)
    assert certificate.passed, certificate
    assert plan_of(config, "ipopt").duration == pytest.approx(plan.duration, rel=1e-4)
    cones._fine_cone.cache_clear()
    for module in (cones, systems):
        finer.setattr(module, "FINE_EDGES", 256)
    limit = duration(config, "reachability")
    assert limit <= plan.duration < limit * 1.0005 < coarse


def test_a_plan_satisfies_the_rows_of_fine_cones_that_were_not_imposed() -> None:
    plan = plan_of(TASKS["intervals"](), "reachability")
    (limit,) = plan.problem.limits.contacts
    assert len(limit.facets) < 0.05 * len(limit.system.facets)
    u, x, points = interval_ends(plan)
    rows = limit.system.facets / limit.weight
    assert evaluate(facet_family(rows, limit.loads, limit.system.kinds), points, u, x).max() < 1e-7


def test_programs_with_64_edges_find_the_same_duration() -> None:
    """The programs know nothing of facets."""
    config = TASKS["off the axis"]()
    fine, other = duration(config), duration(with_values(config, {"contact.cone_edges": 64}))
    assert fine == pytest.approx(other, rel=2e-4)


def test_contacts_without_fine_cones_have_16_edges() -> None:
    mug = {"shape": "cylinder", "radius": 0.04, "height": 0.05, "mass": 0.5}
    config = turntable(objects={"mug": {**mug, "at": [0.2, 0.0]}})
    assert duration(config) == duration(with_values(config, {"contact.cone_edges": 16}))
