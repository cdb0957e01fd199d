"""What tests of several rooms share: the built-in tasks on small meshes."""

import gc
import logging
import os

os.environ["OMP_NUM_THREADS"] = "1"  # as the command sets it, before NumPy is loaded

from collections.abc import Callable, Iterator

import pytest
from hypothesis import settings

from psmpc_cli.ocp.objective import StageCosts
from psmpc_cli.ocp.problem import build_stages
from psmpc_cli.ocp.stage import PlacedStage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.run import Experiment, build_experiment
from psmpc_cli.specs.load import Task, load_task

settings.register_profile("psmpc", deadline=None, max_examples=40)  # no test is about time
settings.load_profile("psmpc")


def pytest_collection_finish() -> None:
    """Collect garbage more seldom, and not among what is imported: that takes a tenth of the time of all tests."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


@pytest.fixture(autouse=True)
def restored_log_levels() -> Iterator[None]:
    """Restore the log levels that commands choose."""
    loggers = [logging.getLogger(name) for name in ("psmpc_cli", "psmpc_cli.native")]
    levels = [logger.level for logger in loggers]
    yield
    for logger, level in zip(loggers, levels, strict=True):
        logger.setLevel(level)


@pytest.fixture(scope="session")
def transport() -> Task:
    """The built-in transport task."""
    return load_task("transport")


@pytest.fixture(scope="session")
def model(transport: Task) -> RobotModel:
    """The planar dual arm."""
    return RobotModel(transport.robot)


@pytest.fixture(scope="session")
def stages(transport: Task, model: RobotModel) -> tuple[PlacedStage, ...]:
    """The stages of the transport task, as a sample finds them."""
    return tuple(stage.unplaced_copy() for stage in build_stages(transport.spec, transport.robot, model))


@pytest.fixture(scope="session")
def costs(model: RobotModel) -> StageCosts:
    """The stage costs of the planar dual arm."""
    return StageCosts(model)


@pytest.fixture(scope="session")
def experiment_of() -> Callable[..., Experiment]:
    """Build an experiment of the transport task with keys changed."""

    def build(*changes: str, task: str = "transport") -> Experiment:
        return build_experiment(load_task(task, changes))

    return build
