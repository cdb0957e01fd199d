import csv
from pathlib import Path

import pytest

from psmpc_cli.errors import InputError
from psmpc_cli.logs.export import export_csv
from psmpc_cli.logs.read import Log, read_log
from psmpc_cli.logs.schema import columns
from psmpc_cli.logs.write import Header, LogWriter

from .records import COORDINATES, HEADER, LEAN, STAGES, TICKS, record


def log_of(path: Path, header: Header = HEADER) -> Log:
    with LogWriter(path, header) as log:
        for k in range(3):
            log.write(record(k, count=2))
    return read_log(path)


def table(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(newline="", encoding="utf-8") as file:
        heading, *rows = csv.reader(file)
    return heading, rows


def test_samples_have_a_named_column_for_every_number(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.h5")
    export_csv(log, tmp_path / "tables")
    heading, rows = table(tmp_path / "tables" / "samples.csv")
    assert len(heading) == len(set(heading)) == 1 + sum(log[c.path].size // 3 for c in columns("time") if not c.only)
    assert heading[:2] == ["time [s]", "state/Q/base.x"]
    assert {"window/instants/d", "balance/momentum/angular", "solver/wall_time [s]", "window/first"} <= set(heading)
    for name, values in (
        ("state/Q/arm_1.1", log["state/Q"][:, 2]),
        ("window/instants/a", log["window/instants"][:, 0]),
        ("solver/wall_time [s]", log["solver/wall_time"]),
    ):
        assert [float(line[heading.index(name)]) for line in rows] == values.tolist()
    assert [line[heading.index("solver/status")] for line in rows] == ["optimal", "iteration_limit", "optimal"]


def test_stages_and_ticks_are_tables_too(tmp_path: Path) -> None:
    files = export_csv(log_of(tmp_path / "log.h5"), tmp_path)
    assert [path.name for path in files] == ["samples.csv", "stages.csv", "ticks.csv"]
    heading, rows = table(files[1])
    assert [row[heading.index("name")] for row in rows] == list(STAGES)
    assert heading[-2:] == ["actual_start/0.001", "actual_start/0.1"]
    heading, rows = table(files[2])
    assert heading == ["time [s]", *(f"{name}/{row}" for name in ("Q", "Qdot", "F") for row in COORDINATES)]
    assert len(rows) == 3 * TICKS


def test_no_table_of_ticks_without_ticks(tmp_path: Path) -> None:
    assert [path.name for path in export_csv(log_of(tmp_path / "log.h5", LEAN), tmp_path)] == [
        "samples.csv",
        "stages.csv",
    ]


def test_tables_are_overwritten_with_force_only(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.h5", LEAN)
    (tmp_path / "stages.csv").write_text("mine")
    with pytest.raises(InputError) as refused:
        export_csv(log, tmp_path)
    assert str(refused.value) == (
        f"{tmp_path / 'stages.csv'} exists already: choose another directory, or overwrite with --force"
    )
    assert (tmp_path / "stages.csv").read_text() == "mine"
    assert not (tmp_path / "samples.csv").exists()
    export_csv(log, tmp_path, force=True)
    assert table(tmp_path / "stages.csv")[0][0] == "name"


def test_a_file_is_no_directory_for_tables(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.h5", LEAN)
    with pytest.raises(InputError) as refused:
        export_csv(log, log.path)
    assert str(refused.value) == f"{log.path} cannot be written: it is no directory"
