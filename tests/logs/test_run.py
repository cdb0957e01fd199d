import csv
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from psmpc_cli.errors import InputError, LogError
from psmpc_cli.logs.conditions import ALWAYS
from psmpc_cli.logs.run import Run, read_run
from psmpc_cli.logs.schema import FORMAT_VERSION, OLDEST_FORMAT, SCHEMA, columns
from psmpc_cli.logs.write import Header, LogWriter

from ..synthetic_logs import Story, story_among_obstacles, write_story
from .synthetic_samples import COORDINATES, HEADER, LEAN, STAGES, TICKS, record

SAMPLES = 3


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "log.h5"
    with LogWriter(path, HEADER) as log:
        for k in range(SAMPLES):
            log.write(record(k))
    return path


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "log.h5"
    with LogWriter(path, HEADER) as log:
        log.write(record(0))
    return path.read_bytes()


def refusal(path: Path) -> str:
    with pytest.raises(LogError) as refused:
        read_run(path)
    assert refused.value.exit_code == 2
    assert "\n" not in str(refused.value)
    return str(refused.value)


def make_nothing(path: Path) -> None:
    """Leave it missing."""


def make_foreign(path: Path) -> None:
    h5py.File(path, "w").close()


REFUSED: list[tuple[str, Callable[[Path], object]]] = [
    ("found no such file", make_nothing),
    ("found a directory", Path.mkdir),
    ("found an empty file", Path.touch),
    ("found no HDF5 file", lambda path: path.write_text("robot: planar_dual_arm\n")),
    ("found an HDF5 file of another program", make_foreign),
    ("found no regular file", lambda path: path.symlink_to("/dev/null")),
]


@pytest.mark.parametrize(("found", "make"), REFUSED, ids=[found for found, _ in REFUSED])
def test_what_is_no_log_is_named(tmp_path: Path, found: str, make: Callable[[Path], object]) -> None:
    make(tmp_path / "log.h5")
    expected = f"{tmp_path / 'log.h5'}: {found}, expected a log written by psmpc simulate"
    assert refusal(tmp_path / "log.h5") == expected


