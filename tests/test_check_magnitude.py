"""A torque without its sign: refused as what it is, not as one of the wrong sign."""

import numpy as np
import pytest
from tests.small_arm import HIDDEN, arm, runs

from hybrid_dynamics import close_loop
from hybrid_dynamics.check.magnitude import check_magnitude
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.simulation.excitation import excitation


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_torque_that_has_lost_its_sign_is_refused_as_a_magnitude(sign):
    train, test = runs()
    lost = [r.with_signals(tau=sign * np.abs(r["tau"])) for r in train]
    (told,) = check_magnitude(arm(), lost)
    assert (told.severity, told.code) == ("hard", "torque_unsigned")
    with pytest.raises(InputError, match="magnitude without its direction; log the torque"):
        close_loop(arm(), lost, test)
    assert check_magnitude(arm(), train) == []
    assert check_magnitude(arm(), [r.with_signals(tau=-r["tau"]) for r in train]) == []


def test_a_torque_that_is_pulled_to_one_side_is_no_magnitude():
    """Springs or counterweights hold both joints up: the torque never turns over, and never comes near zero."""
    pull = [Effect("torque_offset", (joint,), {"offset": 60.0}) for joint in ("shoulder", "elbow")]
    log = excitation(arm(), [*HIDDEN, *pull], duration=8.0, rate=200.0)
    assert np.all(log["tau"] > 0)
    assert check_magnitude(arm(), [log]) == []


def test_one_joint_whose_torque_never_turns_over_tells_nothing():
    (log,), _ = runs(train=1)
    one = log.with_signals(tau=np.column_stack([np.abs(log["tau"][:, 0]), log["tau"][:, 1]]))
    assert check_magnitude(arm(), [one]) == []
    assert check_magnitude(arm(), []) == []
