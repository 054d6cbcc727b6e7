"""What is said about margins: which quantities have one, and how small ones are shown."""

from __future__ import annotations

from typing import Any

import pytest
from scenes import FLAT, plan_of, scene

from robustopt.certificate import Margin, Worst
from robustopt.certificate.certify import Certificate
from robustopt.config.margin import has_intervals, without_margin
from robustopt.limits.names import LimitKind, LimitName
from robustopt.report import certificate_rows
from robustopt.runs.plan_run import plan_task, summary
from robustopt.runs.records import CertificateRecord

ERROR = {"joint_acceleration": {"deviation": 0.1}}
WIDE = {"friction": [0.3, 0.4], "contact_points": 0.002, **ERROR}


@pytest.mark.parametrize(
    ("uncertainty", "missing"),
    [
        ({"friction": [0.3, 0.4]}, "uncertainty.contact_points, uncertainty.joint_acceleration"),
        ({**WIDE, "friction": {"a": [0.3, 0.4]}}, "uncertainty.friction.b"),
        ({**WIDE, "friction": [0.3, 0.3]}, "uncertainty.friction"),
        ({**WIDE, "contact_points": {"a": 0.0, "default": 0.001}}, "uncertainty.contact_points.a"),
        ({**WIDE, "joint_acceleration": {"deviation": 0.1, "K": 0.0}}, "uncertainty.joint_acceleration"),
    ],
)
def test_quantities_without_an_interval_are_named_with_their_keys(uncertainty: dict[str, Any], missing: str) -> None:
    contact = {"friction": 0.3}
    config = scene(
        contact=contact,
        objects={"a": FLAT | {"at": [-0.2, 0.0]}, "b": FLAT | {"at": [0.2, 0.0]}},
        uncertainty=uncertainty,
    )
    assert has_intervals(config)
    assert without_margin(config) == f"The plan has a margin, but none for {missing}."


@pytest.mark.parametrize("uncertainty", [{}, {"mass": {"block": [0.5, 0.5]}, "contact_points": 0.0}])
def test_a_plan_for_point_values_says_that_it_has_no_margin(uncertainty: dict[str, Any]) -> None:
    result = plan_task(scene(objects={"block": FLAT}, uncertainty=uncertainty))
    data = summary(result)
    assert data.message == "The plan is the optimum."
    assert data.without_margin == (
        "The plan has no margin: it holds for the nominal values alone. Keys that give one: uncertainty.friction, "
        "uncertainty.contact_points, uncertainty.joint_acceleration, uncertainty.center_of_mass, uncertainty.mass."
    )


def test_intervals_are_mentioned_where_there_are_some() -> None:
    config = scene(objects={"block": FLAT}, uncertainty=WIDE, contact={"friction": 0.3})
    assert without_margin(config) == ""
    plan = plan_of(config)
    assert plan.message == "The plan is the optimum for every value in the intervals."
    level = scene(objects={"block": FLAT}, gravity=[5.0, 0.0, -9.0], contact={"friction": 0.1})
    assert plan_of(level).message == "No timing of the path satisfies the limits."


def test_a_negative_margin_that_passes_is_within_tolerance() -> None:
    """A margin of -0.12 % was shown beside "passed"."""
    limit = LimitName(LimitKind.TORQUE, "joint1")
    worst = Worst(limit, -0.0012, 0.5, 1.0, False, {})
    margins = {limit: Margin(-3e-8, -0.0012)}
    certificate = Certificate(True, -0.0012, worst, margins, "quick", 0, 10, 100, 20, 5, 0.1)
    assert "joint1 torque: within the tolerance of 1 %, 0.12 % beyond the limit at t = 1.000 s" in certificate.sentence
    assert "0 % of the limit left" in str(Worst(limit, -3e-8, 0.5, 1.0, True, {}))
    shown = {row.name: row.value for row in certificate_rows(CertificateRecord.model_validate(certificate))}
    assert shown["margin at grid points"] == "0 % of the limit: joint1 torque"
    assert shown["worst margin"] == "within tolerance (0.12 % over): joint1 torque"
    failed = CertificateRecord.model_validate(certificate).model_copy(update={"passed": False})
    assert {row.name: row.value for row in certificate_rows(failed)}["worst margin"].startswith("-0.12 %")
