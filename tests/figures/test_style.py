"""Words in figures."""

from psmpc_cli.figures.style import LONGEST_NAME, readable


def test_names_become_words_and_stay_short() -> None:
    assert readable("arm_1") == "arm 1"
    long = readable("inspect_the_far_side_of_panel_12")
    assert len(long) <= LONGEST_NAME
    assert long.startswith("inspect") and long.endswith("12")
