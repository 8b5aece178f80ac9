"""The gate's options: their limits, and what the gate does unasked."""

import numpy as np
import pytest

from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.gate.options import GateOptions


def test_scores_come_unasked_up_to_2000_keyframes():
    assert GateOptions().wants_scores(2000)
    assert not GateOptions().wants_scores(2001)


@pytest.mark.parametrize(
    "options",
    [
        {"rule": "gut feeling"},
        {"min_probability": 0.4},
        {"min_probability": 1.0},
        {"min_probability": np.nan},
        {"max_rise": 0.0},
        {"beta": 0.0},
    ],
)
def test_options_out_of_range(options):
    with pytest.raises(InvalidOptionError, match="expected"):
        GateOptions(**options)


def test_one_shared_landmark_may_be_enough_and_none_is_not():
    assert GateOptions(min_shared_landmarks=1).min_shared_landmarks == 1
    with pytest.raises(InvalidOptionError, match="min_shared_landmarks"):
        GateOptions(min_shared_landmarks=0)
