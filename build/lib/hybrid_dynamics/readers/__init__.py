"""File formats to :class:`~hybrid_dynamics.trajectory.Trajectory`: recordings of known robots and users' logs."""

from hybrid_dynamics.readers.log import import_log, read_log, read_pieces, read_raw
from hybrid_dynamics.readers.resample import Notify, ResampleSettings, resample
from hybrid_dynamics.readers.table import write_log
from hybrid_dynamics.readers.ur10e import Ur10eSettings, read_ur10e
from hybrid_dynamics.readers.wam import read_wam, read_wam_reference

__all__ = [
    "Notify",
    "ResampleSettings",
    "Ur10eSettings",
    "import_log",
    "read_log",
    "read_pieces",
    "read_raw",
    "read_ur10e",
    "read_wam",
    "read_wam_reference",
    "resample",
    "write_log",
]
