from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from psmpc_cli.specs.priorities import ACCEPTABLE, LARGEST_INDEX, LARGEST_INDEX_OF_MORE, Pair, groups, weigh

RANDOM_INDEX = {3: 0.525, 4: 0.882, 5: 1.115, 6: 1.252}
"""Saaty's random index, from simulations with his scale 1/9 .. 9."""

ratios = st.floats(1e-3, 1e3)


@st.composite
def comparisons(draw: st.DrawFn) -> tuple[int, list[Pair], list[float]]:
    """Comparisons that connect two to six things: a tree, and some of the other pairs."""
    count = draw(st.integers(2, 6))
    tree = [(draw(st.integers(0, i - 1)), i) for i in range(1, count)]
    others = [pair for pair in combinations(range(count), 2) if pair not in tree]
    pairs = [*tree, *draw(st.lists(st.sampled_from(others), unique=True) if others else st.just([]))]
    turned = [pair if draw(st.booleans()) else pair[::-1] for pair in pairs]
    return count, turned, [draw(ratios) for _ in turned]


@given(st.integers(2, 6), st.data())
def test_complete_sets_weigh_by_the_geometric_means_of_their_rows(count: int, data: st.DataObject) -> None:
    pairs = list(combinations(range(count), 2))
    given_ratios = [data.draw(ratios) for _ in pairs]
    matrix = np.ones((count, count))
    for (a, b), ratio in zip(pairs, given_ratios, strict=True):
        matrix[a, b], matrix[b, a] = ratio, 1 / ratio
    means = np.exp(np.log(matrix).mean(axis=1))
    np.testing.assert_allclose(np.exp(weigh(count, pairs, given_ratios).logarithms), means / means[0], rtol=1e-9)


@given(comparisons(), st.data())
def test_consistent_sets_are_met_exactly(given_set: tuple[int, list[Pair], list[float]], data: st.DataObject) -> None:
    count, pairs, _ = given_set
    weights = np.array([1.0, *(data.draw(ratios) for _ in range(count - 1))])
    found = weigh(count, pairs, [weights[a] / weights[b] for a, b in pairs])
    np.testing.assert_allclose(np.exp(found.logarithms), weights, rtol=1e-9)
    assert found.ratio < 1e-12


@given(comparisons())
def test_turning_a_comparison_round_changes_nothing(given_set: tuple[int, list[Pair], list[float]]) -> None:
    count, pairs, given_ratios = given_set
    found = weigh(count, pairs, given_ratios)
    turned = weigh(count, [(b, a) for a, b in pairs], [1 / ratio for ratio in given_ratios])
    np.testing.assert_allclose(turned.logarithms, found.logarithms, atol=1e-9)
    assert turned.ratio == pytest.approx(found.ratio, rel=1e-6, abs=1e-12)


@given(comparisons())
def test_what_the_others_imply_is_what_they_weigh_without_it(given_set: tuple[int, list[Pair], list[float]]) -> None:
    count, pairs, given_ratios = given_set
    found = weigh(count, pairs, given_ratios)
    for left, (a, b) in enumerate(pairs):
        others = [pair for i, pair in enumerate(pairs) if i != left]
        if len(groups(count, others)) > 1:
            assert np.isnan(found.implied[left])
            continue
        rest = weigh(count, others, [ratio for i, ratio in enumerate(given_ratios) if i != left])
        assert found.implied[left] == pytest.approx(rest.logarithms[a] - rest.logarithms[b], abs=1e-6)


@given(comparisons())
def test_without_the_worst_the_others_agree_best(given_set: tuple[int, list[Pair], list[float]]) -> None:
    count, pairs, given_ratios = given_set
    found = weigh(count, pairs, given_ratios)
    assert (found.worst is None) == (found.surplus == 0)
    if found.worst is None:
        assert found.ratio == 0
        return

    def disagreement(left: int) -> float:
        kept = [i for i in range(len(pairs)) if i != left]
        if len(groups(count, [pairs[i] for i in kept])) > 1:
            return np.inf
        rest = weigh(count, [pairs[i] for i in kept], [given_ratios[i] for i in kept])
        residual = [np.log(given_ratios[i]) - rest.logarithms[pairs[i][0]] + rest.logarithms[pairs[i][1]] for i in kept]
        return float(np.sum(np.square(residual)))

    assert disagreement(found.worst) <= min(disagreement(i) for i in range(len(pairs))) + 1e-6


@pytest.mark.parametrize("count", [3, 4, 5])
def test_the_ratio_is_saatys_where_comparisons_nearly_agree(count: int) -> None:
    """For complete sets and small disagreement CI = (lambda_max - n) / (n - 1) over his random index."""
    random = np.random.default_rng(count)
    pairs = list(combinations(range(count), 2))
    for _ in range(20):
        weights, noise = np.exp(random.standard_normal(count)), np.exp(0.1 * random.standard_normal(len(pairs)))
        given_ratios = [weights[a] / weights[b] * error for (a, b), error in zip(pairs, noise, strict=True)]
        matrix = np.ones((count, count))
        for (a, b), ratio in zip(pairs, given_ratios, strict=True):
            matrix[a, b], matrix[b, a] = ratio, 1 / ratio
        index = (np.linalg.eigvals(matrix).real.max() - count) / (count - 1)
        assert weigh(count, pairs, given_ratios).ratio == pytest.approx(index / RANDOM_INDEX[count], rel=0.05)


def test_the_index_of_random_comparisons_does_not_depend_on_which_pairs_are_compared() -> None:
    """So that the threshold of a complete set serves an incomplete one."""
    random, scale = np.random.default_rng(0), np.log([*range(1, 10), *(1 / k for k in range(2, 10))])
    complete = list(combinations(range(5), 2))
    means = []
    for pairs in (complete, complete[:6], [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)]):
        found = [weigh(5, pairs, np.exp(random.choice(scale, len(pairs))).tolist()).ratio for _ in range(2000)]
        means.append(np.mean(found) * LARGEST_INDEX_OF_MORE / ACCEPTABLE)
    np.testing.assert_allclose(means, np.var(scale), rtol=0.1)


def test_three_comparisons_may_miss_each_other_by_less_than_a_factor_of_three() -> None:
    pairs = [(0, 1), (1, 2), (0, 2)]
    largest = np.exp(np.sqrt(3 * LARGEST_INDEX[3]))
    assert largest == pytest.approx(2.62, abs=0.01)
    assert weigh(3, pairs, [100, 100, 1e4 / largest * 1.001]).ratio < ACCEPTABLE
    assert weigh(3, pairs, [100, 100, 1e4 / largest * 0.999]).ratio > ACCEPTABLE


def test_of_comparisons_that_contradict_each_other_alike_the_last_is_the_worst() -> None:
    found = weigh(4, [(0, 1), (1, 2), (0, 2), (3, 2)], [2, 3, 50, 7])
    assert found.worst == 2
    assert np.exp(found.implied[2]) == pytest.approx(6)


@given(st.integers(1, 8), st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=10))
def test_groups_are_what_comparisons_connect(count: int, drawn: list[Pair]) -> None:
    pairs = [(a % count, b % count) for a, b in drawn]
    found = groups(count, pairs)
    assert sorted(i for group in found for i in group) == list(range(count))
    assert all(any(a in group and b in group for group in found) for a, b in pairs)
    links = np.eye(count, dtype=int)
    for a, b in pairs:
        links[a, b] = links[b, a] = 1
    connected = np.linalg.matrix_power(links, count) > 0
    assert {tuple(group) for group in found} == {tuple(np.flatnonzero(row).tolist()) for row in connected}
