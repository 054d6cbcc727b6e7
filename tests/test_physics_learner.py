"""The learner by physics: the forecast against closed forms, the blame of failures, and its executions in MuJoCo."""

from pathlib import Path

import numpy as np
import pytest
from scenes import FLAT, scene

from robustopt.config.load import load_config
from robustopt.errors import ConfigError
from robustopt.evidence import DIVERGED, Failure
from robustopt.learning.foresight import STEPS, Mechanism, NeedMap, blame
from robustopt.learning.parameters import Parameter
from robustopt.learning.physics import Physics
from robustopt.learning.survival import base_needed, friction_needed
from robustopt.learning.world import Run, posterior, prior
from robustopt.runs.campaign import learn, learning_of, verdict_note
from robustopt.runs.foresight import PlannedForesight
from robustopt.simulation import Status

CONFIGS = Path(__file__).parents[1] / "configs"
G = 9.81

# Sliding and tipping --------------------------------------------------------------------------------------


def test_friction_against_a_constant_acceleration():
    """It slides by (a - mu g) t^2 / 2, so that it needs (a - 2 d / t^2) / g to have slid by d at most at t."""
    steps, duration = 4000, 0.8
    t = duration / steps * np.arange(1, steps + 1)
    acceleration = np.array([3.0, 6.0])
    tangential = np.zeros((2, steps, 2))
    tangential[..., 0] = acceleration[:, None] * 0.6
    tangential[..., 1] = acceleration[:, None] * 0.8
    found = np.exp(friction_needed(tangential, np.full((2, steps), G), np.full(2, duration / steps), 0.005))
    wanted = (acceleration[:, None] - 2 * 0.005 / t**2) / G
    late = t > 0.2
    np.testing.assert_allclose(found[:, late], wanted[:, late], rtol=5e-3)
    assert np.all(found[:, t < 0.03] < 0.02)


def test_an_object_that_stops_sliding_has_slid_no_further():
    """A pulse of 4 m/s^2 for 0.1 s: it slides d = a t^2 (a / (mu g) - 1) / 2 while it gets to the speed of the tray."""
    step, pulse = 1e-4, 4.0
    tangential, normal = np.zeros((1, 6000, 2)), np.full((1, 6000), G)
    tangential[:, :1000, 0] = pulse
    found = np.exp(friction_needed(tangential, normal, np.array([step]), 0.005))[0, -1]
    a, t = pulse - found * G, 0.1
    assert a * t**2 / 2 + (a * t) ** 2 / (2 * found * G) == pytest.approx(0.005, rel=0.02)


def test_base_against_a_constant_acceleration():
    """theta'' = (m a h - rho b m g) / I + m g h theta / I, which a cosh solves."""
    mass, height, half, inertia, threshold = 0.5, 0.06, 0.04, 0.0025, 0.08
    steps, duration = 4000, 0.8
    t = duration / steps * np.arange(1, steps + 1)
    moments = np.full((1, steps, 2), mass * 5.0 * height) * np.array([1.0, -1.0])
    found = np.exp(
        base_needed(
            moments, np.full((1, steps), mass * G), np.full(2, half), height, np.full(2, inertia),
            np.array([duration / steps]), threshold,
        )
    )[0]  # fmt: skip
    k = np.sqrt(mass * G * height / inertia)
    excess = threshold * k**2 / (np.cosh(k * t) - 1)
    wanted = (mass * 5.0 * height - excess * inertia) / (half * mass * G)
    some = wanted > 0.1
    np.testing.assert_allclose(found[some], wanted[some], atol=0.003)


# The forecast of plans ------------------------------------------------------------------------------------


