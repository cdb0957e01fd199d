"""Arguments of the public functions that are wrong: each is one error that says what was expected."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import psmpc_cli as psmpc
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.load import Task

N = 9
"""Velocity coordinates of the planar dual arm, and of the free flyer with its arm."""

Controllers = Callable[[str], psmpc.Controller]


@dataclass(frozen=True)
class Api:
    """What the calls of the table need.

    Attributes:
        task: The transport task on a coarse mesh.
        controllers: By name, controllers of a planar robot, of a spatial one, and of one beside an object with a mass,
            each after its first sample.
        command: That of the planar one.
        run: A run of two samples.
        folder: For files.
    """

    task: Task
    controllers: Mapping[str, psmpc.Controller]
    command: psmpc.Command
    run: psmpc.Run
    robot: RobotModel
    folder: Path

    def step(
        self, time: Any = 0.1, state: Any = None, pose: Any = None, holding: Any = None, of: str = "planar"
    ) -> psmpc.Command:
        """A second sample, at rest if nothing else is said."""
        controller = self.controllers[of]
        return controller.step(time, at_rest(controller) if state is None else state, pose, holding)


def at_rest(controller: psmpc.Controller) -> psmpc.State:
    model = controller.problem.model
    return psmpc.State(model.neutral, np.zeros(model.n))


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Api:
    coarse = {"controller.nodes": 8}
    task = psmpc.load_task("transport", set=coarse)
    names = {"planar": "transport", "spatial": "fly_and_point", "object": "catch_drifting", "turning": "catch_tumbling"}
    interpreted = {**coarse, "solver.compiled": False}
    controllers = {key: psmpc.Controller(psmpc.load_task(name, set=interpreted)) for key, name in names.items()}
    commands = {key: controller.step(0.0, at_rest(controller)) for key, controller in controllers.items()}
    run = psmpc.simulate(psmpc.load_task("transport", set={**coarse, "plant.kind": "ideal", "time_limit": 0.2}))
    folder = tmp_path_factory.mktemp("files")
    return Api(task, controllers, commands["planar"], run, psmpc.load_robot("planar_dual_arm"), folder)


NAN = float("nan")

CASES: dict[str, tuple[Callable[[Api], object], str]] = {
    # a state
    "state of texts": (lambda api: psmpc.State(["a"] * N, np.zeros(N)), r"State.Q: .*vector of numbers"),
    "state of digits": (lambda api: psmpc.State(["1"] * N, np.zeros(N)), r"State.Q: .*vector of numbers"),
    "state of nothing": (lambda api: psmpc.State(None, np.zeros(N)), r"State.Q: found None"),
    "state of truths": (lambda api: psmpc.State(np.zeros(N, bool), np.zeros(N)), r"State.Q: .*of bool"),
    "complex state": (lambda api: psmpc.State(np.zeros(N, complex), np.zeros(N)), r"State.Q: .*complex128"),
    "state of a matrix": (lambda api: psmpc.State(np.zeros((1, N)), np.zeros(N)), r"State.Q: .*\(1, 9\).*vector"),
    "state of a number": (lambda api: psmpc.State(np.zeros(N), 0.0), r"State.v: found 0.0"),
    "ragged state": (lambda api: psmpc.State(np.zeros(N), [[1], [1, 2]]), r"State.v: .*list of 2 entries"),
    "state with nothing inside": (lambda api: psmpc.State(np.zeros(N), [None] * N), r"State.v: .*vector of numbers"),
    # a sample of the controller
    "array as state": (lambda api: api.step(state=np.zeros(2 * N)), r"state: .*array \(18,\).*State\(Q, v\)"),
    "pair as state": (lambda api: api.step(state=(np.zeros(N), np.zeros(N))), r"state: found a tuple.*State\(Q, v\)"),
    "short Q": (lambda api: api.step(state=psmpc.State(np.zeros(8), np.zeros(N))), r"Q \(8,\).*expected Q \(9,\)"),
    "short v": (lambda api: api.step(state=psmpc.State(np.zeros(N), np.zeros(8))), r"v \(8,\).*v \(9,\)"),
    "one coordinate": (lambda api: api.step(state=psmpc.State([0.0], [0.0])), r"Q \(1,\).*planar_dual_arm"),
    "another robot's state": (
        lambda api: api.step(state=at_rest(api.controllers["spatial"])),
        r"Q \(10,\) and v \(9,\), expected Q \(9,\) and v \(9,\) of planar_dual_arm",
    ),
    "state of the plane in space": (
        lambda api: api.step(state=psmpc.State(np.zeros(N), np.zeros(N)), of="spatial"),
        r"Q \(9,\).*Q \(10,\) and v \(9,\)",
    ),
    "quaternion of length 0": (
        lambda api: api.step(state=psmpc.State(np.zeros(N + 1), np.zeros(N)), of="spatial"),
        r"state: .*length 0, expected a unit quaternion w, x, y, z",
    ),
    "quaternion of length 2": (
        lambda api: api.step(state=psmpc.State(np.r_[0, 0, 0, 2, np.zeros(6)], np.zeros(N)), of="spatial"),
        r"state: .*length 2, expected a unit quaternion",
    ),
    "no time": (lambda api: api.step(None), r"time: found None, expected a finite number up to"),
    "time as text": (lambda api: api.step("0.1"), r"time: found the text \"0.1\""),
    "time that is true": (lambda api: api.step(True), r"time: found True"),
    "time as array": (lambda api: api.step(np.array([0.1])), r"time: found an array \(1,\)"),
    "complex time": (lambda api: api.step(0.1j), r"time: .*finite number"),
    "time without end": (lambda api: api.step(10**400), r"time: found 1000.*a finite number"),
    "time not a number": (lambda api: api.step(NAN), r"time: found nan, expected a finite number"),
    "infinite time": (lambda api: api.step(np.inf), r"time: found inf, expected a finite number"),
    "time that stands still": (lambda api: api.step(0.0), r"time: found 0 s after 0 s.*after the sample before"),
    "time that goes back": (lambda api: api.step(-0.1), r"time: found -0.1 s after 0 s"),
    "pose without an object": (lambda api: api.step(pose=np.zeros(3)), r"object_pose: .*expected none.*no object"),
    "pose of the plane in space": (lambda api: api.step(pose=np.zeros(3), of="turning"), r"\(3,\).*quaternion.*\(7,\)"),
    "pose in space in the plane": (lambda api: api.step(pose=np.zeros(7), of="object"), r"\(7,\).*x, y, angle \(3,\)"),
    "pose as text": (lambda api: api.step(pose="here", of="object"), r"object_pose: found the text \"here\""),
    "pose as matrix": (lambda api: api.step(pose=np.eye(3), of="object"), r"object_pose: .*\(3, 3\)"),
    "report without an object": (lambda api: api.step(holding={}), r"holding: .*expected none.*no object"),
    "report of a stranger": (lambda api: api.step(holding={"arm_3": True}, of="object"), r"holding: .*arm_1, arm_2"),
    "reports in a list": (lambda api: api.step(holding=[True], of="object"), r"holding: .*a mapping of arm_1, arm_2"),
    "report of a number": (lambda api: api.step(holding={"arm_1": 1}, of="object"), r"'arm_1'.*True or False"),
    "pose without attitude": (lambda api: api.step(pose=np.zeros(7), of="turning"), r"object_pose: .*unit quaternion"),
    # a command
    "force of an array": (lambda api: api.command.force(0.0, np.zeros(18)), r"state: .*State\(Q, v\)"),
    "force of another robot": (
        lambda api: api.command.force(0.0, at_rest(api.controllers["spatial"])),
        r"Q \(10,\).*of planar_dual_arm",
    ),
    "force at no time": (lambda api: api.command.force(NAN, at_rest(api.controllers["planar"])), r"time: found nan"),
    # a controller
    "controller of a name": (lambda api: psmpc.Controller("transport"), r"task: .*\"transport\".*from load_task"),
    "controller of nothing": (lambda api: psmpc.Controller(None), r"task: found None, expected a Task"),
    "controller of a spec": (lambda api: psmpc.Controller(api.task.spec), r"task: .*TaskSpec, expected a Task"),
    "solver by name": (lambda api: psmpc.Controller(api.task, "sqp"), r"solver: .*\"sqp\", expected a Solver"),
    # a task, a robot
    "task of a number": (lambda api: psmpc.load_task(3), r"task: found 3, expected .*mapping of keys"),
    "feasibility of a number": (
        lambda api: psmpc.load_task("transport", feasibility=0),
        r"feasibility: found 0, expected True or False",
    ),
    "no task": (lambda api: psmpc.load_task(None), r"task: found None"),
    "task of a list": (lambda api: psmpc.load_task(["transport"]), r"task: found a list of 1 entry"),
    "task of a task": (lambda api: psmpc.load_task(api.task), r"task: found a value of type Task"),
    "task that has itself": (lambda api: psmpc.load_task(within_itself()), r"mapping"),
    "task without end": (lambda api: psmpc.load_task(nested(5000)), r"expected numbers, texts"),
    "task of a function": (lambda api: psmpc.load_task({"robot": print}), r"expected numbers, texts"),
    "one change as text": (
        lambda api: psmpc.load_task("transport", set="controller.nodes=8"),
        r"set: .*\"controller.nodes=8\".*sequence of texts",
    ),
    "changes as number": (lambda api: psmpc.load_task("transport", set=8), r"set: found 8, expected a mapping"),
    "change as number": (lambda api: psmpc.load_task("transport", set=[8]), r"set: found 8, expected a mapping"),
    "change of a number": (lambda api: psmpc.load_task("transport", set={8: 8}), r"set: found 8, expected a mapping"),
    "change to a function": (
        lambda api: psmpc.load_task("transport", set={"controller.nodes": print}),
        r"expected numbers, texts",
    ),
    "robot of a mapping": (lambda api: psmpc.load_robot({"name": "r"}), r"robot: .*mapping of 1 key"),
    "no robot": (lambda api: psmpc.load_robot(None), r"robot: found None, expected the name of a robot"),
    "log that is a number": (lambda api: psmpc.read_run(3), r"path: found 3, expected the path of a file"),
    # a robot's methods
    "poses of a short Q": (lambda api: api.robot.poses(np.zeros(8)), r"Q: .*\(8,\).*\(9,\)"),
    "poses of a number": (lambda api: api.robot.poses(0.0), r"Q: found 0.0"),
    "mass matrix of one number": (lambda api: api.robot.mass_matrix([0.0]), r"Q: .*expected numbers \(9,\)"),
    "mass matrix of texts": (lambda api: api.robot.mass_matrix(["0"] * N), r"Q: found a list of 9 entries"),
    "momentum of a short v": (lambda api: api.robot.momentum(np.zeros(N), np.zeros(8)), r"v: .*\(8,\)"),
    "energy of one number": (lambda api: api.robot.kinetic_energy(np.zeros(N), [1.0]), r"v: .*expected numbers \(9,\)"),
    "mass matrix of a mass": (
        lambda api: api.robot.mass_matrix(np.zeros(N), 3),
        r"parameters: found 3, expected Inert",
    ),
    "mass matrix of another robot's bodies": (
        lambda api: api.robot.mass_matrix(np.zeros(N), api.controllers["turning"].problem.model.nominal),
        r"w: found an array .*expected numbers \(32,\)",
    ),
    "frames of a short Q": (lambda api: api.robot.body_frames(np.zeros(8)), r"Q: .*\(8,\).*9"),
    # a run
    "simulation of a name": (lambda api: psmpc.simulate("transport"), r"task: .*\"transport\".*from load_task"),
    "simulation of a mapping": (lambda api: psmpc.simulate({"robot": "r"}), r"task: .*from load_task"),
    "log of a number": (lambda api: psmpc.simulate(api.task, 3), r"path: found 3, expected the path of a file"),
    "log without a name": (lambda api: psmpc.simulate(api.task, ""), r"path: found the text \"\""),
    "watcher that is none": (lambda api: psmpc.simulate(api.task, watch=1), r"watch: found 1, expected a function"),
    "stage by name": (lambda api: psmpc.simulate(api.task, until="capture"), r"until: .*whole number from 0 to 3"),
    "stage that is not": (lambda api: psmpc.simulate(api.task, until=4), r"until: found 4, .*from 0 to 3"),
    "overwriting as text": (lambda api: psmpc.simulate(api.task, force="no"), r"force: .*True or False"),
    # figures and pages
    "figure of a number": (lambda api: psmpc.plot(3, "states"), r"run: found 3, expected a Run, the path"),
    "figure of a path without a name": (lambda api: psmpc.plot("", "states"), r"run: found the text \"\""),
    "figure of a list": (lambda api: psmpc.plot([api.run], "states"), r"run: found a list of 1 entry, expected a Run"),
    "figure of no run": (lambda api: psmpc.plot({}, "states"), r"run: .*at least one of them"),
    "figure of numbers": (lambda api: psmpc.plot({"psmpc": 3}, "states"), r"\"psmpc\": found 3, expected a Run, or"),
    "figures as list": (lambda api: psmpc.plot(api.run, ["states"]), r"figure: .*name of a figure"),
    "page of a list": (lambda api: psmpc.view([api.run]), r"run: found a list of 1 entry, expected a Run"),
    "page of no run": (lambda api: psmpc.view({}), r"run: .*at least one of them"),
    "page of numbers": (lambda api: psmpc.view({1: api.run}), r"run: found 1"),
    "page without a file": (lambda api: psmpc.view(api.run).save(None), r"path: found None"),
    # studies
    "controllers as text": (lambda api: psmpc.compare(api.task, "psmpc"), r"controllers: .*list of names"),
    "controllers as numbers": (
        lambda api: psmpc.compare(api.task, [1]),
        r"controllers: found 1, expected a list of names",
    ),
    "comparison of a number": (lambda api: psmpc.compare(3), r"task: found 3"),
    "comparison in a number": (lambda api: psmpc.compare(api.task, path=3), r"path: found 3"),
    "comparison without processes": (lambda api: psmpc.compare(api.task, jobs=0), r"jobs: found 0, .*>= 1"),
    "sweep over a list": (lambda api: psmpc.sweep(api.task, ["seed"]), r"values: found a list"),
    "sweep over a number": (lambda api: psmpc.sweep(api.task, {"seed": 1}), r"values: .*lists of values"),
    "sweep over a text": (lambda api: psmpc.sweep(api.task, {"controller": "psmpc"}), r"values: .*lists of values"),
    "sweep over functions": (lambda api: psmpc.sweep(api.task, {"seed": [print]}), r"expected numbers, texts"),
    "sweep in half processes": (lambda api: psmpc.sweep(api.task, {"seed": [1]}, jobs=0.5), r"jobs: found 0.5"),
    "sweep on a number": (lambda api: psmpc.sweep(api.task, {"seed": [1]}, dask=8786), r"dask: found 8786"),
    "sweep watched by 1": (lambda api: psmpc.sweep(api.task, {"seed": [1]}, watch=1), r"watch: found 1"),
    "minus three runs": (lambda api: psmpc.monte_carlo(api.task, -3), r"runs: found -3, .*from 1 to 100000"),
    "runs without end": (lambda api: psmpc.monte_carlo(api.task, 10**12), r"runs: .*from 1 to 100000"),
    "runs as text": (lambda api: psmpc.monte_carlo(api.task, "3"), r"runs: found the text \"3\""),
    "resumed as text": (lambda api: psmpc.monte_carlo(api.task, 3, resume="no"), r"resume: .*True or False"),
}


def within_itself() -> dict[str, Any]:
    keys = dict[str, Any]()
    keys["robot"] = keys
    return keys


def nested(levels: int) -> dict[str, Any]:
    keys = dict[str, Any]()
    for _ in range(levels):
        keys = {"robot": keys}
    return keys


@pytest.mark.parametrize(("call", "words"), CASES.values(), ids=list(CASES))
def test_a_wrong_argument_is_an_error_that_says_what_was_expected(
    api: Api, call: Callable[[Api], object], words: str
) -> None:
    with pytest.raises((psmpc.InputError, psmpc.SpecError), match=words) as caught:
        call(api)
    assert "expected" in str(caught.value)


@pytest.fixture
def controller(api: Api) -> psmpc.Controller:
    """A controller after its first sample."""
    controller = psmpc.Controller(api.task)
    controller.step(0.0, at_rest(controller))
    return controller


def test_a_sample_that_was_rejected_changes_nothing(api: Api, controller: psmpc.Controller) -> None:
    other = psmpc.Controller(api.task)
    other.step(0.0, at_rest(other))
    with pytest.raises(psmpc.InputError):
        other.step(0.1, psmpc.State(np.zeros(8), np.zeros(8)))
    with pytest.raises(psmpc.InputError):
        other.step(0.1, at_rest(other), np.zeros(3))
    np.testing.assert_array_equal(controller.step(0.1, at_rest(controller)).u, other.step(0.1, at_rest(controller)).u)


def test_numbers_that_are_not_finite_are_not_measured(controller: psmpc.Controller) -> None:
    for sample, missing in enumerate(([NAN] * N, [np.inf] * N, [0.0] * 8 + [NAN]), start=1):
        assert "unmeasured" in controller.step(0.1 * sample, psmpc.State(missing, np.zeros(N))).events
    assert "unmeasured" in controller.step(0.4, psmpc.State(np.zeros(N), [NAN] * N)).events


@pytest.mark.parametrize(("time", "gap"), [(0.1, False), (0.05, False), (0.1005, False), (0.15, True), (60.0, True)])
def test_samples_that_are_missing_are_an_event(controller: psmpc.Controller, time: float, gap: bool) -> None:
    """The sample time is 0.1 s."""
    command = controller.step(time, at_rest(controller))
    assert ("gap" in command.events) == gap
    assert np.isfinite(command.u).all()


def test_the_first_sample_is_at_any_time(api: Api) -> None:
    controller = psmpc.Controller(api.task)
    assert "gap" not in controller.step(1e4, at_rest(controller)).events


def test_a_state_is_of_whole_numbers_too_and_keeps_its_numbers() -> None:
    Q = np.zeros(N)
    state = psmpc.State(Q, [0] * N)
    Q += 1
    np.testing.assert_array_equal(state.vector, np.zeros(2 * N))


def test_what_is_known_prints_in_a_line() -> None:
    """Of the state, the delay, the load and the robot's own masses, none as matrices."""
    task = psmpc.load_task(
        "catch_drifting",
        {"controller.nodes": 8, "controller.masses": "estimated", "object.grasp.known": "estimated"},
    )
    controller = psmpc.Controller(task)
    command = controller.step(0.0, at_rest(controller))
    estimate = controller.memory.estimate
    assert repr(command.load) == (
        "<LoadEstimate: mass [kg] 20 (deviation 10), moments of inertia [kg m^2] 2.67 (deviation 1.3)>"
    )
    assert repr(command.inertia).startswith("<InertiaEstimate of 7 bodies: 1.000 to 1.000 of the described masses")
    assert repr(estimate).startswith("<Estimate at 0 s: State(Q=[0. 0. 0. ")
    assert repr(estimate.delay).startswith("<DelayEstimate: ") and "array" not in repr(estimate)
    assert repr(estimate.commands) == "<SentCommands: 1 from 0 s to 0 s, ticks of 0.001 s>"


