"""Types that every room uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

#: Numbers in SI units; the shape is told where the array is.
Array: TypeAlias = NDArray[np.float64]
#: ``progress(share, what)``: share of the work that is done, 0 to 1, and what is being done.
Progress: TypeAlias = Callable[[float, str], None]
#: ``notify(line)``: something the user should know, one line.
Notify: TypeAlias = Callable[[str], None]
