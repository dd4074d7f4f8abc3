"""Contacts: models, friction cones, grasp matrix, force closure, quality, and rolling kinematics.

- `contact`: the records `Contact` and `ContactSet`
- `friction`: the friction cone
- `matrices`: grasp matrix G, contact Jacobian J, rank and internal forces
- `closure`: force closure
- `inscribed_ball`: the largest ball in a set of wrenches
- `quality`: quality measures
- `motion`: motions of the object and of the fingertips
- `kinematics`: the law of rolling contact; `compiled_kinematics` calls its C form
"""

from graspforce.contact import friction
from graspforce.contact.closure import is_force_closed
from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.contact.matrices import characteristic_length, grasp_matrix, grasp_matrix_rank, internal_forces
from graspforce.contact.motion import BodyMotion, TipMotion
from graspforce.contact.quality import ferrari_canny, inscribed_ball_radius, smallest_singular_value, wrench_ball

__all__ = [
    "BodyMotion",
    "Contact",
    "ContactModel",
    "ContactSet",
    "TipMotion",
    "characteristic_length",
    "ferrari_canny",
    "friction",
    "grasp_matrix",
    "grasp_matrix_rank",
    "inscribed_ball_radius",
    "internal_forces",
    "is_force_closed",
    "smallest_singular_value",
    "wrench_ball",
]