def test_plans_need_at_most_what_they_were_planned_for():
    config = load_config(CONFIGS / "waiter_two_blocks.yaml", ["solver.collocation_points=60"])
    forecast = PlannedForesight(config, ["contact.friction", "uncertainty.contact_points"])
    frictions, insets = [0.2, 0.4, 0.2], [0.001, 0.001, 0.01]
    needed = np.exp(forecast.needed(np.column_stack([frictions, insets])))
    assert needed.shape == (3, STEPS + 1, 4)
    assert np.all(np.diff(needed, axis=1) >= -1e-12)
    strengths = np.exp(forecast.strengths(np.column_stack([frictions, insets])))
    np.testing.assert_allclose(strengths, [[mu, 1 - d / 0.04] * 2 for mu, d in zip(frictions, insets, strict=True)])
    assert np.all(needed[:, -1] <= 1.02 * strengths)
    assert needed[0, -1, 0] > 0.19  # friction binds
    assert needed[1, -1, 1] > 0.9  # tipping binds


def test_a_belief_without_a_plan_has_no_need():
    config = scene(objects={"block": FLAT}, contact={"friction": 0.5}, solver={"collocation_points": 20})
    forecast = PlannedForesight(config, ["contact.friction.block", "uncertainty.contact_points"])
    needed = forecast.needed(np.array([[0.5, 0.0], [0.5, 0.0999999]]))
    assert np.isfinite(needed[0]).all()


@pytest.mark.parametrize(
    ("task", "key", "message"),
    [
        ("waiter_bridge", "contact.friction", "found physics with plank, which does not stand on one support alone"),
        ("pick_suction", "contact.friction", "does not stand on one support alone"),
        ("waiter_two_blocks", "objects.upper.mass", "`physics` knows contact.friction and uncertainty.contact_points"),
    ],
)
def test_tasks_and_parameters_that_it_does_not_know(task, key, message):
    with pytest.raises(ConfigError, match=message):
        PlannedForesight(load_config(CONFIGS / f"{task}.yaml"), [key])


# Evidence -------------------------------------------------------------------------------------------------

MECHANISMS = tuple(Mechanism(what, (kind,)) for what in ("lower", "upper") for kind in ("slid", "tipped"))


@pytest.mark.parametrize(
    ("failure", "blamed"),
    [
        (Failure("slid", "lower"), [1, 0, 0, 0]),
        (Failure("tipped", "upper"), [0, 0, 0, 1]),
        (Failure("fell", "upper"), [0, 0, 0.5, 0.5]),
        (Failure("slid"), [0.5, 0, 0.5, 0]),
        (Failure("torque saturated", "joint1"), [0] * 4),
        (Failure("slid", "left foot"), [0] * 4),
        (Failure(), [0.25] * 4),
    ],
)
def test_whom_a_failure_blames(failure, blamed):
    np.testing.assert_allclose(blame(failure, MECHANISMS), blamed)


class Ramp:
    """Two objects: the plan for (a, b) needs the frictions a and b, which it reaches at the end."""

    mechanisms = (Mechanism("a", ("slid",)), Mechanism("b", ("slid",)))

    def strengths(self, values):
        return np.log(values)

    def needed(self, values):
        return np.log(np.maximum(values[:, None] * np.linspace(0.0, 1.0, STEPS + 1)[:, None], 1e-3))


PAIR = (Parameter("a", 1.0, 0.1), Parameter("b", 1.0, 0.1))


def learned(*tested: Run) -> tuple[np.ndarray, np.ndarray]:
    """10 %, 50 % and 90 % quantiles of a and of b after executions of plans of 1 s."""
    start = prior(PAIR, NeedMap(PAIR, Ramp()), noisy=False)
    points = posterior(start, tested, {}).points
    a, b = np.quantile(0.1**points, (0.1, 0.5, 0.9), axis=0).T
    return a, b


def test_the_time_of_a_failure_tells_the_friction_of_the_object_that_failed():
    a, b = learned(Run((0.0, 0.0), 1.0, Failure("slid", "a", t=0.35)))
    assert a == pytest.approx([0.35] * 3, rel=0.25)
    assert a[1] == pytest.approx(0.35, rel=0.1)
    assert b[0] > 0.3  # it had survived until then
    assert b[2] > 0.8  # and may be the best


def test_without_a_name_both_are_suspected():
    a, b = learned(Run((0.0, 0.0), 1.0, Failure()))
    assert min(a[0], b[0]) < 0.2
    assert max(a[2], b[2]) > 0.7


def test_successes_bound_from_below():
    point = (0.5, 0.5)
    a, b = learned(Run(point, 1.0, None))
    assert min(a[0], b[0]) > 0.1**0.5 * 0.85


