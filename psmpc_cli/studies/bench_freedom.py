"""How the time of a solve grows with the degrees of freedom of the robot."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from psmpc_cli.errors import RunError
from psmpc_cli.studies.bench import Choices, pose, solver_in_force
from psmpc_cli.studies.bench_robots import task_with
from psmpc_cli.studies.bench_solves import Solved, Way, time_solves, ways_with
from psmpc_cli.studies.bench_statistics import exponent
from psmpc_cli.studies.bench_windows import record_windows

ROBOTS = tuple((arms, joints) for arms in (1, 2, 3) for joints in (3, 5, 7))
"""Arms of each robot, and joints of each arm."""

NODES = 25
"""Intervals a stage."""


@dataclass(frozen=True, eq=False)
class Freedom:
    """What was measured of one robot: windows with one stage and with two.

    Attributes:
        arms, joints: Its arms, and the joints of each.
        solved: What each way came to.
    """

    arms: int
    joints: int
    solved: tuple[Solved, ...]

    @property
    def n(self) -> int:
        """Its degrees of freedom."""
        return 3 + self.arms * self.joints


@dataclass(frozen=True, eq=False)
class FreedomGrowth:
    """How the processor time of one way grows with the degrees of freedom, in windows with so many stages.

    Attributes:
        way, stages: The way and the number of stages.
        n: Degrees of freedom (robots,).
        times: Mean processor times of a solve (robots,) [s].
        failed: Robots whose window it could not solve.
        exponent: p of time ~ n^p.
    """

    way: Way
    stages: int
    n: tuple[int, ...]
    times: tuple[float, ...]
    failed: int
    exponent: float


def measure_freedom(
    choices: Choices, told: Callable[[str], None] = lambda line: None, passed: Callable[[], None] = lambda: None
) -> list[Freedom]:
    """Record the windows before and after the second stage enters, for one robot after the other, and time solves.

    Raises:
        RunError: A robot does not get there.
    """
    found = []
    for number, (arms, joints) in enumerate(ROBOTS, start=1):
        loaded = task_with(arms, joints, NODES)
        experiment, windows = record_windows(loaded, 1, passed)
        if not windows:
            raise RunError(f"{loaded.spec.name}: its second stage never entered the window")
        problems = pose([windows[0], windows[-1]], loaded.spec, experiment, passed)
        spec = solver_in_force(loaded.spec, experiment)
        solved = time_solves(
            experiment.problem, problems, ways_with(choices.solvers), spec, choices.repeat, loaded.spec.seed, passed
        )
        found.append(Freedom(arms, joints, tuple(solved)))
        told(f"robot of {arms} x {joints} joints done, {number} of {len(ROBOTS)}")
    return found


def grow_with_freedom(found: Sequence[Freedom]) -> Iterator[FreedomGrowth]:
    """Give how the time of each way grows."""
    every = [(one.n, solved) for one in found for solved in one.solved]
    for way, stages in dict.fromkeys((solved.way, solved.stages) for _, solved in every):
        mine = [(n, one) for n, one in every if (one.way, one.stages) == (way, stages)]
        good = [(n, solved.busy / len(solved.times)) for n, solved in mine if not solved.failed]
        sizes, means = tuple(n for n, _ in good), tuple(mean for _, mean in good)
        yield FreedomGrowth(way, stages, sizes, means, len(mine) - len(good), exponent(sizes, means))
