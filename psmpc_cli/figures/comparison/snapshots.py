"""The robot at the switching instants, a row a controller. Fig. 5 of the paper."""

from collections.abc import Mapping, Sequence
from string import ascii_lowercase

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from psmpc_cli.figures.comparison.names import title_of
from psmpc_cli.figures.robot_drawing import View, base_outline, draw_scene, show, view_of
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EDGE, LINE, PAGE, TEXT, new_figure, readable
from psmpc_cli.robot.model import arm_points


def plot_snapshots(runs: Mapping[str, Run]) -> Figure:
    """Return the robot at the end of each stage [m]; faint, at the early start of the stage after it."""
    raise NotImplementedError
