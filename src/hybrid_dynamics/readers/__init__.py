"""File formats to :class:`~hybrid_dynamics.trajectory.Trajectory`: recordings of known robots and users' logs."""

from hybrid_dynamics.readers.description import LogDescription, PerJoint, describe, from_options, load_description
from hybrid_dynamics.readers.log import import_log, read_log, read_pieces, read_raw
from hybrid_dynamics.readers.resample import ResampleSettings, resample
from hybrid_dynamics.readers.table import write_log
from hybrid_dynamics.readers.ur10e import Ur10eSettings, read_ur10e
from hybrid_dynamics.readers.wam import read_wam, read_wam_reference
from hybrid_dynamics.types import Notify

__all__ = [
    "LogDescription",
    "Notify",
    "PerJoint",
    "ResampleSettings",
    "Ur10eSettings",
    "describe",
    "from_options",
    "import_log",
    "load_description",
    "read_log",
    "read_pieces",
    "read_raw",
    "read_ur10e",
    "read_wam",
    "read_wam_reference",
    "resample",
    "write_log",
]
