"""Run the missions of `recorded` and keep some of their windows: `python -m tests.solvers.record`."""

import numpy as np

from psmpc_cli.control import Command

from ..stepped import stepped
from .recorded import FILE, MISSIONS, RecordedSolve


def chosen(mission: str, commands: list[Command]) -> set[int]:
    """Return the samples to be kept of a mission."""
    counts = [len(command.solution.window.stages) for command in commands]
    if mission == "free flyer":
        return {0, 5, 12, 20, 35, 45, 72}
    if mission == "curved end":
        of_two = [sample for sample, count in enumerate(counts) if count == 2]
        return {of_two[0], next(sample for sample in of_two if commands[sample].solution.warm)}
    appended = {sample for sample, command in enumerate(commands) if "appended" in command.events}
    kept = {0, 20}
    for count in set(counts):
        of_count = [sample for sample, found in enumerate(counts) if found == count]
        kept |= {of_count[0], of_count[len(of_count) // 2], of_count[-1]}
    kept |= {sample + later for sample in appended for later in (-1, 0, 1, 12)}
    capture_ends = (s for s, c in enumerate(commands) if counts[s] == 2 and c.solution.window.stages[0].index == 1)
    kept.add(next(s for s in capture_ends if commands[s].plan.switch_times[0] - commands[s].time < 2.7))
    return kept


def solve_of(mission: str, sample: int, command: Command) -> RecordedSolve:
    """Return what is kept of a command."""
    solution = command.solution
    return RecordedSolve(mission, sample, solution.window, solution.guess, solution.guess_duals, solution.warm)


def main() -> None:
    """Write the file."""
    arrays = dict[str, np.ndarray]()
    for mission, task in MISSIONS.items():
        commands = stepped(task()).commands
        for sample in sorted(chosen(mission, commands)):
            arrays |= solve_of(mission, sample, commands[sample]).save()
    np.savez_compressed(FILE, **arrays)


if __name__ == "__main__":
    main()