# Executions in MuJoCo -------------------------------------------------------------------------------------


@pytest.mark.parametrize("truth", [0.15, 0.33])
def test_few_executions_find_the_friction(truth):
    """The best plan for the truth is known: the block of this robot does nothing but slide."""
    parameters = [{"key": "contact.friction", "optimistic": 1.0, "conservative": 0.05}]
    config = scene(
        objects={"block": FLAT}, contact={"friction": 1.0}, solver={"collocation_points": 30},
        execution={"truth": {"friction": truth}},
        learning={"algorithm": "physics", "parameters": parameters, "trials": 0},
    )  # fmt: skip
    found = learn(config)
    assert found.best is not None
    assert found.state.executed <= 8
    ((_, friction),) = found.best.trial.belief.parameters
    assert friction == pytest.approx(truth, rel=0.06)


def test_executions_that_vary_call_for_more_than_one_success():
    parameters = [{"key": "contact.friction", "optimistic": 1.0, "conservative": 0.05}]
    quiet = {"truth": {"friction": 0.3}}
    pushed = {**quiet, "disturbance": {"force_deviation": [1.0, 1.0, 0.0]}}
    for execution, given, times, noted in (
        (quiet, {}, 1, False),
        (pushed, {}, 7, True),
        (pushed, {"K": 0.5}, 4, True),
        (pushed, {"executions_per_plan": 1}, 1, False),
        (pushed, {"parameters": []}, 7, False),
    ):
        config = scene(
            objects={"block": FLAT}, execution=execution,
            learning={"algorithm": "bnb-informed", "parameters": parameters, **given},
        )  # fmt: skip
        assert learning_of(config).executions_per_plan == times
        note = verdict_note(config)
        assert bool(note) is noted
        assert not noted or f"or {times} times in a row" in note


def test_without_parameters_it_learns_friction_and_contact_points():
    config = scene(objects={"block": FLAT}, learning={"algorithm": "physics", "friction": [0.1, 0.8]})
    friction, inset = learning_of(config).parameters
    assert (friction.key, friction.optimistic, friction.conservative) == ("contact.friction", 0.8, 0.1)
    assert (inset.key, inset.optimistic, inset.conservative) == ("uncertainty.contact_points", 0.0, 0.025)
    assert learning_of(scene(objects={"block": FLAT}, learning={"algorithm": "ilrobs"})).parameters == ()


def test_hardware_varies_whatever_its_simulation_does():
    parameters = [{"key": "contact.friction", "optimistic": 1.0, "conservative": 0.05}]
    config = scene(objects={"block": FLAT}, learning={"algorithm": "physics", "parameters": parameters})
    assert learning_of(config).executions_per_plan == 1
    assert learning_of(config, hardware=True).executions_per_plan == 7
    assert verdict_note(config, hardware=True)


def test_a_default_stands_for_the_contacts_without_a_value_of_their_own():
    config = load_config(
        CONFIGS / "waiter_two_blocks.yaml",
        ["contact.friction={upper: 0.3, default: 0.5}", "solver.collocation_points=20"],
    )
    found = PlannedForesight(config, ["contact.friction.default"]).strengths(np.array([[0.2], [0.9]]))
    np.testing.assert_allclose(np.exp(found[:, [0, 2]]), [[0.2, 0.3], [0.9, 0.3]])


def test_a_failure_of_a_joint_tells_that_the_objects_had_survived():
    a, b = learned(Run((0.0, 0.0), 1.0, Failure("torque saturated", "x", t=0.5)))
    assert min(a[0], b[0]) > 0.4
    assert max(a[2], b[2]) > 0.85


def test_the_budget_must_suffice_to_confirm_a_plan():
    with pytest.raises(ConfigError, match=r"found 5; expected at least learning\.executions_per_plan, 7"):
        Physics(parameters=PAIR, cost=lambda values: values[:, 0], foresight=Ramp(), budget=5, executions_per_plan=7)


def test_a_failure_of_the_simulation_has_one_name():
    assert Status.DIVERGED.value == DIVERGED
