"""What a family of effects declares of itself: names, units, where it may sit, what it is alike to. No behaviour."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from hybrid_dynamics.effects.state import Equivalence, Parameter, Refined, Scope, Settings, Variable


class Declared:
    """The declarations of a :class:`~hybrid_dynamics.effects.base.Family`, with what holds where one says nothing."""

    name: ClassVar[str]
    scope: ClassVar[Scope]
    parameters: ClassVar[tuple[Parameter, ...]]
    #: The torque that the drive must add (TeX).
    equation: ClassVar[str] = ""
    #: Number of coordinates; ask ``term.size`` where it may depend on the term.
    size: ClassVar[int] = 1
    #: Sought without being asked for by name.
    searched: ClassVar[bool] = True
    #: Sought only where it is asked for by name: too free, or about the recording rather than the robot.
    asked_only: ClassVar[bool] = False
    #: Hidden in the full study's cases; a law that is a text is not: none is more likely than another.
    hidden: ClassVar[bool] = True
    #: A constant torque that acts within intervals of time: looked for as what stands out in time, not as a law.
    momentary: ClassVar[bool] = False
    #: A joint effect that may also be one for all joints together (no joint is named then).
    shared: ClassVar[bool] = False
    #: Changes so fast that it can pass for noise: proposed on every joint that moves, whatever seems to be left.
    like_noise: ClassVar[bool] = False
    #: Several of it may sit on one joint (see :meth:`.Family.place`).
    several: ClassVar[bool] = False
    #: Families that this one holds as a special case (:meth:`.Family.covers`): they go from its joint when it comes.
    contains: ClassVar[tuple[str, ...]] = ()
    #: Settings at which what it has beyond them (its second coordinate) may hide from runs that show them alone.
    rest_hides_at: ClassVar[Settings] = ()
    #: A body that may be put on and taken off: its mass is what a reader asks for.
    detachable: ClassVar[bool] = False
    #: Plain effects of the joints that it acts on: it is named for what it explains beside them, since a law that
    #: several joints share can stand for what each of them has on its own.
    beside: ClassVar[tuple[str, ...]] = ()
    #: In few poses the same as the weight of links that are identified anew: estimated beside all of them.
    like_weight: ClassVar[bool] = False
    #: True where every joint of a real arm may well have it: a search that starts from everything starts with these.
    everywhere: ClassVar[bool] = False
    #: Coordinates are ten inertial parameters a body: many free numbers that can imitate simpler effects.
    is_body: ClassVar[bool] = False
    #: All bodies of the robot at once: they can make any multiple of its torque.
    all_links: ClassVar[bool] = False
    #: What may be another from one recording to the next: in which words, and by which parameters (if
    #: a few poses tell them) that is said.
    between_runs: ClassVar[tuple[str, tuple[str, ...]] | None] = None
    #: True where the torque is not exactly linear in the coordinates.
    nonlinear: ClassVar[bool] = False
    #: Names of the settings it may have (what they may be: ``effects/settings.py``).
    known_settings: ClassVar[tuple[str, ...]] = ()
    #: Parameters that stand as numbers in the settings of a term and are refined.
    nonlinear_settings: ClassVar[tuple[Refined, ...]] = ()
    #: Parameters that say where it acts and not how much, beside the refined ones: sure or not, they make no torque.
    says_where: ClassVar[tuple[str, ...]] = ()
    #: True where the torque depends on the rigid-body torque of the joint, and so on all other effects of the body.
    uses_load: ClassVar[bool] = False
    #: True where the columns follow the torque of the whole model so far (``Motion.given_torque``).
    uses_torque: ClassVar[bool] = False
    #: True where the columns follow the bodies of the whole model so far (``Motion.robot``): what turns gravity or a
    #: zero turns all of them.
    uses_body: ClassVar[bool] = False
    #: True where the effect changes what is read (a gain, an offset, a delay), not what the robot does.
    changes_reading: ClassVar[bool] = False
    #: Powers (1 to 3) of the speed, one a coordinate, where the effect is a viscous torque x |dq|^power sign(dq).
    viscous_powers: ClassVar[tuple[int, ...]] = ()
    #: True where the torque opposes the joint's motion: it may take energy, never give it. What of it is there at any
    #: speed is told as ``dry_friction`` by :meth:`.Law.in_descriptions`; else it counts as none.
    is_friction: ClassVar[bool] = False
    #: True where the coordinates are one cause's in either direction: of like size where a log shows one of them alone.
    of_like_size: ClassVar[bool] = False
    #: True where the torque follows the time since the run began: its friction must be friction however late.
    follows_time: ClassVar[bool] = False
    #: True where the torque follows sign(dq); how that turns over is a setting (see ``effects/sign.py``).
    turns_sign: ClassVar[bool] = False
    #: True where the coordinates lie on a surface (:meth:`.Family.surface`).
    on_surface: ClassVar[bool] = False
    #: True where the effect changes the rigid body.
    changes_body: ClassVar[bool] = False
    #: True where the columns are constants times ``Motion.regressor``: smoothed once, it serves all such effects.
    by_regressor: ClassVar[bool] = False
    #: Parameters beyond which something else is wrong, and what (one clause).
    believable: ClassVar[Mapping[str, tuple[float, float, str]]] = MappingProxyType({})
    #: The variable a residual is drawn against so that the effect shows.
    drawn_against: ClassVar[Variable] = "dq"
    #: What motion shows this effect as itself (one clause, follows "a motion in which").
    shown_by: ClassVar[str] = ""
    #: Families that can make the same torque, and why.
    equivalent_to: ClassVar[tuple[Equivalence, ...]] = ()
