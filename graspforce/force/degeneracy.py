"""Reasons why an optimum has no derivatives, in words."""

from __future__ import annotations

NOT_UNIQUE = "the optimum is not unique, or its active limits depend on each other"
NO_SOLUTION = "the optimality conditions have no solution with these active limits"


def undecided_cone(contact: int) -> str:
    """Return the reason for a cone whose slack and multiplier are both zero to the accuracy of solutions.

    Args:
        contact: index of the contact.
    """
    return f"the friction cone of contact {contact} may be active or not"


def undecided_limit(side: str, kind: str, index: int) -> str:
    """Return the reason for a limit whose slack and multiplier are both zero to the accuracy of solutions.

    Args:
        side: "lower" or "upper".
        kind: "normal" or "torque".
        index: index of the contact or joint.
    """
    return f"the {side} {kind} limit {index} may be active or not"


def outcome_reason(outcome: int, index: int) -> str:
    """Return the reason for an outcome of the compiled adjoint; empty if it found the gradients.

    Args:
        outcome: a `gf_adjoint_status`.
        index: index of the undecided limit.
    """
    if outcome == 0:
        return ""
    if outcome == 1:
        return undecided_cone(index)
    if outcome <= 5:
        return undecided_limit(("upper", "lower")[outcome % 2 == 0], ("normal", "torque")[outcome >= 4], index)
    return NOT_UNIQUE if outcome == 6 else NO_SOLUTION
