"""Commands that run a task many times, on a task of two seconds."""

import re
from pathlib import Path

import pytest

from psmpc_cli.figures.registry import figures_of
from psmpc_cli.logs.results import read_results
from psmpc_cli.logs.run import read_comparison, read_run
from psmpc_cli.logs.schema import PARETO, SWEEP
from psmpc_cli.studies.runner import COMPUTED, SHARED

from .command import Psmpc, Ran

ROW = re.compile(r"(?P<label>\S.*?) {2,}(?P<cells>.+)")

NOISY = ("task.yaml", "--set", "uncertainty.noise.position=1e-3", "--jobs", "1")


def rows(ran: Ran) -> dict[str, list[str]]:
    """The cells of a comparison's table, by the label of their row."""
    found = (ROW.fullmatch(line) for line in ran.stdout.splitlines())
    return {match["label"]: re.split(" {2,}", match["cells"].strip()) for match in found if match}


@pytest.mark.slow
def test_a_comparison_is_one_table_one_file_and_figures(psmpc: Psmpc) -> None:
    changes = ("--set", "log.plans=false", "--set", "controller.one_stage=as_published")
    ran = psmpc("compare", "task.yaml", "--jobs", "1", "--controllers", "psmpc,smpc,hard", *changes)
    assert ran.code == 0
    lines = ran.stderr.splitlines()
    assert lines[0] == "0 of 3 runs" and "3 of 3 runs, hard done" in lines
    assert re.search(r"^2 of 3 runs, smpc done, about \d+ s left$", ran.stderr, re.MULTILINE)
    lines = ran.stdout.splitlines()
    assert lines[0].startswith("recommended: ") and "succeeds in" in lines[0] and "least control effort" in lines[0]
    assert [line.split()[:2] for line in lines[3:6]] == [[name, "succeeded"] for name in ("psmpc", "smpc", "hard")]
    assert max(map(len, lines[1:])) <= 100
    verbose = psmpc("show", "runs/task-comparison.h5", "-v")
    assert sum("Mission succeeded" in line for line in verbose.stdout.splitlines()[1:4]) == 3
    table, logs = rows(verbose), read_comparison(Path("runs/task-comparison.h5"))
    assert list(logs) == ["psmpc", "smpc", "hard"]
    assert all(len(cells) == 3 for label, cells in table.items() if label not in {*logs, "controller"})
    ends = [log.stages["switch_time"][1] for log in logs.values()]
    assert table["back ends [s]"][0] == f"{ends[0]:.2f}"
    assert table["back ends [s]"][2] == f"{ends[2]:.2f} ({ends[2] - ends[0]:+.2f})"
    assert table["go ends [s]"][1].endswith("(=) [0.9]")
    assert table["back actually starts [s]"][0].startswith("early ")
    assert "levels not solved" not in table
    assert "terms: the same weights, tolerances and limits; hard without a planned end" in lines
    assert "psmpc and smpc are the same controller for this task: all its priorities are equal" in lines
    assert {path.stem for path in Path("runs/task-comparison").iterdir()} == set(figures_of("comparison"))
    assert "limits of forces and accelerations: none declared: nothing bounds the largest values above" in lines
    assert psmpc("show", "runs/task-comparison.h5").stdout.splitlines() == lines[:-1]
    path = "runs/task-comparison.h5"
    assert psmpc("plot", path, "--run", "hard", "--only", "shares").stdout == "runs/task-comparison/hard/shares.png\n"
    csv = psmpc("show", path, "--csv", "csv").stdout.splitlines()
    assert csv == [f"csv/{name}/{table}.csv" for name in logs for table in ("samples", "stages")]
    for arguments, word in (
        (("--run", "htmpc"), "psmpc, smpc, hard"),
        (("--animate",), "--run"),
        (("--only", "forces"), "shares"),
    ):
        ran = psmpc("plot", path, *arguments)
        assert (ran.code, ran.stdout) == (2, "")
        assert word in ran.stderr


