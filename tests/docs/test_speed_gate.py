"""The comparison of two commits tells what moved, and nothing else."""

import numpy as np
import pytest

from docs.against import CONFIDENCE, Change, fewest


@pytest.mark.parametrize(
    ("factor", "verdict"), [(1.0, ""), (1.01, ""), (1.1, "slower"), (0.9, "faster")]
)
def test_changes_beyond_noise_are_reported(factor, verdict):
    noise = np.exp(np.random.default_rng(3).normal(0.0, 0.03, 25))
    assert Change(factor * noise).verdict == verdict


def test_false_alarms_are_as_rare_as_the_confidence():
    rng = np.random.default_rng(4)
    false = [Change(np.exp(rng.normal(0.0, 0.2, 12))).verdict != "" for _ in range(4000)]
    assert np.mean(false) <= 1.0 - CONFIDENCE  # some fall below the smallest change that is told


def test_the_number_of_turns_gives_confidence_limits():
    few = fewest()
    assert 2 * 0.5**few <= 1.0 - CONFIDENCE < 2 * 0.5 ** (few - 1)
