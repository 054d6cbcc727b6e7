"""Models of the configuration: tray, objects, and their contacts."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from robustopt.config.section import (
    Distance,
    Friction,
    Length,
    Mass,
    NonNegative,
    Point2,
    Point3,
    Pose,
    Positive,
    Real,
    Section,
    Size,
    Vector3,
    Vector6,
)

Force = Positive | tuple[Positive, Positive]


class HandsConfig(Section):
    """Hands that hold the tray between thumb and fingers."""

    pad: tuple[Length, Length] = Field(
        description="edge lengths of the pads of each hand along x and y of the tray; the thumb is above the tray, "
        "the fingers are below it [m]"
    )
    force: Force = Field(description="force with which each thumb presses the tray onto the fingers [N]")
    squeeze: NonNegative = Field(
        default=0.0,
        description="largest internal force between two hands, along the line between them, due to a mismatch of their "
        "positions; it uses up friction and joint torque [N]",
    )
    pressure: Literal["fixed", "free"] = Field(
        default="fixed", description="distribution of the normal force over the pads, see `objects.NAME.held_by.grip`"
    )


class TrayConfig(Section):
    """The tray, a box."""

    size: Size = Field(description="edge lengths of the tray, a box [m]")
    mass: Mass = Field(description="mass of the tray [kg]")
    pose: Pose = Field(default=Pose(), description="pose of the tray's centre in the tool frame")
    hands: HandsConfig | None = Field(
        default=None,
        description="hands that hold the tray, if robot.tool names several; otherwise the tray is fixed to the tool",
    )
    center_of_mass: Point3 = Field(
        default=(0.0, 0.0, 0.0), description="centre of mass in the tray frame, whose origin is the tray's centre [m]"
    )
    inertia: Vector3 | Vector6 | None = Field(
        default=None,
        description="inertia about the centre of mass, tray axes: ixx, iyy, izz, or ixx, iyy, izz, ixy, ixz, iyz; "
        "default: uniform density [kg m^2]",
    )


class HoldConfig(Section):
    """Place of a held part at the tool, and its pressure: the keys that suction and grip share."""

    pose: Pose = Field(
        default=Pose(),
        description="pose of the plane of the cups, or of the centre between the pads, in the tool frame; z points out "
        "of the tool, towards the part",
    )
    face: Literal["top", "bottom", "front", "back", "left", "right"] = Field(
        default="top",
        description="face of the part that points to the tool: upper or lower, or towards the part's x (front), -x "
        "(back), y (left) or -y (right)",
    )
    at: Point2 = Field(
        default=(0.0, 0.0),
        description="point of this face that lies on the z axis of `pose`, measured from the middle of the face along "
        "the part's axes: x and y for top and bottom, z and the other horizontal axis for the side faces [m]",
    )
    yaw: Real = Field(
        default=0.0,
        description="rotation of the part about the z axis of `pose`; at 0 the part's x axis points along x of `pose`, "
        "for the side faces its z axis [rad]",
    )
    pressure: Literal["fixed", "free"] = Field(
        default="fixed",
        description="distribution of the normal force over the contact points of a patch under a twisting load: that "
        "of elastic lips or uniform pads (fixed, conservative), or the most favourable one (free)",
    )


class CupConfig(Section):
    """One suction cup."""

    at: Point2 = Field(default=(0.0, 0.0), description="centre of the lip in the plane of the cups [m]")
    radius: Length = Field(description="radius of the lip [m]")


class SuctionConfig(HoldConfig):
    """Suction cups that hold a part."""

    cups: tuple[CupConfig, ...] = Field(default=(), description="the suction cups, at least one")
    force: Force = Field(description="vacuum force that presses the part against each lip, a number or an interval [N]")


class GripConfig(HoldConfig):
    """A gripper that holds a part between two opposed pads."""

    pad: tuple[Length, Length] = Field(
        description="edge lengths of each pad, across the axis of the tool and along it [m]"
    )
    axis: Literal["x", "y"] = Field(
        default="x", description="axis of `pose` along which the pads close; the driven finger is on its positive side"
    )
    force: Force = Field(description="closing force of the driven finger, a number or an interval [N]")
    depth: Distance | None = Field(
        default=None,
        description="distance from the centre of the pads to the face that points to the tool; default: half the "
        "extent of the part [m]",
    )
    finger_mass: NonNegative = Field(
        default=0.0,
        description="mass of the driven finger, which the closing force accelerates in addition to the part [kg]",
    )


class HeldByConfig(Section):
    """The cups or the gripper that hold an object."""

    suction: SuctionConfig | None = Field(default=None, description="suction cups that hold the part")
    grip: GripConfig | None = Field(default=None, description="a gripper that holds the part between two opposed pads")

    @property
    def tool(self) -> SuctionConfig | GripConfig:
        """Return the section that is given."""
        tool = self.suction or self.grip
        assert tool is not None, "checked when the configuration was read"
        return tool


class ObjectConfig(Section):
    """An object on a support, or held by the tool."""

    shape: Literal["box", "cylinder"] = Field(description="shape; a cylinder stands upright")
    size: Size | None = Field(default=None, description="edge lengths of a box [m]")
    radius: Length | None = Field(default=None, description="radius of a cylinder [m]")
    height: Length | None = Field(default=None, description="height of a cylinder [m]")
    mass: Mass = Field(description="mass [kg]")
    on: str | tuple[str, str] | None = Field(
        default=None,
        description="support of the object: `tray`, another object, or two of them (a bridge); default: `tray`, unless "
        "the object is held",
    )
    pressure: Literal["fixed", "free"] | None = Field(
        default=None,
        description="distribution of the normal force over the corners of the base under a twisting load: elastic "
        "(fixed, conservative), or the most favourable one (free); default: `fixed` if the path turns the object "
        "nearly in place, else `free`; with held_by it is a key of suction or grip",
    )
    held_by: HeldByConfig | None = Field(
        default=None, description="suction cups or a gripper on the tool that hold the object, in place of `on`"
    )
    at: Point2 = Field(
        default=(0.0, 0.0),
        description="centre of the object's base in the frame of its support; for a bridge in the tray frame [m]",
    )
    yaw: Real = Field(
        default=0.0, description="rotation about the vertical relative to its support; for a bridge to the tray [rad]"
    )
    center_of_mass: Point3 = Field(
        default=(0.0, 0.0, 0.0),
        description="centre of mass in the object's frame, whose origin is its geometric centre [m]",
    )
    inertia: Vector3 | Vector6 | None = Field(
        default=None,
        description="inertia about the centre of mass, object axes: ixx, iyy, izz, or ixx, iyy, izz, ixy, ixz, iyz; "
        "default: uniform density [kg m^2]",
    )

    @model_validator(mode="before")
    @classmethod
    def _stand_on_the_tray(cls, data: Any) -> Any:
        """Let an object without a support stand on the tray."""
        plain = isinstance(data, dict) and data.get("on") is None and data.get("held_by") is None
        return {**data, "on": "tray"} if plain else data


class ContactConfig(Section):
    """Friction, and the approximation of contacts."""

    friction: Friction | dict[str, Friction] = Field(
        default=0.5,
        description="nominal coefficient of friction, one value for all contacts, or by contact or object (`default` "
        "for the rest); if only uncertainty.friction is given, the nominal value is the middle of its interval",
    )
    cone_edges: Annotated[int, Field(ge=3, le=64)] | Literal["auto"] = Field(
        default="auto",
        description="number of edges of the inner approximation of each friction cone; `auto`: 72 for an object that "
        "stands on a single face of three or four corners, which costs at most 0.1 % of friction, and 16 for all other "
        "contacts",
    )
    patch_points: int = Field(default=8, ge=3, le=32, description="number of contact points of a round patch")


def contact_names(name: str, body: ObjectConfig) -> tuple[str, ...]:
    """Return the names of the contacts through which an object is supported or held.

    An object on its support, or held by one cup, has one contact, which takes its name. Several cups and the pads of a
    gripper are numbered: `part_cup1`, `part_pad2`. The driven finger has pad 1.

    Args:
        name: name of the object.
        body: the object.
    """
    held = body.held_by
    if held is not None and held.grip is not None:
        return pad_names(name)
    cups = held.suction.cups if held is not None and held.suction is not None else ()
    return (name,) if len(cups) < 2 else tuple(f"{name}_cup{k + 1}" for k in range(len(cups)))


def pad_names(name: str) -> tuple[str, str]:
    """Return the names of two opposed pads: the driven one (a finger or thumb), then the fixed one.

    Args:
        name: name of the held object or of the hand.
    """
    return f"{name}_pad1", f"{name}_pad2"
