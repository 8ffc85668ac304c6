"""The errors that tactorch raises on purpose.

Every message names the file, field or value at fault and says what to do. The command line
prints the message alone; anything that is not a `TactorchError` is a defect and shows a traceback.
"""

from typing import Any


class TactorchError(Exception):
    """Base of all errors raised on purpose."""


class FileError(TactorchError):
    """A file or folder is missing, unreadable or not of the expected format."""


class MeshError(TactorchError):
    """A mesh cannot be used: inverted, degenerate, disconnected, non-finite..."""


class RecordingError(TactorchError):
    """A recording of presses is inconsistent or physically implausible."""


class ConfigError(TactorchError):
    """A setting has a value that cannot be used."""


class ConvergenceError(TactorchError):
    """Equilibrium was not found: the load collapses the object, or nothing holds it."""


class CancelledError(TactorchError):
    """A computation was ended by its caller before it had a result.

    Attributes:
        reached: State from which the computation can be continued; None if there is none.
    """

    def __init__(self, *args: object, reached: Any = None) -> None:
        super().__init__(*args)
        self.reached = reached


#: Errors of what cannot be computed; on large problems also of NumPy, torch, ARPACK.
UNCOMPUTABLE = (TactorchError, MemoryError, RuntimeError)


class RobotError(TactorchError):
    """A robot did not carry out a press. Drivers may raise it, or a more specific one."""


class PoseRefusedError(RobotError):
    """A robot cannot reach a pose, or its controller refuses it."""


class ForceLimitError(RobotError):
    """A press would exceed the largest allowed force, and was not carried out."""


class RobotTimeoutError(RobotError):
    """A robot did not end a press in the given time."""
