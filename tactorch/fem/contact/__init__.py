"""Contact of a soft body with a rigid probe."""

from tactorch.fem.contact.contact import Contact, ContactResponse
from tactorch.fem.contact.probes import PROBES, Ball, Cylinder, FlatPunch, Probe

__all__ = [
    "PROBES",
    "Ball",
    "Contact",
    "ContactResponse",
    "Cylinder",
    "FlatPunch",
    "Probe",
]