@pytest.mark.slow
def test_own_settings_are_applied_when_asked_for(psmpc: Psmpc, tmp_path: Path) -> None:
    text = (tmp_path / "task.yaml").read_text()
    (tmp_path / "own.yaml").write_text(f"{text}by_controller: {{hard: {{skills.move.weights.control: 0.5}}}}\n")
    options = ("--jobs", "1", "--controllers", "psmpc,hard", "--no-figures", "--set", "time_limit=0.2", "-q")
    assert psmpc("compare", "own.yaml", *options, "-o", "equal.h5").code == 0
    assert psmpc("compare", "own.yaml", *options, "-o", "own.h5", "--own-settings").code == 0
    for name, weight, terms in (("equal", 1.0, "same weights"), ("own", 0.5, "not equal: skills of")):
        logs = read_comparison(Path(f"{name}.h5"))
        assert logs["psmpc"].task.spec.skills["move"].weights.control == 1.0
        assert logs["hard"].task.spec.skills["move"].weights.control == weight
        assert terms in psmpc("show", f"{name}.h5").stdout


@pytest.mark.slow
def test_a_failed_mission_of_a_comparison_is_a_result(psmpc: Psmpc) -> None:
    far = "monitors=[{name: far apart, quantity: distance, of: [arm_1, arm_2], during: back, at_least: 9}]"
    changes = ("--set", far, "--set", "stages.go.priority=50")
    ran = psmpc("compare", "task.yaml", "--jobs", "1", "--controllers", "hard", "--no-figures", "-o", "a.h5", *changes)
    assert ran.code == 0
    first, second, *_ = ran.stdout.splitlines()
    assert first == "no controller is recommended: the mission succeeded with none of 1"
    assert second.startswith("hard: Mission failed: back met its end condition; monitor did not hold: far apart")
    assert rows(psmpc("show", "a.h5", "-v"))["monitor: far apart"][0].startswith("BROKEN at")
    assert "same controller" not in ran.stdout


def test_missions_that_are_over_at_once_are_compared_without_figures(psmpc: Psmpc, tmp_path: Path) -> None:
    text = (tmp_path / "task.yaml").read_text()
    at_home = text.replace("base: [0.1, 0, 0], arm_1: [0.02,", "base: [0, 0, 0], arm_1: [0,")
    only = at_home[: at_home.index("  - name: back")]
    (tmp_path / "over.yaml").write_text(f"{only}solver: {{kind: fatrop}}\n")
    assert psmpc("simulate", "over.yaml").code == 0
    ran = psmpc("compare", "over.yaml", "--jobs", "1", "--controllers", "psmpc,hard")
    assert (ran.code, ran.stdout.splitlines()[-1]) == (
        0,
        "logs: runs/over-comparison.h5 (-v prints all that was measured)",
    )
    assert ran.stdout.startswith("recommended: psmpc, whose mission succeeds in 0.0 s, with the least control effort")


@pytest.mark.slow
def test_a_sweep_is_a_table_a_file_and_figures(psmpc: Psmpc) -> None:
    arguments = ("sweep-weights", "task.yaml", "2x2", "--range", "0.1:10", "--jobs", "1")
    ran = psmpc(*arguments)
    assert ran.code == 0
    assert "4 cells: 3 computed, 1 shared" in ran.stdout
    assert "3 of 3 runs" in ran.stderr
    path = Path("runs/task-sweep.h5")
    status = read_results(path, SWEEP)["status"].ravel().tolist()
    assert status == [COMPUTED, COMPUTED, COMPUTED, SHARED]
    assert psmpc("show", str(path)).stdout.splitlines() == ran.stdout.splitlines()[:-1]
    drawn = {figure.name for figure in Path("runs/task-sweep").iterdir()}
    assert psmpc("plot", str(path), "-o", "again").code == 0
    assert {figure.name for figure in Path("again").iterdir()} == drawn
    assert "3 computed" in psmpc("sweep-weights", "2x2", "task.yaml", *arguments[3:], "--resume").stdout
    assert "another sweep" in psmpc("sweep-weights", "3x3", "task.yaml", *arguments[3:], "--resume").stderr


