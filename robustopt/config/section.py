"""Numbers with their bounds, and the base class of all sections of the configuration.

Lengths, masses and friction are bounded generously, so that no later computation overflows (our choice).
"""

from __future__ import annotations

from math import isnan
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from pydantic_core import PydanticCustomError

LARGEST, SMALLEST = 1e12, 1e-12
"""Largest size of a number without a bound of its own, and smallest of one that must be above 0 (our choice)."""


def _a_number(value: float) -> float:
    if isnan(value):
        raise ValueError("not a number")
    return value


def _moderate(value: float) -> float:
    if abs(value) > LARGEST:
        raise PydanticCustomError("size", f"a number of at most {LARGEST:g} in size")
    return value


def _not_tiny(value: float) -> float:
    if value < SMALLEST:
        raise PydanticCustomError("size", f"a number of at least {SMALLEST:g}")
    return value


def _of_128_bits(value: int) -> int:
    if value >= 2**128:
        raise PydanticCustomError("size", "a whole number below 2^128")
    return value


Real = Annotated[FiniteFloat, AfterValidator(_moderate)]
Positive = Annotated[FiniteFloat, Field(gt=0), AfterValidator(_moderate), AfterValidator(_not_tiny)]
Limit = Annotated[float, Field(gt=0, allow_inf_nan=True)]
"""A limit; infinity (`.inf` in YAML) means none. The bound excludes not-a-number."""
NonNegative = Annotated[FiniteFloat, Field(ge=0), AfterValidator(_moderate)]
Seed = Annotated[int, Field(ge=0), AfterValidator(_of_128_bits)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Length = Annotated[FiniteFloat, Field(ge=1e-6, le=100)]
Coordinate = Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
Acceleration = Annotated[FiniteFloat, Field(ge=-1e6, le=1e6)]
Distance = Annotated[FiniteFloat, Field(ge=0, le=100)]
Mass = Annotated[FiniteFloat, Field(ge=1e-6, le=1e6)]
Friction = Annotated[FiniteFloat, Field(ge=1e-6, le=100)]
Level = Annotated[FiniteFloat, Field(gt=0, lt=1)]
Point2 = tuple[Coordinate, Coordinate]
Point3 = tuple[Coordinate, Coordinate, Coordinate]
Size = tuple[Length, Length, Length]
Vector3 = tuple[Real, Real, Real]
Vector4 = tuple[Real, Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
Acceleration3 = tuple[Acceleration, Acceleration, Acceleration]
Interval = tuple[Real, Real]
End = Annotated[float, Field(allow_inf_nan=True), AfterValidator(_a_number)]
Range = tuple[End, End]
"""A range whose ends may be infinite."""


class Section(BaseModel):
    """Base class of a section. It is immutable, refuses unknown keys, and has all defaults if it is empty."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _empty_section(cls, data: Any) -> Any:
        return {} if data is None else data


class Pose(Section):
    """Position and orientation of a frame."""

    position: Point3 = Field(default=(0.0, 0.0, 0.0), description="position [m]")
    rpy: Vector3 = Field(default=(0.0, 0.0, 0.0), description="roll, pitch, yaw about the fixed x, y, z axes [rad]")


class AccelerationError(Section):
    """Interval of the error of the joint acceleration."""

    mean: Real | tuple[Real, ...] = Field(
        default=0.0,
        description="mean U of the executed minus the planned joint acceleration, one value or one per joint "
        "[rad/s^2 or m/s^2]",
    )
    deviation: NonNegative | tuple[NonNegative, ...] = Field(
        default=0.0, description="standard deviation D of this error, one value or one per joint [rad/s^2 or m/s^2]"
    )
    K: NonNegative = Field(default=1.0, description="the plan holds for every error between U - K D and U + K D")
