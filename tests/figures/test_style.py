from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from psmpc_cli.figures.style import (
    DASHES,
    EARLY,
    LONGEST_NAME,
    PALETTE,
    STAGE,
    line_look,
    readable,
)

# Machado, Oliveira and Fernandes (2009), full severity, on linear RGB.
BLINDNESS = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lab(color: str, seen: np.ndarray) -> np.ndarray:
    """CIELAB of a colour as seen through a matrix on linear RGB."""
    rgb = np.array(to_rgb(color))
    linear = seen @ np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ np.clip(
        linear, 0, 1
    )
    f = np.cbrt(xyz / [0.9505, 1.0, 1.089])
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("kind", BLINDNESS)
def test_the_colours_of_an_arm_differ_for_the_colour_blind(kind: str) -> None:
    seen = [lab(color, np.array(BLINDNESS[kind])) for color in PALETTE[:3]]
    assert min(np.linalg.norm(one - other) for one, other in combinations(seen, 2)) > 15


def test_lines_stand_out_from_every_background() -> None:
    eye = np.eye(3)
    for ground in ("white", STAGE, EARLY):
        assert min(abs(lab(color, eye)[0] - lab(ground, eye)[0]) for color in PALETTE[:4]) > 15


def test_neighbouring_lines_differ_in_print_as_well() -> None:
    looks = [line_look(i) for i in range(len(PALETTE))]
    assert len({look["color"] for look in looks}) == len(PALETTE)
    assert len({str(look["linestyle"]) for look in looks[: len(DASHES)]}) == len(DASHES)


def test_names_become_words_and_stay_short() -> None:
    assert readable("arm_1") == "arm 1"
    long = readable("inspect_the_far_side_of_panel_12")
    assert len(long) <= LONGEST_NAME
    assert long.startswith("inspect") and long.endswith("12")