def test_a_pose_that_is_not_finite_is_predicted(api: Api) -> None:
    for pose in (np.full(3, NAN), [0.0, NAN, 0.0], None):
        controller = psmpc.Controller(api.controllers["object"].problem)
        assert np.isfinite(controller.step(0.0, at_rest(controller), pose).u).all()


@pytest.mark.slow
def test_studies_take_paths_as_texts(tmp_path: Path) -> None:
    task = psmpc.load_task("transport", set={"controller.nodes": 8, "plant.kind": "ideal", "time_limit": 0.2})
    path = str(tmp_path / "sweep.h5")
    psmpc.sweep(task, {"seed": [1]}, path, jobs=1)
    assert Path(path).is_file()


def test_figures_and_pages_take_the_paths_of_logs(api: Api) -> None:
    log = api.folder / "run.h5"
    api.run.save(log)
    of_run = psmpc.plot(api.run, "states")
    for path in (log, str(log)):
        assert len(psmpc.plot(path, "states").axes) == len(of_run.axes)
        assert psmpc.view(path).html == psmpc.view(api.run).html
    assert psmpc.view({"one": log, "other": api.run}).html == psmpc.view({"one": api.run, "other": api.run}).html


def test_figures_and_pages_take_the_path_of_a_comparison(api: Api) -> None:
    path = api.folder / "compared.h5"
    runs = psmpc.compare(api.run.task, ["psmpc"], path, jobs=1)
    assert psmpc.view(path).html == psmpc.view(runs).html
    assert psmpc.plot(path, "overlay").axes


