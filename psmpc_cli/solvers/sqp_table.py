"""The table of iterations of sequential quadratic programming, in the manner of IPOPT's and fatrop's."""

from psmpc_cli.solvers.qp_solution import QpSolution, QpStatus
from psmpc_cli.solvers.sqp_iterate import Iterate

HEADING = "iter       objective   inf_pr    ||d||    alpha  qp"


class IterationTable:
    """Watches one solve and keeps a line an iteration, the guess first.

    Its columns: number of the iteration; objective, J over the window's largest priority; largest violation of a
    constraint; largest component of the program's full step [m, rad, m/s, rad/s, s]; share of the step that was taken,
    0 if none of it counted; interior-point iterations of the program.
    """

    def __init__(self) -> None:
        self.lines: list[str] = [HEADING]

    def take(self, count: int, iterate: Iterate, qp: QpSolution | None) -> None:
        """Add the line of an iteration: where it led, and the program whose step it took, if it has one."""
        line = f"{count:4d} {iterate.at.objective:15.8e} {iterate.violation.worst:8.2e}"
        if qp is None:
            line += f" {'-':>8} {'-':>8} {'-':>3}"
        elif qp.status is QpStatus.SOLVED:
            line += f" {iterate.step:8.2e} {iterate.share:8.2e} {qp.iterations:3d}"
        else:
            line += f" {'-':>8} {'-':>8} {qp.iterations:3d}  {qp.status.value}"
        self.lines.append(line)
