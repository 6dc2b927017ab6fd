"""Each case shows that the naive method fails, and that xcg stays within its bound."""

import pytest

from tests.stability.cases import CASES
from tests.stability.physical import LIMITS


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.__name__)
def test_naive_sums_lose_digits_and_xcg_keeps_them(case):
    result = case()
    assert result.naive > 5 * result.bound, result
    assert result.ours <= result.bound, result


@pytest.mark.parametrize("limit", LIMITS, ids=lambda c: c.__name__)
def test_the_stated_error_equals_that_of_the_field(limit):
    found = limit()
    low, high = found.ratio
    assert found.true > 0.01
    assert low < found.stated / found.true < high
