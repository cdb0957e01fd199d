"""Which priorities a sweep tries."""

import numpy as np
import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.studies.sampling import (
    grid_sampling,
    is_grid,
    parse_epsilons,
    parse_range,
    random_sampling,
)

BOX = (1e-3, 1e3)


def test_a_grid_has_omega_1_along_its_columns_and_omega_2_along_its_rows() -> None:
    sampling = grid_sampling("5x3", BOX)
    assert sampling.shape == (3, 5)
    omega = sampling.omega.reshape(3, 5, 2)
    np.testing.assert_allclose(omega[0, :, 0], 10.0 ** np.linspace(-3, 3, 5))
    np.testing.assert_allclose(omega[:, 0, 1], [1e-3, 1, 1e3])


def test_the_papers_grid_has_49_distinct_ratios_and_they_are_those_of_49_ratios() -> None:
    grid, ratios = grid_sampling("25x25", BOX), grid_sampling("49", BOX)
    distinct = np.unique(np.round(np.log10(grid.ratio), 9))
    assert len(grid.omega) == 625
    assert len(distinct) == 49
    np.testing.assert_allclose(distinct, np.log10(ratios.ratio), atol=1e-9)


def test_ratios_lie_within_the_box_and_around_one() -> None:
    sampling = grid_sampling("9", BOX)
    assert sampling.shape == (9,)
    assert sampling.omega.min() >= 1e-3 * (1 - 1e-12)
    assert sampling.omega.max() <= 1e3 * (1 + 1e-12)
    np.testing.assert_allclose(sampling.omega.prod(axis=1), 1)


def test_random_draws_repeat_with_their_seed_and_stay_in_the_box() -> None:
    one, same, other = (random_sampling("random:200", (0.1, 10.0), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.omega, same.omega)
    assert not np.array_equal(one.omega, other.omega)
    assert 0.1 <= one.omega.min() < one.omega.max() <= 10.0
    assert abs(np.log10(one.omega).mean()) < 0.2


@pytest.mark.parametrize("text", ["25x", "x25", "1x25", "25x25x25", "1", "0", "2.5x3", "-3x3", "25 x 25", "400x400"])
def test_what_is_no_grid_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(InputError, match="expected") as error:
        grid_sampling(text, BOX)
    assert text in str(error.value)


@pytest.mark.parametrize("text", ["random", "random:", "random:0", "random:-3", "lhs:30", "random:1e3"])
def test_what_is_no_sampling_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(InputError, match=r"expected random:N") as error:
        random_sampling(text, BOX, 0)
    assert text in str(error.value)


@pytest.mark.parametrize("text", ["1e-3", "1e3:1e-3", "0:1", "-1:1", "a:b", "1:inf", "nan:1", "1:1", ""])
def test_what_is_no_range_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(InputError, match="expected LOW:HIGH") as error:
        parse_range(text)
    assert f"'{text}'" in str(error.value)


@pytest.mark.parametrize("text", ["", "0", "-1,1", "a", "1e-3;1e-2", "nan", "inf"])
def test_what_are_no_thresholds_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(InputError, match="expected positive numbers"):
        parse_epsilons(text)


def test_thresholds_come_sorted_and_each_once() -> None:
    assert parse_epsilons("0.1, 1e-3,0.1") == (1e-3, 0.1)


def test_a_task_is_not_taken_for_a_grid() -> None:
    assert all(is_grid(text) for text in ("25x25", "49", "25y25", "-3"))
    assert not any(is_grid(text) for text in ("transport", "tasks/transport.yaml", "2024/task.yaml", "3_arms.yaml"))