@pytest.mark.slow
def test_draws_and_thresholds_of_a_sweep(psmpc: Psmpc) -> None:
    arguments = ("--jobs", "1", "--no-figures", "-q", "-o", "draws.h5", "--epsilon", "0.5,1e-3")
    assert psmpc("sweep-weights", "task.yaml", "--sampling", "random:2", *arguments) == Ran(0, "", "")
    results = read_results(Path("draws.h5"), SWEEP)
    assert results["omega_1"].shape == (2,)
    assert results["epsilon"].tolist() == [1e-3, 0.5]


@pytest.mark.slow
def test_a_monte_carlo_study_is_a_table_a_file_and_figures(psmpc: Psmpc) -> None:
    ran = psmpc("monte-carlo", *NOISY, "--runs", "2")
    assert ran.code == 0
    assert ran.stdout.startswith("2 of 2 runs succeeded")
    assert "2 of 2 runs" in ran.stderr
    path, figures = Path("runs/task-monte-carlo.h5"), Path("runs/task-monte-carlo")
    assert {figure.stem for figure in figures.iterdir()} == {"success", "runs"}
    assert psmpc("show", str(path)).stdout.splitlines() == ran.stdout.splitlines()[:-1]
    assert psmpc("plot", str(path), "-o", "again", "--only", "runs").code == 0
    assert Path("again/runs.png").read_bytes() == (figures / "runs.png").read_bytes()
    ran = psmpc("monte-carlo", *NOISY, "--runs", "3", "--resume")
    assert ran.code == 0
    assert "1 of 1 runs" in ran.stderr
    assert ran.stdout.startswith("3 of 3 runs succeeded")


@pytest.mark.slow
def test_pareto_fronts_are_a_table_a_file_and_figures(psmpc: Psmpc) -> None:
    quick = ("--points", "3", "--at", "0.3,0.5", "--method", "weighted-sum", "--jobs", "1")
    ran = psmpc("pareto", "task.yaml", *quick, "--log", "run.h5")
    assert ran.code == 0
    answer, heading, *lines = ran.stdout.splitlines()
    assert "at 2 of 2 samples" in answer
    assert all(word in heading for word in ("T0 [s]", "t_s [s]", "J_1 [s]", "J_2 [s]", "hypervolume"))
    assert [line.split()[0] for line in lines[:2]] == ["0.30", "0.50"]
    path = Path("runs/task-pareto.h5")
    assert read_results(path, PARETO)["weighted_J_1"].shape == (2, 3)
    assert [figure.name for figure in Path("runs/task-pareto").iterdir()] == ["front.png"]
    assert psmpc("show", str(path)).stdout.splitlines() == ran.stdout.splitlines()[:-1]
    assert psmpc("plot", str(path), "-o", "again", "--format", "svg").stdout == "again/front.svg\n"
    assert "pareto" in psmpc("plot", str(path), "--animate").stderr
    assert read_run(Path("run.h5")).has_plans
    assert psmpc("pareto", "run.h5", *quick, "--no-figures", "-o", "again.h5", "-q") == Ran(0, "", "")
    again, first = read_results(Path("again.h5"), PARETO), read_results(path, PARETO)
    assert (again["weighted_J_1"] == first["weighted_J_1"]).all()


@pytest.mark.slow
def test_a_bench_is_a_table_of_this_machine(psmpc: Psmpc) -> None:
    small = ("--set", "stages[0].target.base=[0.3, 0, 0]", "--nodes", "5", "--solvers", "sqp,piqp", "--repeat", "1")
    ran = psmpc("bench", "task.yaml", *small)
    assert ran.code == 0
    first = [line.split()[:3] for line in ran.stdout.splitlines()[1:6]]
    ways = [["5", name, start] for name in ("sqp", "piqp") for start in ("warm", "cold")]
    assert first == [*ways, ["5", "reference", "cold"]]
    assert "1 of 1 meshes, 5 nodes a stage, 6 windows done" in ran.stderr
