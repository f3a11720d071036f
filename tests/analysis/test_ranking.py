"""Competition ranks match their definition: one more than the number of smaller values."""

from hypothesis import given
from hypothesis import strategies as st

from robustflow.analysis.ranking import average_ranks, competition_ranks


@given(st.dictionaries(st.text(max_size=3), st.integers(-3, 3).map(float)))
def test_a_rank_is_one_more_than_the_number_of_smaller_values(values):
    ranks = competition_ranks(values)
    assert ranks == {name: 1 + sum(other < value for other in values.values()) for name, value in values.items()}
    assert list(ranks) == list(values)


def test_the_best_has_rank_1_and_equal_values_skip_what_follows():
    assert competition_ranks({"a": 0.5, "b": -1.0, "c": 0.5, "d": 2.0}) == {"a": 2, "b": 1, "c": 2, "d": 4}
    assert competition_ranks({"alone": 7.0}) == {"alone": 1}


def test_average_ranks_rank_the_sum_over_names_in_all_rankings():
    """Rank sums are a: 1 + 3, b: 2 + 2, c: 3 + 4; d appears in only one ranking."""
    assert average_ranks({"a": 1, "b": 2, "c": 3, "d": 1}, {"a": 3, "b": 2, "c": 4}) == {"a": 1, "b": 1, "c": 3}
