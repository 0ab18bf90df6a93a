"""Does the torque fit the motion? Sign, order of the joints, mounting, clock, unit and delay: measured and said."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hybrid_dynamics.check.columns import Columns, OfRun, columns_of, standing
from hybrid_dynamics.check.completed import Completed, body_of, true_stretches
from hybrid_dynamics.check.convention import check_convention
from hybrid_dynamics.check.cures import turned
from hybrid_dynamics.check.delay import LEAST_GAIN, Delay, find_delay
from hybrid_dynamics.check.findings import Finding, Severity
from hybrid_dynamics.check.forms import Fit, Forms
from hybrid_dynamics.check.guess import (
    CERTAIN,
    CHANGED,
    EXPLAINED,
    MOUNTING,
    SAME_MOUNTING,
    SETTLED,
    SIGN,
    UNEXPLAINED,
    Guess,
    angle,
    best_guess,
    contradicted,
    few_rows,
    is_certain,
    left_of,
    shares_of,
)
from hybrid_dynamics.check.order import ONE_WAY, places
from hybrid_dynamics.check.pace import check_pace
from hybrid_dynamics.check.pulled import body_leaves, spring_leaves
from hybrid_dynamics.check.samples import SIGN_WIDTH, Stretch
from hybrid_dynamics.check.units import MAX_SCALE, check_own_units, check_unit
from hybrid_dynamics.check.weight import check_weight, lifts
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: A joint moves both ways where it spends this share of the log in each; a torque is mostly that of the links where
#: they make this much of its standard deviation.
BOTH_WAYS, MOSTLY = 0.05, 0.5
#: Links that would weigh this many times more than those of the other joints, against the URDF, show no sign.
HEAVIER = 3.0
#: A run is looked at alone where it leaves this much more of a joint's mean square than the best run.
OUTVOTED = 0.3
#: Delays [s]: told, doubted, refused. Shorter ones are for the loop to name.
DELAY_TOLD, DELAY_DOUBTED, DELAY_REFUSED = 0.01, 0.03, 0.08
#: Up to this angle [rad] gravity may seem to be turned by links whose masses or centres of mass are off.
WEIGHED_WRONGLY = np.deg2rad(40.0)
#: Share of joints that a late clock must help.
MOST_JOINTS = 0.7
#: A rotor this many times the inertia of all that its joint moves is none.
HEAVIEST = 30.0


def check_torque(
    model: Robot | Completed, runs: Sequence[Trajectory], fixed: bool = False
) -> tuple[list[Finding], Array]:
    """Findings on the torque of ``runs`` (``q tau`` on uniform grids), and gravity (3,) [m/s^2] in the base frame.

    Gravity is that of ``model`` where the torque does not say otherwise; where that is ``fixed``, another one is no
    mounting to be found but one that the model is not of.
    """
    parts = true_stretches(model, runs)
    robot = body_of(model)
    gravity = standing(robot)
    if not parts or sum(len(p.q) for p in parts) < 40:
        return [], gravity
    columns = columns_of(model, parts)
    forms = Forms(columns)
    told, best = best_guess(model, parts, forms, gravity)
    if not _holds(told, best):
        best = told
    as_good = best is not told and best.total <= forms.total(np.zeros(3)) + MOUNTING
    # Columns that are exchanged, say, hold no weight of their own joints either.
    otherwise = as_good and not best.reads_as_told
    weight = [] if otherwise else check_weight(columns, gravity, tilted=as_good)
    if as_good and lifts(columns, best.gravity):
        # Of an arm on a wall other joints lift, and lift all there is.
        weight = []
    if any(f.severity == "hard" for f in weight):
        # Without it every other reading is of another robot.
        return weight, gravity
    counted = check_convention(model, parts, told, best, columns)
    if any(f.severity == "hard" for f in counted):
        return counted, gravity
    names = robot.joint_names
    q = np.concatenate([p.q for p in parts])
    shows = _shown_by(model, parts, columns, forms, best)
    findings = [
        *weight,
        *counted,
        *_signs(robot, told, best, columns, forms, q, shows),
        *places(names, told, best, columns, shows),
        *_clock(told, best),
    ]
    if best.mirror is None and best.swap is None:
        findings += _mounting(robot, told, best, fixed)
        fits = [forms.fit(j, best.gravity, best.source[j], best.sign[j], best.pace) for j in range(forms.n)]
        agreeing = (1 / MAX_SCALE, MAX_SCALE)
        pulled = [
            spring_leaves(columns, q[:, j], best.gravity, j, agreeing) <= min(f.left, SETTLED)
            for j, f in enumerate(fits)
        ]
        as_told = best.reads_as_told and best.pace == 1.0
        delay = _delay(robot, columns, parts, best)
        # What comes too late has lost its inertia: that is no clock.
        pace = check_pace(columns, best.gravity) if as_told and not any(f.severity == "hard" for f in delay) else []
        if not any(f.severity == "hard" for f in pace):
            unit = check_unit(names, fits, np.array(pulled))
            if not unit and as_told:
                turned_by = angle(best.gravity, gravity)
                ways = [best.gravity, *([gravity] if 0.0 < turned_by < WEIGHED_WRONGLY else [])]
                unit = check_own_units(robot, parts, columns, forms, ways)
            findings += unit
        findings += pace
        if best.pace == 1.0:
            findings += _rotors(robot, parts, forms, best)
        findings += delay
    return findings, best.gravity


def outvoted(robot: Robot, runs: Sequence[OfRun], gravity: Array) -> list[tuple[Trajectory, list[str]]]:
    """Runs in which some joints' torque is explained far worse than in the other runs, each with these joints.

    A joint that no run explains says nothing about one of them: what looks like its torque turned round there is what
    the model lacks.
    """
    names = np.array(robot.joint_names)
    left = np.array([[f.fit(j, gravity).left for j in range(f.n)] for f in (Forms(own) for _, own in runs)])
    if len(left) < 2:
        return [(run, list(names)) for run, _ in runs]
    worse = left - left.min(axis=0) > OUTVOTED
    return [(run, list(names[own])) for (run, _), own in zip(runs, worse, strict=True) if own.any()]


def _holds(told: Guess, best: Guess) -> bool:
    """Whether the better guess is one: what it changes is explained by it, and nothing much got worse."""
    if best is told:
        return False
    gained = [j for j in _changed(told, best) if best.scores[j] < told.scores[j]]
    # Where columns change places, each must be at home where it goes: one that says nothing has no place.
    moved = [j for j, k in enumerate(best.source) if j != k]
    open_still = [j for j in {*gained, *moved} if left_of(best.scores[j]) >= EXPLAINED]
    # Of how the base stands, or whose torque is published, a joint whose torque is not that of its links says nothing.
    whole = best.reads_as_told or (best.all_turned and not moved)
    return bool(gained) and (2 * len(open_still) < len(gained) if whole else not open_still)


def _changed(told: Guess, best: Guess) -> list[int]:
    """Joints that the better guess makes better or worse."""
    return [j for j, (a, b) in enumerate(zip(told.scores, best.scores, strict=True)) if abs(a - b) > CHANGED]


def _signs(
    robot: Robot,
    told: Guess,
    best: Guess,
    columns: Columns,
    forms: Forms,
    q: Array,
    shows: Callable[[int], bool] = lambda j: True,
) -> list[Finding]:
    """Torque columns, or positions ``q`` (K, n) [rad], whose sign is wrong; ``shows``: as for :func:`.places`."""
    names = robot.joint_names
    if best.swap is not None:
        return []
    if best.mirror is not None:
        j = best.mirror
        both = best.sign[j] < 0
        what = "position and torque have" if both else "position has"
        cure = turned(len(names), [j], ["q", "dq", *(["tau"] if both else [])])
        moved = _changed(told, best) or [j]
        pulled = moved == [j] and _pulled(columns, q, told, best, j)
        text = (
            f"{what} the wrong sign ({shares_of(told, best, moved)}): the log counts it against the joint's axis in "
            f"the URDF; set the sign of {'q and tau' if both else 'q'} to -1, or turn the axis in the URDF"
        )
        # Where much is left either way the sign is no more than nearer to what is missing.
        heavy = not pulled and (
            left_of(best.scores[j]) >= UNEXPLAINED or _heavy(robot, columns, q, told, best, j, SETTLED)
        )
        one_way = not shows(j)
        doubtful = pulled or heavy or one_way
        if pulled or heavy:
            what = "a spring" if pulled else "a tool or a link with its centre of mass elsewhere"
            text = f"it looks as if {text}; {what} at this joint that pulls the other way would look the same"
        elif one_way:
            text = f"it looks as if {text}; {ONE_WAY}"
        severity: Severity = "hard" if is_certain(told, best) and not doubtful else "warning"
        # What is not certain is no clear cure: nothing is turned round unasked.
        return [Finding("position_sign", severity, text, joint=names[j], suggestion={} if doubtful else cure)]
    flipped = [j for j, s in enumerate(best.sign) if s < 0]
    shown = {
        j: _shows_its_sign(columns, forms, best, j)
        and not _pulled(columns, q, told, best, j)
        and not _heavy(robot, columns, q, told, best, j)
        for j in flipped
    }
    each = [_one_sign(names, told, best, j, shown[j]) for j in flipped]
    if not best.all_turned:
        return each
    gains = [told.scores[j] - best.scores[j] for j in flipped]
    certain = min(gains) > SIGN or any(f.severity == "hard" for f in each)
    asked = [j for j, gain in zip(flipped, gains, strict=True) if gain > CHANGED] or flipped
    text = (
        f"the measured torque of every joint {'has' if certain else 'may have'} the wrong sign "
        f"({shares_of(told, best, asked)}); no direction of gravity and no order of the joints explains it better; "
        "expected the torque the drive delivers, positive along the joint axis: flip its sign"
    )
    cure = turned(len(names), flipped, ["tau"]) if certain else {}
    return [Finding("torque_sign", "hard" if certain else "warning", text, suggestion=cure)]


def _pulled(columns: Columns, q: Array, told: Guess, best: Guess, j: int) -> bool:
    """Whether a spring at joint ``j`` explains as well as the better guess."""
    return spring_leaves(columns, q[:, j], told.gravity, j) <= max(left_of(best.scores[j]), SETTLED)


def _heavy(robot: Robot, columns: Columns, q: Array, told: Guess, best: Guess, j: int, settled: float = 0.0) -> bool:
    """Whether one body that joint ``j`` carries and that weighs otherwise explains as well as the better guess, or
    leaves no more than ``settled``.

    A torque that is turned round has its friction turned round, which no body has.
    """
    return body_leaves(robot, q, columns, told.gravity, j) <= max(left_of(best.scores[j]), settled)


def _one_sign(names: Sequence[str], told: Guess, best: Guess, j: int, shown: bool) -> Finding:
    """The torque of joint ``j`` alone: certain only where its sign is ``shown`` and the other leaves little over.

    A spring or a heavy tool on a light wrist looks more like its torque turned round than like its torque.
    """
    certain = shown and told.scores[j] - best.scores[j] >= CERTAIN and left_of(best.scores[j]) < SETTLED
    return Finding(
        "torque_sign",
        "hard" if certain else "warning",
        f"the measured torque (tau{j + 1}) {'has' if certain else 'may have'} the wrong sign "
        f"({shares_of(told, best, [j])}); no direction of gravity and no order of the joints explains it better; "
        "expected the torque the drive delivers, positive along the joint axis: "
        + (
            "flip its sign" if certain else "flip its sign, unless a tool or a spring at this joint pulls the other way"
        ),
        joint=names[j],
        # What is not certain is no clear cure: nothing is turned round unasked.
        suggestion=turned(len(names), [j], ["tau"]) if certain else {},
    )


def _shown_by(
    model: Robot | Completed, parts: Sequence[Stretch], columns: Columns, forms: Forms, best: Guess
) -> Callable[[int], bool]:
    """Whether a joint, as the better guess reads the log, moves both ways, or else shows its torque all the same
    (:func:`_shows_its_sign`)."""
    if best.swap is not None or best.mirror is not None:
        columns = columns_of(model, few_rows(parts), best.swap, best.mirror)
        forms = Forms(columns)
    return lambda j: _moves_both_ways(columns, j) or _shows_its_sign(columns, forms, best, j)


def _moves_both_ways(columns: Columns, j: int) -> bool:
    dq = columns.dq[:, j]
    return bool(min(np.mean(dq > SIGN_WIDTH), np.mean(dq < -SIGN_WIDTH)) >= BOTH_WAYS)


def _shows_its_sign(columns: Columns, forms: Forms, best: Guess, j: int) -> bool:
    """Whether the joint moves both ways, or its torque is mostly that of its links; not by a rotor alone.

    Friction along one way is a constant and a slope like any other: a cable's pull that falls off looks like it. At one
    frequency a spring is a rotor turned round. A tool on one side of a wrist whose own weight, a small one, lies on the
    other looks like that weight turned round and many times as large.
    """

    def fit(k: int, rotor: bool = True, links: bool = True) -> Fit:
        return forms.fit(k, best.gravity, best.source[k], best.sign[k], best.pace, rotor, links)

    own = fit(j, rotor=False)
    others = [f.coefficients[0] for k in range(forms.n) if k != j and (f := fit(k)).left < EXPLAINED]
    heavy = bool(others) and own.coefficients[0] > HEAVIER * float(np.median(others))
    if heavy:
        own = fit(j, rotor=False, links=False)
    if own.left >= EXPLAINED:
        return False
    if _moves_both_ways(columns, j):
        return True
    whole = fit(j)
    return not heavy and bool(whole.coefficients[0] * whole.rigid >= MOSTLY * columns.tau[:, best.source[j]].std())


def _clock(told: Guess, best: Guess) -> list[Finding]:
    if best.pace == 1.0:
        return []
    slow = best.pace > 1
    factor = best.pace if slow else 1 / best.pace
    return [
        Finding(
            "time_scale",
            "hard" if is_certain(told, best) else "warning",
            f"time stamps run {factor:g} times too {'slow' if slow else 'fast'}: the torque shows inertia of a motion "
            f"that is {factor:g} times {'faster' if slow else 'slower'} than the stamps say; expected seconds: "
            f"{'divide' if slow else 'multiply'} them by {factor:g}",
            # Read as seconds, milliseconds run a thousand times too slow; no other factor is a unit's.
            suggestion={"units": {"time": "ms"}} if best.pace == 1e3 else {},
        )
    ]


def _rotors(robot: Robot, parts: Sequence[Stretch], forms: Forms, best: Guess) -> list[Finding]:
    """Rotors that would weigh many times what they move: then it is the clock that is wrong."""
    q = np.concatenate([p.q for p in parts])
    q = q[np.linspace(0, len(q) - 1, min(len(q), 30)).astype(int)]
    floating = robot.copy()
    floating.model.gravity.linear = np.zeros(3)
    n = forms.n
    own = np.array(
        [floating.inverse_dynamics(q, 0 * q, np.tile(np.eye(n)[j], (len(q), 1)))[:, j].mean() for j in range(n)]
    )
    for j in map(int, np.flatnonzero(own >= 0.2 * own.max())):
        with_rotor = forms.fit(j, best.gravity, best.source[j], best.sign[j])
        without = forms.fit(j, best.gravity, best.source[j], best.sign[j], rotor=False)
        rotor = float(with_rotor.coefficients[3])
        # A joint that is not explained so either lacks something else.
        if with_rotor.left < UNEXPLAINED and rotor > HEAVIEST * own[j] and without.score - with_rotor.score > 0.1:
            times = rotor / max(float(own[j]), 1e-300)
            scale = 10 ** max(round(float(np.log10(times)) / 2), 1)
            # One clock drives all joints.
            if contradicted(forms, best, float(np.sqrt(times))):
                continue
            text = (
                f"the torque would take a rotor of {rotor:.3g} kg m^2, {times:.0f} times what the joint moves: "
                f"time stamps run about {scale:g} times too slow; expected seconds: divide them by {scale:g}"
            )
            severity: Severity = "hard" if n > 2 else "warning"
            return [Finding("time_scale", severity, text, joint=robot.joint_names[j])]
    return []


def _mounting(robot: Robot, told: Guess, best: Guess, fixed: bool) -> list[Finding]:
    off = angle(best.gravity, told.gravity)
    if off <= SAME_MOUNTING:
        return []
    x, y, z = best.gravity
    where = (
        f"at {np.rad2deg(off):.0f} deg to it, along ({x:.2f}, {y:.2f}, {z:.2f}) m/s^2 in the frame of "
        f"{robot.name}'s base"
    )
    certain = off > WEIGHED_WRONGLY and is_certain(told, best)
    if fixed:
        text = (
            f"the base {'does' if certain else 'may'} not stand as the model says: gravity is found {where}; the model "
            "is of another mounting: run close-loop on logs of this one, or give the log of a robot that stands so"
        )
        return [Finding("mounting", "hard" if certain else "warning", text)]
    if certain:
        text = (
            f"the base does not stand as the URDF says: gravity is found {where} (an arm on a wall or under a "
            "ceiling); close-loop names it gravity_tilt"
        )
    else:
        text = (
            f"the base may not stand as the URDF says: gravity fits best {where}; links that weigh other than the URDF "
            "says look the same: close-loop asks for both"
        )
    return [Finding("mounting", "note", text)]


def _delay(robot: Robot, columns: Columns, parts: Sequence[Stretch], best: Guess) -> list[Finding]:
    def torque(j: int) -> tuple[Array, Array]:
        return columns.model(j, best.gravity, best.pace), best.sign[j] * columns.tau[:, best.source[j]]

    sliding = [j for j, name in enumerate(robot.joint_names) if name in robot.prismatic]
    found: Delay = find_delay(columns, parts, torque, sliding)
    size = abs(found.seconds)
    # A quarter of a sampling interval is what the parabola resolves.
    if size < DELAY_TOLD or found.gain < LEAST_GAIN:
        return []
    what = "later" if found.seconds > 0 else "earlier"
    if found.agreeing < MOST_JOINTS:
        text = (
            f"the torque of {found.agreeing:.0%} of the joints fits the motion best {size:.3g} s {what}, the others do "
            "not say so: that is no clock; their torque is not what the model says, or the run is short"
        )
        return [Finding("torque_delay", "note" if size < DELAY_DOUBTED else "warning", text)]
    if size >= DELAY_DOUBTED and not found.lasting:
        text = (
            f"the torque fits the motion best {size:.3g} s {what}, but not in both halves of the log: that is hardly a "
            "clock; if the clocks are in doubt, record a longer run with quicker motion"
        )
        return [Finding("torque_delay", "warning", text)]
    severity: Severity = "hard" if size >= DELAY_REFUSED else "warning" if size >= DELAY_DOUBTED else "note"
    text = (
        f"the torque is recorded {size:.3g} s {what} than the positions; expected one clock for both: shift it with "
        f"delay {found.seconds:.3g} s"
    )
    return [Finding("torque_delay", severity, text, suggestion={"torque_delay": round(found.seconds, 4)})]
