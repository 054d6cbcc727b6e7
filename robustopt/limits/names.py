"""Names of limits: the kind of a limit, and the joint, contact or object that it applies to."""

from __future__ import annotations

from enum import StrEnum


class LimitKind(StrEnum):
    """The kinds of limits that the package knows; a user's limit may have a kind of its own.

    The last four occur only in certificates: they cover a contact system or a plan as a whole.
    """

    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    TORQUE = "torque"
    JERK = "jerk"
    CARTESIAN_SPEED = "Cartesian speed"
    CARTESIAN_ACCELERATION = "Cartesian acceleration"
    SLIP = "slip"
    TIPPING = "tipping"
    PEEL = "peel"
    GRIP = "grip"
    TWIST = "twist"
    BALANCE = "balance"
    POSITION = "position"
    CONTACT = "contact"
    TIMING = "timing"
    PLACE = "place"


_PHRASES: dict[str, tuple[str, str]] = {
    LimitKind.SLIP: ("slip of {0}", "slip of {0} on {1}"),
    LimitKind.TIPPING: ("tipping over {0}", "tipping of {0} over {1}"),
    LimitKind.PEEL: ("peel of {0}", "peel of {0} off {1}"),
    LimitKind.GRIP: ("grip of {0}", "grip of {0} by {1}"),
    LimitKind.TWIST: ("twist of {0}", "twist of {0} on {1}"),
    LimitKind.BALANCE: ("balance of {0}", "balance of {0} on {1}"),
    LimitKind.CONTACT: ("contact of {0}", "contact of {0} on {1}"),
    LimitKind.TIMING: ("{0}", "{0}"),
    LimitKind.PLACE: ("{0} in place", "{0} in place"),
}


class LimitName(str):
    """The name of a limit: text for people, with its kind and its subject for programs.

    Attributes:
        kind: a `LimitKind`, or the kind of a user's limit.
        subject: the joint, the object or the contact that the limit applies to.
        support: the support or tool that carries the object, if the subject is an object.
    """

    kind: str
    subject: str
    support: str

    def __new__(cls, kind: str, subject: str, support: str = "") -> LimitName:
        """Make a name such as `slip of block on tray` or `joint2 torque`."""
        alone, supported = _PHRASES.get(kind, ("{0} " + kind, "{0} " + kind))
        name = super().__new__(cls, (supported if support else alone).format(subject, support))
        name.kind, name.subject, name.support = kind, subject, support
        return name

    def __reduce__(self) -> tuple[type[LimitName], tuple[str, str, str]]:
        """Return how a pickled name is made again."""
        return LimitName, (self.kind, self.subject, self.support)
