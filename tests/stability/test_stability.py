"""Each case shows that the naive method fails, and that xcg stays within its bound."""

import pytest

from tests.stability.cases import CASES


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.__name__)
def test_naive_fails_and_xcg_does_not(case):
    result = case()
    assert result.naive > 5 * result.bound, result
    assert result.ours <= result.bound, result