def test_other_version_is_named(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"], file.attrs["psmpc_version"] = 99, "7.0"
    assert refusal(path) == (
        f"{path}: found log format 99, written by psmpc 7.0; this version reads formats {OLDEST_FORMAT} to "
        f"{FORMAT_VERSION}: read it with that version, or run the experiment again"
    )


def test_what_older_logs_do_not_have_is_unknown(path: Path) -> None:
    newer = [column.path for column in SCHEMA if column.since > OLDEST_FORMAT]
    run = read_run(path)
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = OLDEST_FORMAT
        for dataset in newer:
            del file[dataset]
    older = read_run(path)
    assert newer
    for dataset in newer:
        assert older[dataset].shape == run[dataset].shape and np.isnan(older[dataset]).all()
    assert np.array_equal(older["state/Q"], run["state/Q"])


@pytest.mark.parametrize("name", ["finished", "end_reason", "task_yaml", "robot_yaml", "task_name", "stuck"])
def test_missing_attribute_is_named(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as file:
        del file.attrs[name]
    message = refusal(path)
    assert message.startswith(f"{path}: found an HDF5 file that is cut off or damaged (") and name in message


@pytest.mark.parametrize("name", ["time", "state/Q", "stage", "stages/name", "final/end_time", "monitors"])
def test_missing_dataset_is_damage(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as file:
        del file[name]
    assert refusal(path).startswith(f"{path}: found an HDF5 file that is cut off or damaged (")


@given(st.floats(0, 1, exclude_max=True))
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_log_that_is_cut_off_anywhere_is_refused(tmp_path: Path, content: bytes, part: float) -> None:
    path = tmp_path / "log.h5"
    path.write_bytes(content[: int(part * len(content))])
    message = refusal(path)
    assert any(f": found {what}" in message for what in ("an empty file", "no HDF5 file", "an HDF5 file that is cut"))


def test_plans_are_optional(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.h5", LEAN) as log:
        log.write(record(0))
    with pytest.raises(LogError, match=r"found no plans, expected the log of a task with log: \{plans: true\}"):
        read_run(tmp_path / "log.h5").plan("solution", 0)


@pytest.mark.parametrize(
    ("dataset", "why"),
    [
        ("levels/cost", "logs have it with controller htmpc"),
        ("grasp/pull", "logs have it where the object has a mass"),
        ("force/G", "no log has one"),
    ],
)
def test_a_dataset_that_the_log_lacks_has_a_reason(path: Path, dataset: str, why: str) -> None:
    with pytest.raises(KeyError, match=f"log.h5: found no dataset {dataset}; {why}"):
        read_run(path)[dataset]


@pytest.mark.parametrize("sample", [-1, SAMPLES])
def test_a_sample_that_the_log_lacks_has_no_plan(path: Path, sample: int) -> None:
    with pytest.raises(LogError, match=f"found no sample {sample}, expected one from 0 to {SAMPLES - 1}"):
        read_run(path).plan("solution", sample)


def log_of(path: Path, header: Header = HEADER) -> Run:
    with LogWriter(path, header) as log:
        for k in range(3):
            log.write(record(k, count=2))
    return read_run(path)


def table(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(newline="", encoding="utf-8") as file:
        heading, *rows = csv.reader(file)
    return heading, rows


def test_samples_have_a_named_column_for_every_number(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.h5")
    log.to_csv(tmp_path / "tables")
    heading, rows = table(tmp_path / "tables" / "samples.csv")
    assert (
        len(heading) == len(set(heading)) == 1 + sum(log[c.path].size // 3 for c in columns("time") if c.only is ALWAYS)
    )
    assert heading[:2] == ["time [s]", "state/Q/base.x [m]"]
    assert {"window/instants/d [s]", "balance/momentum/angular [N m s]", "solver/wall_time [s]", "window/first"} <= set(
        heading
    )
    for name, values in (
        ("state/Q/arm_1.1 [rad]", log["state/Q"][:, 2]),
        ("window/instants/a [s]", log["window/instants"][:, 0]),
        ("solver/wall_time [s]", log["solver/wall_time"]),
    ):
        assert [float(line[heading.index(name)]) for line in rows] == values.tolist()
    assert [line[heading.index("solver/status")] for line in rows] == ["optimal", "iteration_limit", "optimal"]


def test_stages_and_ticks_are_tables_too(tmp_path: Path) -> None:
    files = log_of(tmp_path / "log.h5").to_csv(tmp_path)
    assert [path.name for path in files] == ["samples.csv", "stages.csv", "ticks.csv"]
    heading, rows = table(files[1])
    assert [row[heading.index("name")] for row in rows] == list(STAGES)
    assert heading[-2:] == ["actual_start_by_epsilon/0.001 [s]", "actual_start_by_epsilon/0.1 [s]"]
    heading, rows = table(files[2])
    units = {"Q": ("m", "rad"), "Qdot": ("m/s", "rad/s"), "F": ("N", "N m")}
    columns_of = [
        f"{name}/{row} [{of_length if row.endswith(('x', 'y')) else of_angle}]"
        for name, (of_length, of_angle) in units.items()
        for row in COORDINATES
    ]
    assert heading == ["time [s]", *columns_of]
    assert len(rows) == 3 * TICKS


def test_no_table_of_ticks_without_ticks(tmp_path: Path) -> None:
    assert [path.name for path in log_of(tmp_path / "log.h5", LEAN).to_csv(tmp_path)] == [
        "samples.csv",
        "stages.csv",
    ]


def test_a_table_has_a_column_for_each_element_of_an_array_of_three_dimensions(tmp_path: Path) -> None:
    story = Story(**story_among_obstacles(), last=0.8)
    run = read_run(write_story(tmp_path / "log.h5", story))
    run.to_csv(tmp_path)
    headings, rows = table(tmp_path / "samples.csv")
    for pair, axis in ((0, 3), (7, 5)):
        name = f"clearance/points/{run['clearance/pair'][pair]}/{run['clearance/point'][axis]} [m]"
        column = [float(row[headings.index(name)]) for row in rows]
        assert column == run["clearance/points"][:, pair, axis].tolist()
    assert len(headings) == len(set(headings)) == len(rows[0])


def test_tables_are_overwritten_with_force_only(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.h5", LEAN)
    (tmp_path / "stages.csv").write_text("mine")
    with pytest.raises(InputError) as refused:
        log.to_csv(tmp_path)
    assert str(refused.value).startswith(f"{tmp_path / 'stages.csv'} exists already: ")
    assert "--csv" in str(refused.value) and "--force" in str(refused.value)
    assert (tmp_path / "stages.csv").read_text() == "mine"
    assert not (tmp_path / "samples.csv").exists()
    with pytest.raises(InputError, match="found a text file, expected a CSV table of psmpc"):
        log.to_csv(tmp_path, force=True)
    assert (tmp_path / "stages.csv").read_text() == "mine"
    (tmp_path / "stages.csv").unlink()
    log.to_csv(tmp_path)
    (tmp_path / "stages.csv").write_text("name,priority,edited\n")
    log.to_csv(tmp_path, force=True)
    assert table(tmp_path / "stages.csv")[0][2] == "switch_time [s]"


def test_a_file_is_no_directory_for_tables(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.h5", LEAN)
    with pytest.raises(InputError) as refused:
        log.to_csv(log.path)
    assert str(refused.value).startswith(f"{log.path} is no directory")


def test_samples_are_an_xarray_dataset_with_named_dimensions(tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    log = log_of(tmp_path / "log.h5")
    samples = log.to_xarray()
    assert samples["state/Q"].sel(coordinate="arm_1.1").values.tolist() == log["state/Q"][:, 2].tolist()
    assert samples["window/instants"].sel(stage="b", time=0.1).shape == ()
    assert samples["force/F"].attrs["units"] == "N, N m"


def test_without_xarray_it_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match="pip install xarray"):
        log_of(tmp_path / "log.h5").to_xarray()


@pytest.mark.parametrize(
    ("story", "spans"),
    [
        (Story(ends=(2.0, 3.0, 4.0, 5.0), early={}), [(0, 2, None), (2, 3, None), (3, 4, None), (4, 5, None)]),
        (Story(early={}, last=11.0), [(0, 10, None), (10, 10.8, None)]),
        (Story(last=8.0), [(0, 7.6, None), (pytest.approx(7.6), 7.6, 6.4)]),
    ],
    ids=["finished", "killed", "not reached"],
)
def test_stages_follow_each_other_to_the_end_of_the_run(tmp_path: Path, story: Story, spans: object) -> None:
    run = read_run(write_story(tmp_path / "run.h5", story))
    assert [(span.start, pytest.approx(span.end), span.early) for span in run.spans] == spans
    assert run.motion.end == run.spans[-1].end
    between = run.motion.coordinates_at(run.motion.time[:2].mean())
    np.testing.assert_allclose(between, run.motion.Q[:2].mean(axis=0))


@pytest.mark.parametrize(
    ("shares", "early"),
    [((0.2, 0.0, 0.0), False), ((0.0, 0.0, 0.0), False), ((0.0, 0.3, 0.0), True), ((np.nan,) * 3, True)],
    ids=["one sample", "no share", "again later", "shares not logged"],
)
def test_a_start_of_a_single_sample_that_leaves_no_share_is_no_early_start(
    tmp_path: Path, shares: tuple[float, ...], early: bool
) -> None:
    run = read_run(write_story(tmp_path / "run.h5", Story()))
    first = int(np.argmin(np.abs(run.time - 6.4)))
    run["window/presence"][first, 1] = 1.0
    run["window/share"][run.time < 10.0, 1] = np.nan
    run["window/share"][first : first + 3, 1] = shares
    capture = run.summary().stages[1]
    assert run.spans[1].early == (6.4 if early else None)
    assert (capture.early, capture.actual_start) == (early, 6.4 if early else 10.0)
    assert run.stages["actual_start"][1] == 6.4


def test_the_state_is_the_true_one_beside_what_the_controller_saw(tmp_path: Path) -> None:
    motion = read_run(write_story(tmp_path / "run.h5", Story(blur=0.1))).motion
    np.testing.assert_allclose(np.abs(motion.Q_seen - motion.Q), 0.1)
    np.testing.assert_allclose(np.abs(motion.v_seen - motion.v), 0.1)


def test_a_log_without_a_sample_has_no_motion(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="found no samples"):
        assert read_run(write_story(tmp_path / "run.h5", Story(last=-1.0))).motion
