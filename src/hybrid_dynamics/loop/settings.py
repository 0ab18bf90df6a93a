"""Settings of the loop: what may be named, how much it must matter, how sure it must be."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from hybrid_dynamics.effects import catalogue, family
from hybrid_dynamics.effects.sign import SLOW
from hybrid_dynamics.errors import require
from hybrid_dynamics.loop.process import ProcessSettings


@dataclass(frozen=True)
class LoopSettings:
    """``effects``: families that may be named (all registered ones where empty). ``sign_widths`` [rad/s] and
    ``sign_displacements`` [rad] over which the sign of friction may turn over.

    An effect is looked at when it gains ``gain_in_errors`` standard errors on held-out blocks of ``block`` [s] or more
    and lowers the mean square residual of a joint by ``floor_share`` squared noise floors and by ``torque_share`` of
    the variance of the measured torque. It is dropped again below ``keep_share`` squared floors, and named when its
    gain in the final model is no accident at ``significance`` over all candidates looked at. Single training runs are
    validated on ``time_folds`` parts. The test runs contradict a name beyond ``confirmation``. What is left of a joint
    depends on the motion where a black box finds more than ``alarm_share`` of it, at ``alarm_level`` over all joints.
    An alternative is named where held-out mean squares grow by less than ``alike_share``. No floor lies below
    ``resolution`` of the measured torque. Without test runs the last ``held_out_share`` of every run is held out after
    a gap of ``held_out_gap`` [s]. ``evaluations`` of symbolic regression describe what stays unexplained on a joint.
    Of training runs, and of test runs, that last more than ``longest`` [s] together, stretches are looked at.

    >>> from hybrid_dynamics import LoopSettings
    >>> LoopSettings(effects=("viscous_friction", "coulomb_friction"), block=1.0).families
    ('viscous_friction', 'coulomb_friction')
    """

    effects: tuple[str, ...] = ()
    sign_widths: tuple[float, ...] = (0.0, 0.01, 0.03, SLOW)
    sign_displacements: tuple[float, ...] = (1e-4, 3e-4, 1e-3)
    block: float = 0.5
    time_folds: int = 6
    gain_in_errors: float = 2.0
    floor_share: float = 0.15
    keep_share: float = 0.1
    torque_share: float = 1e-5
    significance: float = 0.02
    confirmation: float = 0.05
    alarm_level: float = 0.01
    alarm_share: float = 0.05
    alike_share: float = 0.03
    resolution: float = 1e-4
    max_effects: int = 60
    held_out_share: float = 0.35
    held_out_gap: float = 1.0
    evaluations: int = 20_000
    longest: float = 600.0
    process: ProcessSettings = field(default_factory=ProcessSettings)

    def __post_init__(self) -> None:
        for name in self.effects:
            family(name)
        require(len(set(self.effects)) == len(self.effects), f"effects is {list(self.effects)}; name each only once")
        require(len(self.sign_widths) > 0, "sign_widths is empty; expected at least one width, 0 for a sharp sign")
        require(min(self.sign_widths) >= 0, f"sign_widths is {self.sign_widths}; expected widths >= 0 rad/s")
        require(
            all(s > 0 for s in self.sign_displacements),
            f"sign_displacements is {self.sign_displacements}; expected displacements > 0 rad",
        )
        for name, low, high in (
            ("block", 0.05, 60.0),
            ("time_folds", 2, 20),
            ("gain_in_errors", 0.0, 20.0),
            ("floor_share", 0.0, 100.0),
            ("keep_share", 0.0, 100.0),
            ("torque_share", 0.0, 1.0),
            ("significance", 1e-9, 0.5),
            ("confirmation", 1e-9, 0.5),
            ("alarm_level", 1e-9, 0.5),
            ("alarm_share", 0.0, 1.0),
            ("alike_share", 0.0, 1.0),
            ("resolution", 1e-9, 1.0),
            ("max_effects", 1, 1000),
            ("held_out_share", 0.05, 0.9),
            ("held_out_gap", 0.0, 60.0),
            ("evaluations", 100, 10**9),
            ("longest", 60.0, 1e9),
        ):
            value = getattr(self, name)
            require(low <= value <= high, f"{name} is {value}; expected {low:g} <= {name} <= {high:g}")

    @property
    def families(self) -> tuple[str, ...]:
        """The families that may be named."""
        return tuple(self.effects) or catalogue()

    @property
    def further(self) -> tuple[str, ...]:
        """Families asked only where the plainer ones leave something."""
        rest = [name for name in catalogue(everything=True) if name not in self.families]
        laws = (n for n in rest if not family(n).asked_only and not family(n).momentary)
        return () if self.effects else tuple(laws)

    @property
    def options(self) -> dict[str, Any]:
        """What families may look up when they list their terms."""
        return {k: v for k, v in asdict(self).items() if k != "process"}
