"""The public names for type checkers: at run time __init__.py imports each when it is first used."""

from psmpc_cli.control import Command as Command
from psmpc_cli.control import Controller as Controller
from psmpc_cli.control import State as State
from psmpc_cli.errors import (
    InputError as InputError,
)
from psmpc_cli.errors import (
    LogError as LogError,
)
from psmpc_cli.errors import (
    PsmpcError as PsmpcError,
)
from psmpc_cli.errors import (
    RunError as RunError,
)
from psmpc_cli.errors import (
    SpecError as SpecError,
)
from psmpc_cli.figures.registry import plot as plot
from psmpc_cli.logs.run import Run as Run
from psmpc_cli.logs.run import read_run as read_run
from psmpc_cli.plant import Ticks as Ticks
from psmpc_cli.report.view import view as view
from psmpc_cli.robot.model import load_robot as load_robot
from psmpc_cli.simulation.recorder import Recorder as Recorder
from psmpc_cli.simulation.run import simulate as simulate
from psmpc_cli.specs.load import load_task as load_task
from psmpc_cli.studies.compare import compare as compare
from psmpc_cli.studies.monte_carlo import monte_carlo as monte_carlo
from psmpc_cli.studies.sweep import sweep as sweep

__version__: str
