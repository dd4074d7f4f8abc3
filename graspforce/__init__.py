"""Fingertip forces inside their friction cones with least motor torque, certified."""

from graspforce.actuation import Actuation
from graspforce.contact import Contact, ContactModel, ContactSet
from graspforce.errors import GraspForceError, InvalidInput

__version__ = "0.1.0"

__all__ = ["Actuation", "Contact", "ContactModel", "ContactSet", "GraspForceError", "InvalidInput"]