def test_a_path_that_leads_to_no_log_is_an_error_of_that_file(api: Api) -> None:
    for call in (lambda: psmpc.plot("none.h5", "states"), lambda: psmpc.view({"psmpc": Path("none.h5")})):
        with pytest.raises(psmpc.LogError, match=r"none\.h5: found no such file, expected a log"):
            call()


SHOWN: dict[str, tuple[Callable[[Api], object], str]] = {
    "run": (lambda api: api.run, r"<Run of transport under psmpc: 2 samples, 4 stages; time limit of 0.2 s reached>"),
    "motion": (lambda api: api.run.motion, r"<Motion: 3 times from 0 s to 0.2 s>"),
    "summary": (lambda api: api.run.summary(), r"<Summary of 4 stages over 0.2 s, did not succeed: time limit of .*>"),
    "task": (lambda api: api.task, r"<Task transport: 4 stages, robot planar_dual_arm, controller psmpc>"),
    "text of a task": (lambda api: api.task.source, r"<Document .*transport.yaml: \d+ lines>"),
    "robot": (lambda api: api.robot, r"<RobotModel planar_dual_arm: in the plane, 7 bodies, 9 degrees of freedom>"),
    "problem": (lambda api: api.run.problem, r"<Problem of transport: 4 stages, 9 degrees of freedom>"),
    "stage": (
        lambda api: api.run.problem.stages[1],
        r"<Stage capture: index 1, in task space, priority 100, 9 numbers",
    ),
    "limits": (lambda api: api.run.problem.stages[0].limits, r"<Limits of 9 coordinates: 9 of position, .* of acc"),
    "controller": (
        lambda api: psmpc.Controller(api.task),
        r"<Controller psmpc for transport: 4 .*before its first samp",
    ),
    "controller in a run": (lambda api: api.controllers["spatial"], r"<Controller psmpc for .* at 0 s>"),
    "memory": (lambda api: api.controllers["planar"].memory, r"<Memory of 0 s: stages 0 to 0 in the window>"),
    "state": (lambda api: psmpc.State(np.zeros(40), np.full(40, np.pi)), r"State\(Q=\[0. 0. .*, v=\[3.1416 .*\]\)"),
    "command": (lambda api: api.command, r"<Command at 0 s: 100 ticks of 9 accelerations, stages approach"),
    "placed stage": (lambda api: api.command.stage, r"<PlacedStage approach: index 0, in joint space, priority 1, "),
    "plan": (lambda api: api.command.plan, r"<Plan from 0 s to 4 s: 8 intervals of 9 accelerations, 0 switches>"),
    "window": (lambda api: api.command.solution.window, r"<Window from 0 s to 4 s: approach \(8 nodes\)>"),
    "solution": (lambda api: api.command.solution, r"<Solution of approach: \w+ after \d+ iterations, J [\d.]+>"),
    "page": (lambda api: psmpc.view(api.run), r"<Page: \d+ characters of HTML>"),
    "sweep": (
        lambda api: psmpc.sweep(api.run.task, {"seed": [1, 2]}, jobs=1),
        r"<Results of a sweep over keys: \d+ quantities over .*seed \(2\)",
    ),
}


@pytest.mark.parametrize(("build", "expected"), SHOWN.values(), ids=list(SHOWN))
def test_what_is_public_is_shown_on_one_line(api: Api, build: Callable[[Api], object], expected: str) -> None:
    shown = repr(build(api))
    assert re.match(expected, shown)
    assert "\n" not in shown
    assert len(shown) < (600 if "State" in expected else 200)


def test_a_sample_is_shown_on_one_line(api: Api) -> None:
    samples: list[Any] = []
    psmpc.simulate(api.run.task, watch=samples.append)
    assert repr(samples[1]) == "<Sample 1 at 0.1 s: stage approach, 9 coordinates>"
    assert repr(samples[1].ticks) == "<Ticks from 0.1 s to 0.2 s: 100 ticks of 9 forces>"
