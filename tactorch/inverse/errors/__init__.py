"""Errors of the measurement, one file each, and the covariance of the data that follows."""

from tactorch.inverse.errors.base import ErrorSource, Levels, MeasuredPresses
from tactorch.inverse.errors.covariance import ErrorModel
from tactorch.inverse.errors.discrepancy import Discrepancy
from tactorch.inverse.errors.discretisation import DiscretisationRemainder
from tactorch.inverse.errors.forces import Forces
from tactorch.inverse.errors.heterogeneity import Heterogeneity
from tactorch.inverse.errors.pose import Pose
from tactorch.inverse.errors.rims import Rims
from tactorch.inverse.errors.shift import ContactShift
from tactorch.inverse.errors.smooth_forces import SmoothForces
from tactorch.inverse.errors.stated import Stated

#: The errors that maps and searches take into account.
ERRORS: tuple[ErrorSource, ...] = (
    DiscretisationRemainder(),
    Stated(),
    Forces(),
    SmoothForces(),
    Pose(),
    Rims(),
    ContactShift(),
    Discrepancy(),
    Heterogeneity(),
)

__all__ = ["ERRORS", "ErrorModel", "ErrorSource", "Levels", "MeasuredPresses"]
